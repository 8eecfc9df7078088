"""Comparison by `osc-contact check` of our reading of a URDF with yourdfpy's."""

import yourdfpy
from command_line import answered
from pytest import fixture
from samples import parametrize

from osc_contact import robots
from osc_contact.robots import second_reading
from osc_contact.robots.second_reading import differences

ROBOT = """<robot name="two">
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0.1 0 0" rpy="0 0 0.3"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="upper.stl" scale="1 1 2"/></geometry></visual>
  </link>
  <link name="lower">
    <inertial><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="a" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.5" rpy="0.1 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="30" velocity="3"/>
  </joint>
  <joint name="b" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit effort="20" velocity="4"/>
  </joint>
</robot>"""

#: What another reader could make of the file: text, other text, and the sentence about it.
OTHERS = {
    "link": ('<link name="base"/>', '<link name="base"/><link name="c"/>', "by yourdfpy only"),
    "type": ('"a" type="revolute"', '"a" type="prismatic"', "its type is 'revolute', by yourdfpy"),
    "limit": ('upper="2"', 'upper="2.1"', "joint 'a': upper 2, by yourdfpy 2.1"),
    "effort": ('effort="20"', 'effort="21"', "joint 'b': effort 20, by yourdfpy 21"),
    "place": ("0 0 0.5", "0 0 0.502", "joint 'a': yourdfpy places its child 0.002 m and 0 rad"),
    "turn": ('rpy="0.1', 'rpy="0.3', "joint 'a': yourdfpy places its child 0 m and 0.2 rad"),
    "axis": ('xyz="0 1 0"', 'xyz="0 -1 0"', "joint 'b': yourdfpy places its child 0 m and"),
    "mass": ('value="2"', 'value="2.5"', "joint 'a': its mass differs from yourdfpy's by 0.5 kg"),
    "centre": ('xyz="0.1 0 0"', 'xyz="0.2 0 0"', "first moment of mass differs"),
    "moments": ('ixx="0.02"', 'ixx="0.021"', "its moments of inertia differ"),
    "mesh": ("upper.stl", "lower.stl", "visual meshes ['upper.stl'], by yourdfpy ['lower.stl']"),
    "scale": ("1 1 2", "1 1 1", "yourdfpy scales visual meshes in another way"),
}


@fixture
def file(tmp_path):
    """The robot as a file."""
    path = tmp_path / "two.urdf"
    path.write_text(ROBOT)
    return path


@parametrize("name", ["scara_left", "rod", "panda", "ur5", "talos_reduced", "icub_reduced"])
def test_both_readers_agree_on_robots(name):
    """One link of icub's has moments that no body has; several are joined to their neighbours."""
    path, folders = robots.resolve_urdf(name)
    weak = robots.JointLimits(effort=1.0, velocity=1.0)
    by_hand = {"*": weak} if folders else {}
    assert differences(path, limits=by_hand, inertias="positive", package_dirs=folders) == []


@parametrize("kind", OTHERS)
def test_each_difference_is_named(kind, file, tmp_path, monkeypatch):
    """yourdfpy is given another text."""
    assert differences(file) == []
    text, instead, sentence = OTHERS[kind]
    assert ROBOT.count(text) == 1
    other = tmp_path / "other.urdf"
    other.write_text(ROBOT.replace(text, instead))
    load = yourdfpy.URDF.load
    monkeypatch.setattr(yourdfpy.URDF, "load", lambda path, **how: load(str(other), **how))
    found = differences(file)
    assert all("yourdfpy" in one for one in found)
    assert any(sentence in one for one in found), found


def test_limits_given_by_hand_are_not_compared(file):
    by_hand = {"a": robots.JointLimits(effort=5.0, upper=0.5)}
    assert differences(file, limits=by_hand) == []


def test_followers_are_placed_by_their_masters(tmp_path):
    path = tmp_path / "mimic.urdf"
    follows = '<mimic joint="a" multiplier="-2" offset="0.3"/></joint>\n</robot>'
    path.write_text(ROBOT.replace("</joint>\n</robot>", follows))
    assert differences(path) == []


def test_a_file_that_yourdfpy_does_not_read_is_reported(file, monkeypatch):
    def load(path, **how):
        raise ValueError("no such tag")

    monkeypatch.setattr(yourdfpy.URDF, "load", load)
    assert differences(file) == ["yourdfpy does not read the file: no such tag"]


def test_check_prints_the_comparison_and_writes_it(file, monkeypatch):
    printed, found = answered("check", file)
    assert second_reading.AGREE in printed.output and found["differences"] == []
    monkeypatch.setattr(second_reading, "differences", lambda *_, **__: ["joint 'a': elsewhere"])
    printed, found = answered("check", file)
    assert "joint 'a': elsewhere" in printed.output and second_reading.AGREE not in printed.output
    assert found["differences"] == ["joint 'a': elsewhere"]
