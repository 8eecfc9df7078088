"""Stopped arms whose encoders, without noise, stand still: brakes are requested."""

from typing import NamedTuple

import numpy as np
from rigs import vector
from samples import first, parametrize

import osc_contact as osc
from benchmarks.fault_injection import Case, Run, Verdict
from osc_contact.sensing.dead_packets import DeadPackets

DEAD = "encoders stuck, speeds too"
REST = vector(0.1, 0.2)


@parametrize("changes, dead", [(False, True), (True, False)])
def test_constant_readings_are_dead_once_a_stop_has_released_the_arms(changes, dead):
    """Where none changes for 50 ms after the stop; before, nothing shows it."""
    packets = DeadPackets(1e-3)
    assert not any(packets.update(REST, 0.0) for _ in range(300))
    found = []
    for k in range(1, 100):
        moved = REST + (vector(0.0, 1e-5) if changes and k > 20 else 0.0)
        found.append(packets.update(moved, released_for=1e-3 * k))
    assert any(found) == dead
    if dead:
        assert found.index(True) == 49


@parametrize("period", [1e-3, 4e-3])
def test_a_packet_that_changes_again_is_sound(period):
    packets = DeadPackets(period)
    ticks = round(0.1 / period)
    assert [packets.update(REST, period * k) for k in range(ticks)][-1]
    assert not packets.update(REST + 1e-5, 0.1)
    assert not any(packets.update(REST + 1e-5, 0.1 + period * k) for k in range(ticks))


class Stuck(NamedTuple):
    """A run in which all encoders, without noise, stand still from a drawn moment on.

    Attributes:
        bits: of the encoders.
        friction: of the joints, share of the smallest motor's limit.
        is_soft: whether contact forces stay within their limit until the arms are stopped.
    """

    scenario: str
    bits: int
    friction: float
    seed: int
    is_soft: bool = True


STUCK = (
    Stuck("ur5_wipe", 18, 0.02, 717, is_soft=False),  # 31 to 65 N in drawn runs
    Stuck("two_contact_rod", 16, 0.01, 715),
    Stuck("panda_dome", 18, 0.01, 705),
    Stuck("approach_and_slide", 18, 0.02, 700),
    Stuck("dual_panda_rod", 18, 0.0, 708),
    Stuck("dual_panda_rod", 18, 0.02, 727),
    Stuck("limited_rod", 16, 0.01, 714),
)


@parametrize("how", first(STUCK, 4), ids=str)
def test_brakes_are_requested_where_noiseless_encoders_stand_still(how):
    """Such arms are not braked by motors: joints went to 27 rad/s, contact forces to 71 N."""
    step = 2.0 * np.pi / 2**how.bits
    steps = f"angle: {{resolution: {step} rad}}, length: {{resolution: {step} m}}"
    changes = [f"sensors.encoder={{rate: 1 kHz, {steps}}}", f"plant.joint_friction={how.friction}"]
    scenario = osc.load_scenario(how.scenario, changes)
    run = Run(Case(scenario=how.scenario, seed=how.seed), DEAD, scenario=scenario)
    before = Verdict("no fault", run.case)
    while run.k < run.first:
        run.step(before)
    assert not before.wrong and run.estimated
    verdict = run.judge(DEAD, fault_for=3.0, stopped_for=1.0)
    wrong = [words for words in verdict.wrong if how.is_soft or "contact force" not in words]
    assert not wrong, verdict
    assert verdict.unbraked
    assert verdict.stopped is not None and verdict.stopped < 1.0


@parametrize("scenario", ["ur5_wipe", "panda_edge"])
def test_a_joint_without_position_has_no_speed_if_speeds_are_estimated(scenario):
    """The last estimate of its speed was held for ever, and the stopped arm was moved by it."""
    turn = 2.0 * np.pi / 2**18
    steps = f"angle: {{resolution: {turn} rad, noise: {turn} rad}}, length: {{noise: 1e-5}}"
    loaded = osc.load_scenario(scenario, [f"sensors.encoder={{rate: 1 kHz, {steps}}}"])
    run = Run(Case(scenario=scenario, seed=31), "encoder NaN for ever", scenario=loaded)
    before = Verdict("no fault", run.case)
    while run.k < run.first:
        run.step(before)
    assert not before.wrong and run.estimated
    verdict = run.judge("encoder NaN for ever", fault_for=1.0, stopped_for=1.0)
    assert verdict.unbraked, verdict
    assert verdict.stopped is not None and verdict.stopped < 0.1
