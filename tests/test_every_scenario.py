"""Packaged scenarios: each touches, keeps the limits on both plants, and can be looked at."""

import json

import numpy as np
from numpy.linalg import lstsq, norm, solve
from numpy.testing import assert_allclose
from pytest import fixture, mark
from rigs import largest
from samples import chosen, first
from scenario_runs import assert_accurate, rig_of, verdict_of

import osc_contact as osc
from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.runs.contacts import feet
from osc_contact.runs.inspection import inspect_rig
from osc_contact.runs.viewing import write_scene_of
from osc_contact.scenarios import Scenario

ROBOTS = {  # d, r, motors, words of `inspect`
    "panda_edge": (6, 1, 7, ("into the edge of 'table'", "1 motion(s) of arms")),
    "dual_panda_rod": (6, 2, 14, ("no single frame", "6 internal force(s)", "2 motion(s) of arms")),
    "panda_dome": (6, 1, 7, ("into the surface of 'dome'", "1 motion(s) of arms")),
    "ur5_wipe": (6, 3, 6, ("cloth.3 along", "pushing only", "face on face of 'board'")),
    "three_arm_plate": (6, 3, 19, ("into the vertex of 'tripod'", "12 internal force(s)")),
    "hinge_ball_rod": (6, 2, 14, ("2 internal force(s)", "6 motion(s) of arms")),
    "scara_peg": (4, 2, 4, ("into the plane of 'socket'", "the arms' structure carries")),
}
NAMES = list(ROBOTS)


@fixture(scope="module")
def rigs():
    return {name: rig_of(name) for name in NAMES}


@fixture(scope="module")
def runs(rigs):
    """Each on MuJoCo for 2 s, with changes of a commanded force brought forward to 1.2 s."""
    found = {}
    for name in rigs:
        data = osc.load_scenario(name).as_dict() | {"duration": 2.0}
        for signal in (s for signals in data["force"].values() for s in signals):
            if signal.get("start", 0.0) > 1.0:
                signal["start"] = 1.2
        found[name] = osc.run(Scenario.model_validate(data))
    return found


@mark.parametrize("name", NAMES)
def test_it_starts_touching_within_limits_and_is_told_in_words(rigs, name):
    rig = rigs[name]
    d, r, motors, words = ROBOTS[name]
    found = inspect_rig(rig)
    assert (found.d, found.r, rig.chain.n_a) == (d, r, motors)
    assert len(found.contacts) == r == len(set(found.contacts))
    report = "\n".join(found.lines)
    assert all(text in report for text in words), report
    json.dumps(found.as_dict())
    X = rig.state().X_WO
    assert max(np.abs(pair.gaps(X)).max() for pair in rig.pairs) < 1e-12
    wanted = rig.scenario.object.pose
    assert norm(X.translation - np.array(wanted.xyz)) < 0.02  # near what the file says
    for t in np.linspace(0.0, rig.scenario.duration, 50):
        assert (rig.references.at(t).alpha_d > 0.0).all()


@mark.parametrize("name", NAMES)
def test_geometry_touches_where_the_pairs_say(rigs, name):
    """Pressed 0.1 mm into every contact, MuJoCo finds points on every body and none elsewhere."""
    rig = rigs[name]
    plant = rig.plant()
    assert isinstance(plant, MujocoPlant)
    state = rig.state()
    contact = rig.contact()
    held = solve(state.Phi + 1e-9 * np.eye(6), np.eye(6))
    H_inv_N = solve(state.S.T @ held @ state.S, state.S.T @ contact.N)
    eta = H_inv_N @ solve(contact.N.T @ state.S @ H_inv_N, 1e-4 * np.ones(contact.r))
    plant.reset(rig.q_contact + state.W @ eta)
    points = np.array([plant.data.contact[k].pos for k in range(plant.data.ncon)])
    X = plant.truth().X_WO
    assert len(points) >= len(rig.pairs)
    distances = []
    for pair in rig.pairs:
        places, directions = feet(pair, X)
        away = points - places.mean(axis=0)
        distances.append(norm(away, axis=1))
        near = distances[-1] < (0.12 if len(places) > 1 else 1e-3)
        assert near.any(), f"{pair.name}: nothing touches there"
        assert largest(away[near] @ directions[0]) < 2e-4
    assert np.min(distances, axis=0).max() < 0.12


@mark.parametrize("name", NAMES)
def test_limits_on_mujoco(runs, name):
    """And first contacts and steps at most 5 % above the command, from the first tick on."""
    verdict = osc.metrics(runs[name])
    firsts = [step for step in verdict["steps"] if step["what"] == "first contact"]
    assert len(verdict["force"]) == len(firsts) == ROBOTS[name][1]
    assert_accurate(verdict)
    assert np.ptp(runs[name]["pose"][:, :3], axis=0).max() > 0.01  # it does move
    for step in verdict["steps"]:
        assert step["overshoot_N"] <= 0.05 * abs(step["commanded_N"]), step


