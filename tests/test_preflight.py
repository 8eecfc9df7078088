"""Ten mistakes in a scenario: each is told before it runs, by `inspect`, `run` and `osc.run`."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

import osc_contact as osc
from osc_contact.cli import app

SINE = "signals: [{type: sine, amplitude: 50 mm, frequency: 0.5 Hz, start: 0 s, ramp: 1 s}]"
LEFT = "contacts.left_end.face"
CART = "{type: cart, direction: [0, 0, 1], mass: 2 kg}"
REFUSED = {
    "plate 1 m away": (f"{LEFT}.point=[-0.295, 0, -0.8]", "move object, faces or base"),
    "reversed normal": (f"{LEFT}.normal=[-0.501104, -0.200441, -0.841854]", "reverse contacts.l"),
    "contact outside the face": (f"{LEFT}.point=[-0.595011, -0.002004, 0.37]", "219 mm beside"),
    "start pose far off": ("object.pose.xyz=[0, 0, 0.33]", "mm away from object.pose"),
    "80 m of motion": ("motion.0.signals.0.amplitude=80 m", "are its signals in the right unit?"),
    "force beyond the motors": (
        "force.left_end=[{type: constant, value: 5 kN}]", "12 times their limits"),
    "no wrist sensor": ("arms.left.wrist_sensor=null", "name a frame of its URDF as wrist_sensor"),
    "1 Hz loop": ("control.rate=1 Hz", "raise the rate to 600 Hz"),
}  # fmt: skip
DOUBTFUL = {
    "motion along the normal": (
        f"motion=[{{kind: linear, direction: [0, 0, 1], {SINE}}}]", "which does not permit it"),
    "start pose moved": ("object.pose.xyz=[0, 0, 0.23]", "starts 25 mm away from object.pose"),
    "free cart": (f"{LEFT}.motion={CART}", "nothing balances the cart of 'face_left_end'"),
    "springs without a loop": (
        "plant.flexible_joints.frequency=60 Hz", "set control.joint_torque={rate: 4 kHz}"),
    "masses wrong, no tare": ("model_error.arm_mass=1.2", "arm_mass is 1.2, and nothing zeroes"),
    "biased wrists, no tare": (
        "sensors.wrist={rate: 1 kHz, torque: {bias: 0.1 Nm}}", "set tare={} to zero them"),
}  # fmt: skip


def call(*words: str | Path) -> Result:
    result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.mark.parametrize("name", osc.list_scenarios())
def test_packaged_scenarios_pass_without_a_word(name):
    assert osc.preflight(osc.build_rig(osc.load_scenario(name))) == ()


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_run_is_refused_at_every_door(name, tmp_path):
    change, cure = REFUSED[name]
    for words in (("inspect",), ("run", "--out", tmp_path)):
        result = call(*words, "two_contact_rod", "--set", change)
        assert result.exit_code == 2 and cure in result.stderr and not result.stdout
    with pytest.raises(osc.ScenarioError, match=cure.replace("?", r"\?")):
        osc.run(osc.load_scenario("two_contact_rod", [change]), duration=0.5)


@pytest.mark.parametrize("name", DOUBTFUL)
def test_what_is_doubtful_is_told_at_every_door(name, caplog):
    change, words = DOUBTFUL[name]
    with caplog.at_level(logging.WARNING, "osc_contact.preflight"):
        result = call("inspect", "two_contact_rod", "--set", change)
        assert result.exit_code == 1 and "free motion 1" in result.stdout
        assert words in caplog.text
        caplog.clear()
        recording = osc.run(osc.load_scenario("two_contact_rod", [change]), duration=0.5)
        assert words in caplog.text and words in recording.meta["doubts"][0]


@pytest.mark.parametrize(
    "changes",
    [
        ["plant.flexible_joints.frequency=60 Hz", "control.joint_torque={rate: 20 kHz}",
         "plant.step=0.05 ms"],
        ["plant.flexible_joints.frequency=200 Hz"],
        ["model_error.arm_mass=1.2", "tare={}"],
        ["model_error.arm_mass=1.2", "plant.type=rigid", "plant.step=1 ms"],
        ["sensors.wrist={rate: 1 kHz, force: {noise: 1 N}}"],
    ],
)  # fmt: skip
def test_what_is_cured_is_not_told(changes):
    assert osc.preflight(osc.build_rig(osc.load_scenario("two_contact_rod", changes))) == ()


def test_a_torque_loop_that_diverges_is_refused_before_it_runs():
    changes = ["plant.flexible_joints.frequency=60 Hz", "control.joint_torque={rate: 4 kHz}"]
    rig = osc.build_rig(osc.load_scenario("two_contact_rod", changes))
    (finding,) = osc.preflight(rig)
    assert finding.refused and "lower control.joint_torque.gain" in finding.text


def test_a_doubtful_run_ends_with_exit_code_1(tmp_path, caplog):
    change = DOUBTFUL["motion along the normal"][0]
    short = ("--plant", "rigid", "--duration", "1.05", "--set", "plant.step=1 ms")
    words = ("run", "two_contact_rod", *short, "--out", tmp_path)
    assert call(*words, "--set", change).exit_code == 1
    assert "verdict: OK" in call(*words).stdout and (tmp_path / "metrics.json").is_file()
