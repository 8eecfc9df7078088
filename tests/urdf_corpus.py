"""A sound URDF and the ways to spoil it: name → (text, check, words of the reason, line)."""

from typing import NamedTuple

GOOD = """\
<?xml version="1.0" encoding="utf-8"?>
<robot name="sound">
  <link name="base"/>
  <link name="column">
    <inertial>
      <origin xyz="0 0 0.2" rpy="0 0 0.1"/>
      <mass value="4"/>
      <inertia ixx="0.05" ixy="0.001" ixz="0" iyy="0.05" iyz="0" izz="0.02"/>
    </inertial>
    <visual>
      <origin xyz="0 0 0.2"/>
      <geometry><cylinder radius="0.05" length="0.4"/></geometry>
    </visual>
    <collision>
      <geometry><mesh filename="meshes/column.stl" scale="1 1 1"/></geometry>
    </collision>
  </link>
  <link name="slide">
    <inertial>
      <origin xyz="0.1 0 0"/>
      <mass value="1.5"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0.001" izz="0.02"/>
    </inertial>
  </link>
  <link name="hand">
    <inertial>
      <origin xyz="0 0.02 0.05"/>
      <mass value="0.5"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.001"/>
    </inertial>
  </link>
  <link name="finger">
    <inertial>
      <mass value="0.1"/>
      <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>
    </inertial>
  </link>
  <link name="tool"/>
  <joint name="turn" type="revolute">
    <parent link="base"/>
    <child link="column"/>
    <origin xyz="0 0 0.1" rpy="0 0 0.5"/>
    <axis xyz="0 0 1"/>
    <limit lower="-2" upper="2.5" effort="40" velocity="3"/>
    <dynamics damping="0.1" friction="0.2"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="column"/>
    <child link="slide"/>
    <origin xyz="0.1 0 0.4" rpy="0.2 0 0"/>
    <axis xyz="0 0.6 0.8"/>
    <limit lower="0" upper="0.3" effort="200" velocity="1"/>
  </joint>
  <joint name="roll" type="continuous">
    <parent link="slide"/>
    <child link="hand"/>
    <origin xyz="0.3 0 0"/>
    <axis xyz="1 0 0"/>
    <limit effort="10" velocity="6"/>
  </joint>
  <joint name="grip" type="revolute">
    <parent link="hand"/>
    <child link="finger"/>
    <origin xyz="0 0.03 0.1"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="1" effort="5" velocity="2"/>
    <mimic joint="lift" multiplier="2" offset="0.1"/>
  </joint>
  <joint name="tip" type="fixed">
    <parent link="hand"/>
    <child link="tool"/>
    <origin xyz="0 0 0.15"/>
  </joint>
</robot>
"""


class Bad(NamedTuple):
    """A spoilt file and what must be reported of it."""

    text: str | bytes
    check: str
    reason: str
    line: int
    element: str = ""


def spoil(old, new, check, reason, element="", up=0):
    """GOOD with the first `old` replaced; the complaint is about that line, or `up` lines above."""
    line = GOOD.count("\n", 0, GOOD.index(old)) + 1 - up
    return Bad(GOOD.replace(old, new, 1), check, reason, line, element)


def _mass(value, reason, check="number"):
    return spoil('value="1.5"', f'value="{value}"', check, reason, "link 'slide' <mass value=")


def _mesh(address, reason):
    return spoil("meshes/column.stl", address, "mesh", reason, "link 'column' <mesh filename=")


FINGER_LIMIT = '<limit lower="0" upper="1" effort="5" velocity="2"/>'
FINGER = GOOD.split('<link name="finger">\n')[1].split("  </link>")[0]
CHAIN = "".join(
    f'<link name="l{i}"/><joint name="j{i}" type="fixed"><parent link="l{i - 1}"/>'
    f'<child link="l{i}"/></joint>'
    for i in range(1, 5000)
)
BOMB = '<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>\n<robot'
SPY = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]>\n<robot'

