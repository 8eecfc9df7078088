"""First contacts: the peak that is expected beside the one that MuJoCo shows."""

import numpy as np
from pytest import approx
from rigs import rig_of
from samples import aligned, first, parametrize
from scenario_runs import run_of, verdict_of, worst_force

import osc_contact as osc
from benchmarks.random_tasks import draw
from osc_contact.lab.rig.landings import landings

PUSH = 10.0  # N, of either end of the rod


def approach(speed, rate=1.0):
    """Landings of the scenario, its contacts `rate` times as fast as they are."""
    tau, damping = rig_of("approach_and_slide").scenario.plant.solref
    words = [f"control.life.speed={speed}", f"plant.solref=[{tau / rate}, {damping}]"]
    return osc.load_scenario("approach_and_slide", words)


@parametrize("speed", [0.03, 0.1])
def test_landings_are_as_hard_as_expected(speed):
    one = approach(speed)
    expected = [landing.peak for landing in landings(rig_of(one))]
    peaks = run_of(one, duration=2.5)["alpha_true"].max(axis=0)
    assert (peaks < np.maximum(2.0 * PUSH, 1.2 * np.array(expected))).all()
    assert peaks.max() > 0.5 * max(expected)


def test_the_peak_grows_with_speed_and_with_the_root_of_the_stiffness():
    slow = landings(rig_of(approach(0.2)))
    fast = landings(rig_of(approach(0.4)))
    stiff = landings(rig_of(approach(0.2, rate=2.0)))
    for one, two, three in aligned(slow, fast, stiff):
        assert one.peak == approx(one.speed * np.sqrt(one.stiffness * one.mass))
        assert two.peak == approx(2.0 * one.peak) == approx(three.peak)
        assert three.stiffness == approx(4.0 * one.stiffness)


@parametrize("speed, hard", {0.1: False, 0.2: True})
def test_hard_landings_are_announced(speed, hard):
    rig = rig_of(approach(speed))
    texts = [finding.text for finding in osc.preflight(rig) if "lands at" in finding.text]
    assert len(texts) == 2 * hard
    for text, landing in zip(texts, landings(rig), strict=False):
        assert landing.sentence in text and "lower control.life.speed" in text


def test_contacts_that_exist_already_are_not_announced():
    rig = rig_of("panda_edge", "control.life.speed=0.1")
    (edge,) = landings(rig)
    assert not edge.free and edge.peak > 3.0 * edge.command
    assert not [finding for finding in osc.preflight(rig) if "lands at" in finding.text]


def test_an_approach_that_has_used_up_its_travel_stands_still():
    recording = run_of("approach_and_slide", "control.life.travel=1 mm", duration=1.7)
    assert recording.meta["end_state"] == "RUN" and not recording["closed"].any()
    assert (recording["contact_phase"][-1] == 1).all()
    assert np.ptp(recording["pose"][-500:, :3], axis=0).max() < 1e-4


# --- Beside a tare --------------------------------------------------------------------------------


@parametrize("seed, number", [(550118, 44), (771203, 51)])
def test_one_force_is_made_gently_though_friction_keeps_the_arm_from_the_face(
    own_plants, seed, number
):
    """Commanded in free air, it accelerated these arms up to the face: 33 and 10 times as much."""
    task = draw(seed, number)
    assert task.load().control.life is not None
    recording = osc.run(task.load(), seed=number, duration=2.5)
    assert recording["closed"][-1].all()
    assert recording["alpha_true"].max() < 2.0 * recording["alpha_cmd"].max()


@parametrize("name, phased", {"panda_edge": True, "ur5_wipe": False, "two_contact_rod": False})
def test_several_forces_are_made_together(name, phased):
    assert (osc.load_scenario(name, ["tare={}"]).control.life is not None) == phased
    assert osc.load_scenario(name, ["tare={}", "control.life={}"]).control.life is not None
    assert osc.load_scenario(name, ["tare={}", "control.life=off"]).control.life is None


# --- All contacts at once, approached by the motion law -------------------------------------------


@parametrize("name", ["three_arm_plate", "panda_edge", "two_contact_rod", "scara_peg"])
def test_references_of_an_approach_meet_no_contact_before_it_ends(name):
    """Motions that slide and turn on the way would press some contacts before the others."""
    rig = rig_of(name, "tare={}", "control.life=off")
    end = rig.references.engage_at
    for t in np.linspace(0.0, end, 60):
        X_WD = rig.references.at(t).X_WD
        gaps = np.concatenate([pair.gaps(X_WD) for pair in rig.pairs])
        assert gaps.min() > -2e-6, t
    assert np.abs(gaps).max() < 2e-6


@parametrize("rotors", first([0.5, 0.15], 1))
def test_heavy_arms_land_a_plate_on_three_posts_at_once(rotors):
    arms = (f"arms.{name}.armature={rotors}" for name in ("panda", "ur5_left", "ur5_right"))
    verdict = verdict_of("three_arm_plate", "gains={}", "tare={}", *arms, "duration=2.5 s")
    assert max(step["overshoot_rel"] for step in verdict["steps"]) < 0.3
    assert worst_force(verdict) < 0.03
