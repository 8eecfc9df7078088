"""Checks of robots: every kind of bad URDF is refused alive; the report of `osc-contact check`."""

import json
import re

import numpy as np
import pinocchio as pin
from command_line import answered, call, read_json, refused
from complaints import model_error
from processes import python
from pytest import approx, raises
from rigs import assert_near
from samples import ROOT, aligned, first, parametrize
from second_reader import urdf_difference
from urdf_corpus import CORPUS, GOOD, SOUND

from osc_contact import robots
from osc_contact.errors import ModelError


def write(folder, text):
    file = folder / "arm.urdf"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return file


def test_the_corpus_is_large_and_every_entry_differs():
    assert len({bad.text for bad in CORPUS.values()}) == len(CORPUS) >= 60


@parametrize("name", CORPUS)
def test_bad_file_is_refused_with_place_and_reason(name, tmp_path):
    bad = CORPUS[name]
    file = write(tmp_path, bad.text)
    with raises(ModelError) as caught:
        robots.load_model(file)
    first = caught.value.findings[0]
    assert re.search(bad.reason, str(first)), str(first)
    assert (first.check, first.file, first.line) == (bad.check, file, bad.line), str(first)
    assert str(caught.value).startswith(f"{file}:{bad.line}:" if bad.line else f"{file}: ")
    assert first.element.startswith(bad.element)


@parametrize("name", SOUND)
def test_sound_variant_is_accepted_and_both_readers_agree(name, tmp_path):
    file = write(tmp_path, SOUND[name](GOOD))
    assert robots.load_model(file).nv == 4
    assert urdf_difference(file) < 1e-12


def test_every_check_has_a_row_on_the_page_on_robots():
    page = (ROOT / "docs/robots.md").read_text()
    rows = re.findall(r"^\| ([a-z ]+) \|", page.split("| check |")[1].split("\n\n")[0], re.M)
    assert {bad.check for bad in CORPUS.values()} == set(rows)


# `osc-contact check` and the summary it prints, against closed forms and other routes.


def chain(joints, masses, length=1.0, mass=1.0):
    """Joints (kind, axis, origin in m) one behind the other, with boxes of the given masses."""
    text = '<robot name="toy"><link name="l0"/>'
    for i, ((kind, axis, origin), m) in enumerate(aligned(joints, masses), 1):
        x, y, z = (float(part) * length for part in origin.split())
        I = 0.1 * m * mass * length**2
        body = (
            f'<inertial><origin xyz="{0.3 * length} 0 {0.1 * length}"/><mass value="{m * mass}"/>'
            f'<inertia ixx="{I}" iyy="{1.5 * I}" izz="{1.7 * I}" ixy="0" ixz="0" iyz="{0.1 * I}"/>'
            "</inertial>"
            if m
            else ""
        )
        text += (
            f'<link name="l{i}">{body}</link><joint name="j{i}" type="{kind}">'
            f'<parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="{x} {y} {z}"/>'
            f'<axis xyz="{axis}"/><limit lower="{-length if kind == "prismatic" else -1.5}" '
            f'upper="{length if kind == "prismatic" else 1.5}" effort="1" velocity="1"/></joint>'
        )
    return f"{text}</robot>"


def summary(folder, text, *tip):
    return robots.summarise(robots.load_model(write(folder, text)), *tip)


SIX_AXES = [
    ("revolute", "0 0 1", "0 0 0.3"),
    ("revolute", "0 1 0", "0.1 0 0.2"),
    ("prismatic", "0 0 1", "0.4 0 0"),
    ("revolute", "1 0 0", "0.2 0 0.1"),
    ("revolute", "0 1 0", "0.2 0.1 0"),
    ("revolute", "0 0 1", "0.1 0 0"),
]


UNITS = parametrize("length, mass", [(1.0, 1.0), (1e3, 1.0), (1.0, 1e-3), (0.0254, 0.4536)])


@UNITS
def test_a_gantry_has_the_masses_it_pushes(tmp_path, length, mass):
    axes = [("prismatic", axis, "0 0 0") for axis in ("1 0 0", "0 1 0", "0 0 1")]
    robot = summary(tmp_path, chain(axes, [5.0, 3.0, 2.0], length, mass))
    assert [joint.moved_mass / mass for joint in robot.joints] == approx([10.0, 5.0, 2.0])
    assert robot.mass == robot.moving_mass == approx(10.0 * mass)
    (tip,) = robot.tips
    assert tip.mass == approx((2.0 * mass, 10.0 * mass)) and tip.inertia == (np.inf, np.inf)


@UNITS
def test_mobility_is_the_share_of_the_last_body_in_the_energy(tmp_path, length, mass):
    """σ² are the eigenvalues of M⁻¹ M', M' the mass matrix with the last body alone."""
    texts = [
        chain(SIX_AXES, masses, length, mass)
        for masses in ([4.0, 3.0, 2.0, 1.0, 0.5, 0.4], [0.0] * 5 + [0.4])
    ]
    (tip,) = summary(tmp_path, texts[0]).tips
    models = [pin.buildModelFromXML(text) for text in texts]
    sigma = []
    for q in robots.random_configurations(models[0], 200):
        M, M_last = (np.array(pin.crba(model, model.createData(), q)) for model in models)
        sigma.append(np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, M_last)).real)[::-1]))
    expected = np.column_stack((np.min(sigma, axis=0), np.max(sigma, axis=0)))
    assert_near(tip.mobility, expected, rtol=1e-6)
    assert (np.array(tip.mobility) <= 1 + 1e-9).all()


