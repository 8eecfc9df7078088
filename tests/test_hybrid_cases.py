"""The hybrid cases of another framework's tests: forces and places at every goal."""

from types import SimpleNamespace

import numpy as np
from numpy.linalg import norm
from pytest import approx
from rigs import largest, placed, vector
from samples import parametrize

import osc_contact as osc
from benchmarks import force_laws
from benchmarks.hybrid_cases import CASES, RADIUS, judge, judge_samples, scenario_of
from osc_contact.spatial import pose_error


@parametrize("case", CASES, ids=lambda case: case.name)
def test_the_finger_is_at_its_goal_with_the_desired_force(case):
    recording = osc.run(scenario_of(case))
    force, place, turn = judge(case, recording).max(axis=0)
    assert force < 0.05 and place < 5e-4 and turn < 5e-4
    assert np.asarray(recording["closed"]).mean() > 0.999
    pose = np.asarray(recording["pose"])  # by hand: a finger's radius before the wall, at the goal
    n = case.normal
    last = case.goals[-1].point
    assert n @ (pose[-1, :3] - case.wall) == approx(RADIUS, abs=1e-3)
    along = vector(-n[2], 0.0, n[0])
    assert along @ pose[-1, :3] == approx(along @ last, abs=1e-3)
    assert pose[-1, 1] == approx(last[1], abs=1e-3)
    assert np.ptp(pose[:, 1]) > 0.4  # it did go along the wall


@parametrize("case", CASES, ids=lambda case: case.name)
def test_wrong_masses_and_friction_cost_little(case):
    """The tests these cases come from accept 5 N in the median."""
    force, place, turn = judge_samples(case, 3).max(axis=(0, 1))
    assert force < 1.0 and place < 0.01 and turn < 0.02


@parametrize("name", [force_laws.OURS, "Isaac Lab 3, rebuilt", "CRISP, rebuilt"])
def test_laws_of_other_software_do_what_is_commanded(name):
    done = force_laws.follow(force_laws.steps(), CASES[0], force_laws.LAWS[name])
    assert len(done.force) == done.planned
    for end in (399, 799, 1199):
        assert done.force[end] == approx(done.force_goal[end], rel=0.05)
    assert done.force_goal[-1] == CASES[0].goals[0].force + force_laws.FORCE_STEP
    assert largest(done.off[-1, :2]) < 1e-3 < 4e-3 < largest(done.off[800, :2])


def test_damping_acts_only_near_a_singular_posture():
    rng = np.random.default_rng(1)
    J, root, a = rng.standard_normal((6, 7)), rng.standard_normal((7, 7)), np.zeros(7)

    def torques(thresholds, J):
        s = SimpleNamespace(q=a, v=a, V=np.zeros(6), J=J, M=root @ root.T + np.eye(7), gravity=a)
        s.error = pose_error(placed(0.01), placed())
        s.axis = vector(0.0, 0.0, 1.0)
        s.force = s.force_goal = 0.0
        return force_laws.isaac_lab(s, CASES[0], thresholds)(s)

    np.testing.assert_allclose(torques(force_laws.DAMPED, J), torques(None, J), rtol=1e-9)
    J[0] = J[1] + 1e-5 * J[0]
    assert norm(torques(force_laws.DAMPED, J)) < 1e-2 * norm(torques(None, J))
