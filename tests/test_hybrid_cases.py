"""The hybrid cases of another framework's tests: forces and places at every goal."""

import numpy as np
from pytest import approx, mark

import osc_contact as osc
from benchmarks.hybrid_cases import CASES, RADIUS, judge, judge_samples, scenario_of


@mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_finger_is_where_it_is_asked_to_be_with_the_force_it_is_asked_for(case):
    recording = osc.run(scenario_of(case))
    force, place, turn = judge(case, recording).max(axis=0)
    assert force < 0.05 and place < 5e-4 and turn < 5e-4
    closed = np.asarray(recording["closed"])
    assert closed.mean() > 0.999
    pose = np.asarray(recording["pose"])  # by hand: a finger's radius before the wall, at the goal
    n = np.array(case.normal)
    last = np.array(case.goals[-1].point)
    assert n @ (pose[-1, :3] - np.array(case.wall)) == approx(RADIUS, abs=1e-3)
    along = np.array([-n[2], 0.0, n[0]])
    assert along @ pose[-1, :3] == approx(along @ last, abs=1e-3)
    assert pose[-1, 1] == approx(last[1], abs=1e-3)
    assert np.ptp(pose[:, 1]) > 0.4  # it did go along the wall


@mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_wrong_masses_and_friction_cost_little(case):
    """The tests these cases come from accept 5 N in the median."""
    force, place, turn = judge_samples(case, 3).max(axis=(0, 1))
    assert force < 1.0 and place < 0.01 and turn < 0.02