def test_the_tip_can_be_chosen(tmp_path):
    every = summary(tmp_path, GOOD)
    assert [tip.tip for tip in every.tips] == ["finger", "tool"] and every.more_tips == 0
    (slide,) = summary(tmp_path, GOOD, "slide").tips
    assert (slide.tip, slide.joints, len(slide.mobility)) == ("slide", 2, 2)
    for tip, words in (("tol", "no frame 'tol'"), ("base", "no joint moves the frame 'base'")):
        with model_error(words):
            summary(tmp_path, GOOD, tip)
    assert robots.load_model(robots.urdf_path("rod")).nv == 0
    rod = robots.check_robot(robots.urdf_path("rod"))
    assert rod.sound and rod.summary is not None and rod.summary.tips == ()


# The command ------------------------------------------------------------------------------------


def test_check_prints_verdict_joints_and_tips():
    result, found = answered("check panda")
    for words in (
        "panda.urdf: sound",
        "9 joints move, 13 links, 17.45 kg",
        "-3.072 … -0.0698 rad",
        "87 N m",
        "panda_hand_tcp",
        "mobility",
    ):
        assert words in result.stdout, words
    assert found["sound"] is True and found["findings"] == [] and found["meshes_missing"] == 0
    assert found["robot"]["dof"] == 9 and len(found["robot"]["joints"]) == 9
    assert found["robot"]["mass"] == approx(17.45, abs=0.01)


def test_check_reports_everything_that_is_wrong(tmp_path):
    text = GOOD.replace('effort="40"', 'effort="0"').replace('value="4"', 'value="-4"')
    result = call("check", write(tmp_path, text), "--json", tmp_path / "bad.json")
    assert result.exit_code == 1 and not result.stderr
    assert "arm.urdf:44:5: joint 'turn' <limit effort='0'>: effort limit 0 N m" in result.stdout
    assert "arm.urdf:7:7: link 'column' <mass value='-4'>: mass -4 kg is" in result.stdout
    assert result.stdout.endswith("arm.urdf: refused, 2 findings\n")
    found = read_json(tmp_path / "bad.json")
    assert found["sound"] is False and found["robot"] is None
    assert [(f["check"], f["line"]) for f in found["findings"]] == [("limit", 44), ("inertia", 7)]


def test_check_takes_limits_inertias_tip_and_package_folders(tmp_path):
    text = GOOD.replace('effort="40"', 'effort="0"').replace('izz="0.001"', 'izz="0.005"')
    file = write(tmp_path, text.replace("meshes/column.stl", "/opt/meshes/column.stl"))
    line = f"check {file} --limit t*:effort=7,lower=-1 --inertias positive --tip hand"
    assert "outside of the robot's folders" in call(line).stdout
    result, found = answered(f"{line} --package-dir /opt/meshes")
    assert "1 mesh files were not found" in result.stdout
    assert found["robot"]["joints"][0]["effort"] == 7 and found["meshes_missing"] == 1
    assert [joint["lower"] for joint in found["robot"]["joints"]].count(None) == 1
    assert [tip["tip"] for tip in found["robot"]["tips"]] == ["hand"]


@parametrize(
    "line, message",
    {
        "./absent.urdf": "neither the file",
        "absent.urdf": "neither the file",
        "pnda": "did you mean 'panda'",
        "example-robot-data:pnda": "did you mean 'panda'",
        "panda --tip hnd": "no frame 'hnd'",
        "panda --limit elbow:effort=3": "no moving joint matches 'elbow'",
        "panda --limit panda_joint1:torque=3": "expected JOINT:key=number",
        "panda --inertias any": "positive",
        "/": "is neither the file",
    },
)
def test_bad_words_end_with_2(line, message):
    assert message in refused(f"check {line}")


# Mutants of sound URDFs in a process of their own, and the inputs that kill Pinocchio.


@parametrize("count", first([1_250, 20_000], 1))
def test_no_mutant_crashes_and_none_is_accepted_with_a_bad_mass_matrix(count):
    result = json.loads(python("-W", "error", ROOT / "tests/urdf_mutants.py", "1999", count).stdout)
    verdicts = result["verdicts"]
    assert sum(verdicts.values()) == result["mutants"] == count
    assert result["broken"] == []
    assert result["least_eigenvalue"] > 1e-12 and result["largest_difference"] < 1e-6
    assert result["slowest_ms"] < 10_000  # a hang; how fast it is, benchmarks measure
    assert "no finding" not in verdicts, "Pinocchio refused what our own checks let through"
    for check in ("accepted", "xml", "number", "tree", "limit", "inertia", "joint"):
        assert verdicts[check] > count / 100, "the mutants must reach every check"
    assert verdicts["mass matrix"] > count / 4000


def test_the_longest_robot_that_is_accepted_does_not_kill_the_process():
    out = python(
        "-c",
        """
import pathlib, tempfile
from osc_contact import robots
from osc_contact.errors import ModelError
BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
def chain(n):
    joints = ''.join(f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i+1}"/></joint>'
                     for i in range(n - 1))
    return '<robot name="r">' + ''.join(f'<link name="l{i}">{BODY}</link>' for i in range(n)) + joints + '</robot>'
file = pathlib.Path(tempfile.mkdtemp()) / 'chain.urdf'
file.write_text(chain(512))
print(robots.load_model(file).nframes)
for n in (513, 4000, 20000):
    file.write_text(chain(n))
    try:
        robots.load_model(file)
    except ModelError as error:
        print('more than 512 links' in str(error))
""",  # noqa: E501
    )
    assert out.stdout.split() == ["1024", "True", "True", "True"]