#: The other packaged scenarios: words of their first 3.3 s; whether no force overshoots.
WORDS = {
    "two_contact_rod_friction": ("OK", True),
    "two_contact_rod_mismatch": ("OK", True),
    "moving_face": ("OK", True),
    "approach_and_slide": ("OK", True),
    "panda_wrist": ("OK", True),
    "limited_rod": ("POOR", True),  # more is commanded than its motors can do, twice
    "collisions": ("POOR", False),  # pushed off its faces again and again, its forces not let in
}


@mark.parametrize("name", chosen(WORDS, "approach_and_slide", "limited_rod", "moving_face"))
def test_verdicts_of_the_other_scenarios(name):
    word, gentle = WORDS[name]
    verdict = verdict_of(name, duration=3.3)
    assert verdict["task"]["word"] == word, verdict["task"]
    for step in verdict["steps"] if gentle else ():
        assert step["overshoot_N"] <= 0.05 * max(abs(step["commanded_N"]), 1.0), step


def test_every_packaged_scenario_has_a_verdict_in_a_test():
    elsewhere = {"workcell", "two_contact_rod"}  # tests/test_workcell.py, tests/test_main_job.py
    assert {*WORDS, *NAMES, *elsewhere} == set(osc.scenarios.list_scenarios())


def test_a_corner_that_lifts_opens_the_contact(rigs):
    """Tipped by 20 mrad the block touches along an edge: no longer a face on a face."""
    rig = rigs["ur5_wipe"]
    plant = rig.plant()
    tipped = rig.state()
    eta = lstsq(tipped.S, np.array([0, 0, 0, 0, 0.02, 0.0]), rcond=None)[0]
    plant.reset(rig.q_contact + tipped.W @ eta)
    truth = plant.truth()
    assert plant.data.ncon > 0 and not truth.closed[0]


@mark.parametrize("name", first(NAMES, 1))
def test_it_can_be_looked_at(rigs, runs, name, tmp_path):
    page = write_scene_of(runs[name], rigs[name], tmp_path / "scene.html")
    assert page.stat().st_size > 100_000


def test_columns_of_the_recording_belong_together(runs):
    """One face with three columns; three posts with one each."""
    for name, names, owners in (
        ("ur5_wipe", ["cloth.1", "cloth.2", "cloth.3"], [0, 0, 0]),
        ("three_arm_plate", ["post_1", "post_2", "post_3"], [0, 1, 2]),
    ):
        recording = runs[name]
        assert recording.magnitude_names == names and recording.meta["columns"] == owners
        count = len(set(owners))
        assert recording["N"].shape[1:] == (6, 3) and recording["alpha_true"].shape[1:] == (3,)
        assert recording["closed"].shape[1:] == (count,)
        assert recording["contact_point"].shape[1:] == (count, 3)


def test_only_pairs_that_push_must_push(rigs):
    assert all(pushes_only(pair) for rig in rigs.values() for pair in rig.pairs)
    hole = osc.CylinderInHole([0, 0, 0], [0, 0, 1], [0, 0, 0], [0, 0, 1])
    assert not pushes_only(hole)


def test_a_peg_in_a_hole_without_play_takes_forces_of_either_sign_on_the_rigid_plant():
    """cylinder_in_hole, r = 4, held by a Panda; one magnitude is commanded negative."""
    wanted = {"hole.1": 5.0, "hole.2": -3.0, "hole.3": 2.0, "hole.4": 1.0}
    changes = {
        "plant": "{type: rigid, step: 1 ms}",
        "environment": "[{name: socket, urdf: socket.urdf, "
        "pose: {xyz: [0.45, 0.05, 0.3], rpy: [0.1, -0.1, 0.3]}}]",
        "object": "{urdf: peg.urdf, pose: {xyz: [0.45, 0.05, 0.43]}}",
        "grasps.panda": "{xyz: [0, 0, 0], rpy: [180 deg, 0, 0]}",
        "contacts": "[{name: hole, type: cylinder_in_hole, body: socket, point: [0, 0, -0.13], "
        "direction: [0, 0, 1], length: 40 mm, hole_point: [0, 0, 0], hole_direction: [0, 0, 1]}]",
        "force": str({k: [{"type": "constant", "value": v}] for k, v in wanted.items()}),
        "motion": "[{kind: linear, direction: [0, 0, 1], signals: [{type: sine, "
        "amplitude: 10 mm, frequency: 1 Hz, ramp: 0.1 s}]}]",
    }
    rig = osc.build_rig(osc.load_scenario("panda_edge", changes))
    assert rig.contact().r == 4 and "of either sign" in "\n".join(inspect_rig(rig).lines)
    recording = osc.run(rig.scenario, duration=0.3)
    assert_allclose(recording["alpha_true"][-1], list(wanted.values()), atol=5e-3)
    assert recording["contact_seen"][-1, :3].all()  # hole.2 pulls and counts by its size
    assert (recording["alpha_meas"][-1, 1] < -2.9) and recording["contact_seen"].shape[1] == 4
