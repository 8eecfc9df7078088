"""Approach from the standoff of a tare: joints stay within half of their speed limits."""

from dataclasses import replace

from numpy.linalg import solve
from pytest import approx
from rigs import largest, vector
from samples import parametrize

import osc_contact as osc
from benchmarks.random_tasks import draw
from osc_contact.lab.checks.preflight import preflight
from osc_contact.lab.rig.standoff import within_speed_limits
from osc_contact.lab.sweeps.rows import RigBuilder


@parametrize(
    "changes, most, duration",
    [
        ([], 3.0, 0.3),
        ([], 0.1, 0.75),
        (["tare.approach=0.2 s"], 0.1, 0.2),
        (["control.life={}"], 0.1, 0.75),
        (["tare=null"], 0.1, None),
    ],
)
def test_an_approach_takes_as_long_as_its_joints_need(changes, most, duration):
    """Half of the limit is 1.875 times the mean speed; joints without a limit do not count."""
    scenario = osc.load_scenario("panda_edge", ["tare={}", *changes])
    limits = vector(most, most, float("inf"), 0.0)
    found = within_speed_limits(scenario, vector(0.02, -0.01, 7.0, 7.0), limits)
    assert (found.tare and found.tare.approach) == (duration and approx(duration))


@parametrize("changes", [[], ["control.life={}"]])
def test_slow_joints_are_not_beyond_their_limits_in_the_approach(changes, own_plants):
    """Joint 4 of a Kinova, limit 0.84 rad/s, was to reach 0.9 rad/s: preflight refused the task."""
    task = draw(6938295, 15)
    rig = osc.build_rig(replace(task, changes=[*task.changes, *changes]).load())
    tare = rig.scenario.tare
    assert tare is not None and rig.references.scenario is rig.scenario
    fastest = rig.references.at(tare.duration + 0.5 * tare.approach).V_D
    speeds = solve(rig.state.arms[0].J, fastest)
    assert largest(speeds / rig.chain.model.velocityLimit) < 0.55
    assert not [one.text for one in preflight(rig) if one.refused]


def test_a_row_of_a_sweep_has_the_approach_of_a_single_run(own_plants):
    """Its scenario, which is recorded and run again, as its references."""
    scenario = draw(6938295, 15).load()
    tare = osc.build_rig(scenario).scenario.tare
    assert tare is not None and tare.approach > 0.31
    rig = RigBuilder().rig(scenario)
    assert rig.scenario.tare == tare == rig.references.scenario.tare
