"""The two-contact task of section 6, judged by plants, at the limits the project promises."""

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark, raises
from samples import first
from scenario_runs import assert_accurate, rig_of, run_of, verdict_of, worst_force

import osc_contact as osc

OTHERS = sorted((Path(__file__).parent / "scenarios").glob("*.yaml"))


@fixture(scope="module")
def nominal():
    return run_of()


@fixture(scope="module")
def mismatch():
    return run_of("two_contact_rod_mismatch")


def test_the_task_is_the_one_described(nominal):
    """10 s at 1 kHz: 10 cm peak to peak at 0.5 Hz, α₁ 10 → 15 N, α₂ = 8 + 4 sin(2π 0.5 t) N."""
    t = nominal["t"]
    assert len(t) == 10_000
    assert_allclose(np.diff(t), 1e-3, rtol=1e-9)
    after = t >= 1.0
    path = nominal["pose"][after, :3]
    along = np.linalg.svd(path - path.mean(axis=0), full_matrices=False)[2][0]
    slide = path @ along
    assert np.ptp(slide) == approx(0.10, rel=2e-3)
    crossings = np.flatnonzero(np.diff(np.sign(slide - slide.mean())) != 0)
    assert np.diff(t[after][crossings]).mean() == approx(1.0, rel=1e-2)
    commands = np.where(t >= 5.0, 15.0, 10.0), 8.0 + 4.0 * np.sin(2 * np.pi * 0.5 * t)
    assert_allclose(nominal["alpha_cmd"][after].T, np.array(commands)[:, after], atol=1e-9)


def test_forces_motion_and_contact_on_mujoco(nominal):
    """And fig. 6: ≤ 2 %."""
    verdict = osc.metrics(nominal)
    assert verdict["task"]["word"] == "OK"
    assert_accurate(verdict)
    assert verdict["power"]["total_rms_W"] > 0.02
    assert verdict["power"]["ratio"] <= 0.02


def test_no_force_overshoots_its_command(nominal):
    """First contacts and the step: at most 5 % above what is commanded, from the first tick on."""
    steps = osc.metrics(nominal)["steps"]
    assert [(s["what"], s["force"]) for s in steps] == [
        ("first contact", "right_end"),
        ("first contact", "left_end"),
        ("step", "left_end"),
    ]
    assert max(s["overshoot_rel"] for s in steps) <= 0.05
    assert nominal["alpha_true"].max(axis=0) == approx([15.0, 12.0], rel=2e-3)


def test_steps_at_once_are_followed_as_before():
    """The same gains without a rise time: what the law itself reaches, to the last digit given."""
    force = verdict_of("two_contact_rod", "gains.force.rise=0 s")["force"]
    assert force["left_end"]["rms_error_rel"] == approx(1.63e-4, abs=5e-7)
    assert force["right_end"]["rms_error_rel"] == approx(2.25e-4, abs=5e-7)


def test_the_judge_takes_its_forces_from_the_plant_and_its_motion_from_the_object(nominal):
    """Recompute the verdict from the raw recording, by hand."""
    verdict = osc.metrics(nominal)
    t = nominal["t"]
    quiet = (t >= 1.0) & ~((t >= 5.0) & (t < 5.05 + nominal.meta["force_rise_s"]))
    error = (nominal["alpha_true"] - nominal["alpha_cmd"])[quiet]
    error /= nominal["alpha_cmd"][quiet].mean(axis=0)
    for name, wanted in (
        ("rms_error_rel", np.sqrt((error**2).mean(axis=0))),
        ("peak_error_rel", np.abs(error).max(axis=0)),
    ):
        found = [force[name] for force in verdict["force"].values()]
        assert found == approx(wanted, rel=1e-9)
    u = np.cross(*nominal["contact_direction"][0])
    u /= np.linalg.norm(u)
    slide = (nominal["pose"][:, :3] - nominal["pose"][0, :3]) @ u
    want = 0.05 * np.sin(2 * np.pi * 0.5 * t)
    want *= np.sign(slide @ want)
    assert np.sqrt(((slide - want)[t >= 1.0] ** 2).mean()) < 0.2e-3  # true pose, not encoders


def test_wrong_masses_are_tared_and_integrated_away(mismatch):
    """Rod and links 20 % too heavy in the model, wrists tared in free space: force ≤ 3 %."""
    scenario = mismatch.meta["scenario"]
    assert {"object_mass": 1.2, "arm_mass": 1.2}.items() <= scenario["model_error"].items()
    before = mismatch["t"] < scenario["tare"]["duration"]
    assert not mismatch["closed"][before].any()  # the tare really is in free space
    verdict = osc.metrics(mismatch)
    assert worst_force(verdict) <= 0.03
    assert_accurate(verdict, forces=False)


def test_without_the_tare_wrong_masses_spoil_the_forces():
    """The limit above is not met by luck: contact from the start, no tare, no integral motion."""
    heavy = "model_error.object_mass=1.2", "model_error.arm_mass=1.2"
    assert worst_force(verdict_of("two_contact_rod", *heavy, duration=2.0)) > 0.03


def test_rigid_plant_projects_all_power_away():
    """Fig. 6 on the exact plant: projected / total ≤ 1e-10, forces exact."""
    verdict = verdict_of("two_contact_rod", "plant.step=1 ms", plant="rigid", duration=1.3)
    assert verdict["power"]["ratio"] <= 1e-10
    assert verdict["power"]["total_rms_W"] > 0.02
    assert_accurate(verdict, forces=False)
    for force in verdict["force"].values():
        assert force["sensing_rms_rel"] <= 1e-9


@mark.parametrize("path", first(OTHERS), ids=lambda path: getattr(path, "stem", None))
def test_another_state_of_contact_needs_only_another_file(path):
    """Moved faces, other normals, rod or commands: the limits hold without touching code."""
    assert_accurate(verdict_of(path))


@mark.parametrize(
    "change, error, words",
    [
        ("force.right_end.1.amplitude=9 N", osc.ScenarioError, "cannot pull"),
        ("contacts.left_end.face.point=[-1.5, 0, 0.2]", osc.OscContactError, ""),
        ("arms.left.posture=[0, 0, 0]", osc.ScenarioError, "posture"),
    ],
)
def test_what_cannot_be_built_is_refused(change, error, words):
    """A face that would have to pull, one out of reach, a posture of too few joints."""
    with raises(error) as refused:
        rig_of("two_contact_rod", change)
    assert words in str(refused.value)