ROWS = {
    # not the XML of a robot
    "empty": Bad("", "xml", "is empty", 0),
    "binary": Bad(b"\x7fELF\x02\x01\x01\x00\x00\x00", "xml", "NUL byte", 1),
    "NUL in the middle": Bad(GOOD.replace("0.05", "0.0\0005", 1), "xml", "NUL byte", 8),
    "UTF-16": Bad(GOOD.encode("utf-16"), "xml", "or UTF-16", 1),
    "UTF-16 without mark": Bad(GOOD.encode("utf-16-le"), "xml", "NUL byte", 1),
    "latin-1 declared": ("utf-8", "iso-8859-1", "xml", "declares the encoding 'iso-8859-1'"),
    "latin-1 undeclared": Bad(
        GOOD.replace('"base"', '"b\xe4se"').encode("latin-1"), "xml", "byte 0xe4 is not UTF-8", 3
    ),
    "cut at 200 bytes": Bad(GOOD[:200], "xml", "not well-formed XML: .* of line 5.*cut off", 8),
    "cut between elements": Bad(
        GOOD[: GOOD.index("  <joint")], "xml", "not well-formed.*<robot> of line 2.*cut off", 39
    ),
    "wrong end tag": ("</inertial>", "</inertia>", "xml", "mismatched tag"),
    "attribute twice": ('ixx="0.05"', 'ixx="0.05" ixx="1"', "xml", "duplicate attribute"),
    "bare ampersand": ('"base"', '"b&e"', "xml", "not well-formed XML"),
    "two roots of XML": Bad(GOOD + "<robot/>", "xml", "junk after document element", 75),
    "SDF": Bad('<sdf version="1.9"/>', "xml", "root element is <sdf>", 1),
    "entity bomb": ("<robot", BOMB, "xml", "<!DOCTYPE> is refused"),
    "external entity": ("<robot", SPY, "xml", "<!DOCTYPE> is refused"),
    "include": (
        '<link name="base"/>',
        '<xi:include href="/etc/hostname"/>',
        "xml",
        "<xi:include> is not",
    ),
    "macro left over": (
        '<link name="base"/>',
        '<xacro:arm prefix="l"/>',
        "xml",
        "<xacro:arm> is not URDF",
    ),
    "70 levels deep": ("<visual>", "<a>" * 70, "xml", "nested more than 64 deep"),
    "9 MiB": Bad(GOOD + " " * (9 * 2**20), "file", "is larger than 8 MiB", 0),
    "5,000 links": (
        '<link name="tool"/>',
        '<link name="l0"/>' + CHAIN,
        "xml",
        "more than 512 links",
    ),
    # words
    "misspelt element": (
        "<inertial>",
        "<intertial/><inertial>",
        "xml",
        "<intertial> is no word of URDF. Did you mean <inertial>",
    ),
    "misspelt attribute": ('rpy="0.2 0 0"', 'rpz="0.2 0 0"', "xml", "no attribute 'rpz'"),
    "capital letters": (
        '<axis xyz="0 0 1"/>',
        '<Axis xyz="0 0 1"/>',
        "xml",
        "is no word of URDF. Did you mean <axis>",
    ),
    "two inertials": ("<visual>", "<inertial/><visual>", "xml", "the first is in line 5"),
    # names
    "robot without name": (' name="sound"', "", "name", "the robot has no name"),
    "link without name": ('<link name="tool"/>', "<link/>", "name", "a link without a name"),
    "name of 300 letters": ('"tool"', '"' + "x" * 300 + '"', "name", "300 characters"),
    "two links of a name": ('"finger"', '"hand"', "name", "a second link.*in line 25"),
    "the world's name": ('"tool"', '"universe"', "name", "means the world", "link 'universe'"),
    # tree
    "no link": Bad('<robot name="r"/>', "tree", "has no link", 1),
    "unknown parent": (
        'parent link="slide"',
        'parent link="slid"',
        "tree",
        "link 'slid' does not exist. Did you mean 'slide'",
        "joint 'roll'",
    ),
    "no parent": ('<parent link="hand"/>', "", "tree", "without <parent>", "joint 'grip'", 1),
    "two parents": (
        'child link="finger"',
        'child link="slide"',
        "tree",
        "'slide' already hangs on joint 'lift'",
        "joint 'grip'",
        2,
    ),
    "two roots": (
        '<link name="tool"/>',
        '<link name="tool"/><link name="loose"/>',
        "tree",
        "2 links have no parent: 'base', 'loose'",
        "link 'loose'",
    ),
    "loop": ('parent link="base"', 'parent link="hand"', "tree", "form a loop", "", 1),
    "link joined to itself": (
        'parent link="hand"',
        'parent link="finger"',
        "tree",
        "itself",
        "joint 'grip'",
        1,
    ),
    # numbers
    "mass nan": _mass("nan", "value = 'nan' is not a finite number"),
    "mass inf": _mass("inf", "'inf' is not a finite number"),
    "mass 1e300": _mass("1e300", "beyond ±1e\\+09"),
    "decimal comma": _mass("1,5", "'1,5' is not a finite number. Decimals are written with"),
    "macro in a number": _mass("${m}", "'\\${m}' is not a finite number. Expand the macros"),
    "origin of two numbers": ('"0.3 0 0"', '"0.3 0"', "number", "xyz has 2 numbers, 3 are"),
    "origin with commas": ('"0.3 0 0"', '"0.3,0,0"', "number", "parted by blanks"),
    "inertia entry missing": (' izz="0.001"', "", "number", "izz is missing", "link 'hand'"),
    "mimic offset nan": ('offset="0.1"', 'offset="nan"', "number", "offset = 'nan'"),
    # joints
    "no joint type": (' type="prismatic"', "", "joint", "no joint type", "joint 'lift'"),
    "unknown joint type": ('"prismatic"', '"prismatc"', "joint", "Did you mean 'prismatic'"),
    "floating joint": ('"prismatic"', '"floating"', "joint", "nq ≠ nv"),
    "axis zero": ('axis xyz="0 0 1"', 'axis xyz="0 0 0"', "joint", "axis has length 0"),
    "axis too long": ('axis xyz="0 0 1"', 'axis xyz="0 0 2"', "joint", "axis has length 2"),
    "friction negative": ('friction="0.2"', 'friction="-0.2"', "joint", "-0.2 is negative"),
    "mimic of nothing": (
        'mimic joint="lift"',
        'mimic joint="left"',
        "joint",
        "follows the joint 'left', which does not exist. Did you mean 'lift'",
    ),
    "mimic of itself": ('mimic joint="lift"', 'mimic joint="grip"', "joint", "follows itself"),
    # limits
    "no limit": (FINGER_LIMIT, "", "limit", "has no <limit>", "joint 'grip'", 5),
    "lower missing": ('lower="-2" ', "", "limit", "lower is missing", "joint 'turn' <limit>"),
    "lower above upper": ('lower="-2"', 'lower="3"', "limit", "lower limit 3 is above"),
    "effort 0": ('effort="40"', 'effort="0"', "limit", "effort limit 0 N m must be > 0"),
    "upper inf": ('upper="2.5"', 'upper="inf"', "number", "upper = 'inf' is not a finite"),
    "effort inf": ('effort="40"', 'effort="inf"', "number", "effort = 'inf' is not a finite"),
    # inertias
    "mass negative": _mass("-1.5", "mass -1.5 kg is negative", "inertia"),
    "mass 0": ('value="1.5"', 'value="0"', "inertia", "mass 0 kg with principal", "", -1),
    "inertial without mass": ('<mass value="1.5"/>', "", "inertia", "without <mass>", "", 2),
    "inertial without inertia": (
        '<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>',
        "",
        "inertia",
        "<inertial> without <inertia>",
        "link 'finger'",
        2,
    ),
    "inertia negative": ('izz="0.001"', 'izz="-0.001"', "inertia", "inertia is not positive"),
    "triangle violated": ('izz="0.001"', 'izz="0.005"', "inertia", "exceeds the sum of"),
    "moved mass missing": (
        FINGER,
        "",
        "mass matrix",
        "joint grip can move without moving mass",
        "joint 'grip'",
        -24,
    ),
    # shapes
    "cylinder negative": ('length="0.4"', 'length="-0.4"', "geometry", "negative size"),
    "unknown shape": ("<cylinder ", "<cone ", "geometry", "unknown shape <cone>"),
    "no shape": ('<cylinder radius="0.05" length="0.4"/>', "", "geometry", "one shape", "", 2),
    "mesh at an address": _mesh("http://example.org/a.stl", "scheme 'http:'"),
    "mesh at an absolute path": _mesh("/etc/a.stl", "outside of the robot's folders"),
    "mesh above": _mesh("../../a.stl", "outside of the robot's folders"),
    "mesh above its package": _mesh(
        "package://arm/../../etc/a.stl", "outside of the robot's folders"
    ),
    "mesh of another type": _mesh("meshes/passwd", "type without suffix are not read"),
    "mesh without name": _mesh("", "a mesh without filename"),
}
CORPUS = {name: row if isinstance(row, Bad) else spoil(*row) for name, row in ROWS.items()}

SOUND = {
    "as it is": lambda good: good,
    "byte order mark": lambda good: "\ufeff" + good,
    "Windows line ends": lambda good: good.replace("\n", "\r\n").encode(),
    "comments and processing instructions": lambda good: good.replace(
        "<robot", '<?xml-model href="x"?>\n<!-- <!ENTITY --><robot', 1
    ),
    "extensions of simulators": lambda good: good.replace(
        "</robot>", '<gazebo reference="tool"><mu1>nan</mu1></gazebo><transmission/></robot>'
    ),
    "names beyond ASCII": lambda good: good.replace('"slide"', '"schlitten ä &amp; &lt;b&gt;"'),
    "defaults of the specification": lambda good: good.replace('<axis xyz="1 0 0"/>', "", 1),
    "link and joint of one name": lambda good: good.replace('"roll"', '"hand"', 1),
    "limits so wide that they are none": lambda good: good.replace('upper="2.5"', 'upper="1e300"'),
    "mesh of a package": lambda good: good.replace("meshes/column", "package://arm/column"),
    "point mass": lambda good: good.replace(
        'ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"',
        'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"',
    ).replace('<mass value="0.1"/>', '<origin xyz="0.05 0 0"/><mass value="0.1"/>'),
}
