"""Mutants of sound URDFs in a process of their own, and the inputs that kill Pinocchio."""

import json
import os
import subprocess
import sys
from pathlib import Path

from pytest import mark
from samples import first

TESTS = Path(__file__).resolve().parent


def run(*command):
    """Standard output of a Python process that must end well; a crash has a return code < 0."""
    how = {"env": os.environ | {"PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}"}, "timeout": 300}
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, **how)
    assert done.returncode == 0, f"return code {done.returncode}: {done.stderr[-2000:]}"
    return done.stdout


@mark.parametrize("count", first([2_500, 20_000], 1))
def test_no_mutant_crashes_and_none_is_accepted_with_a_bad_mass_matrix(count):
    result = json.loads(run("-W", "error", str(TESTS / "urdf_mutants.py"), "1999", str(count)))
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
    out = run(
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
print(robots.load_model(file).nframes, robots.cross_check(file) < 1e-9)
for n in (513, 4000, 20000):
    file.write_text(chain(n))
    try:
        robots.load_model(file)
    except ModelError as error:
        print('more than 512 links' in str(error))
""",  # noqa: E501
    )
    assert out.split() == ["1024", "True", "True", "True", "True"]


def test_unknown_frames_and_joints_are_refused_before_pinocchio_is_asked():
    out = run(
        "-c",
        """
from osc_contact import Arm, robots
from osc_contact.errors import ModelError
for wrong in (dict(tip='nope'), dict(wrist_sensor='nope'), dict(tip=''),
              dict(locked={'nope': 0.0}), dict(passive_joints=['universe'])):
    try:
        Arm.from_urdf(robots.urdf_path('scara_left'), name='a', **{'tip': 'tool', **wrong})
    except ModelError:
        print('refused')
""",
    )
    assert out.split() == ["refused"] * 5
