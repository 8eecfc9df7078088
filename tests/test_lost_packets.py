"""Packets that are lost, repeated or late, in closed loop with MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from rigs import largest
from samples import parametrize

import osc_contact as osc
from benchmarks.fault_injection import FAULTS, NAN, Case, Run, Verdict
from osc_contact.law.phases import CLOSED

RUN, DEGRADED, HOLD, SAFE_STOP = osc.SafetyState


def driven(change, ticks):
    """Main job's rod with changed measurements, and the status of each tick."""
    run = Run(Case())
    status = []
    seen = Verdict("no fault", run.case)
    measure = run.robot.measure
    run.robot.measure = lambda: change(measure(), run.k)
    for _ in range(ticks):
        run.step(seen, None, FAULTS["no fault"])
        status.append(int(run.controller.status))
    assert not seen.wrong, seen.wrong
    return run, status


def lost(m):
    return replace(m, q=m.q * NAN, v=m.v * NAN, wrenches=m.wrenches * NAN)


def test_a_sensor_at_half_the_rate_makes_no_tick_a_fault():
    kept: dict[str, osc.Measurement] = {}

    def half_rate(m, k):
        if k % 2 == 0:
            kept["packet"] = replace(m, sequence=k // 2)
        return kept["packet"]

    run, status = driven(half_rate, 1500)
    assert set(status) == {int(osc.Status.OK)}
    assert run.controller.state is RUN and run.controller.state_age == 1500
    assert run.controller.repeated == 1, "the last packet came twice"
    alpha = run.plant.truth().alpha
    assert_allclose(alpha, run.rig.references.at(1.5).alpha_d, rtol=0.05)


def test_a_packet_that_repeats_for_longer_than_a_wrench_may_is_a_fault():
    kept: dict[str, osc.Measurement] = {}

    def stands(m, k):
        if k <= 300:
            kept["packet"] = replace(m, sequence=k)
        return kept["packet"]

    run, status = driven(stands, 345)
    assert status.index(int(osc.Status.HELD)) == 321  # wrench_timeout = 20 ms
    assert run.controller.state is SAFE_STOP
    assert run.controller.unbraked is not None
    assert "engage the mechanical brakes" in run.controller.reason


@parametrize(("lost_of", "stops"), [((1, 2), False), ((2, 3), True), ((19, 20), True)])
def test_more_than_half_of_the_ticks_must_not_be_lost_for_long(lost_of, stops):
    n, m = lost_of

    def change(measurement, k):
        return lost(measurement) if k >= 100 and k % m < n else measurement

    run, _ = driven(change, 500)
    assert (run.controller.state is SAFE_STOP) == stops, run.controller.reason


def test_arms_whose_wrist_is_frozen_are_held_where_they_are():
    """Gravity is 5° off what the controller knows, so that without their encoders arms creep."""
    run = Run(Case())
    seen = Verdict("no fault", Case())
    down = run.plant.model.opt.gravity
    down[:] = 9.81 * np.array([np.sin(np.deg2rad(5.0)), 0.0, -np.cos(np.deg2rad(5.0))])
    measure = run.robot.measure
    kept = {}

    def frozen():
        m = measure()
        if run.k >= 300:
            return replace(m, wrenches=kept["wrenches"])
        kept["wrenches"] = m.wrenches
        return m

    run.robot.measure = frozen
    where = {}
    for _ in range(2100):
        run.step(seen, None, FAULTS["no fault"])
        where[run.k] = run.plant.measure().q
    assert run.controller.state is SAFE_STOP
    assert "reads the very same" in run.controller.reason
    assert largest(where[2100] - where[1100]) < 5e-3, "held, while the load settles"
    assert largest(where[2100] - where[1900]) < 2e-4, "and not creeping"


def test_speeds_estimated_from_encoders_are_no_second_reading_of_them():
    """Masses × 0.8 bias an estimate that trusts the model; no sensor is faulty."""
    scenario = osc.load_scenario(
        "panda_edge",
        [
            "control.estimate.joint_angular=0.5",
            "model_error.arm_mass=0.8",
            "model_error.object_mass=0.8",
            "sensors.encoder={rate: 500 Hz, angle: {noise: 0.02 mrad}, length: {noise: 10 um}}",
            "tare={}",
        ],
    )
    recording = osc.run(scenario, duration=1.0)
    assert recording.meta["end_state"] != "SAFE_STOP", recording.meta["end_reason"]


def test_contact_is_made_although_every_second_tick_is_lost():
    """Phases advance with what the last computed tick measured."""
    run = Run(Case("approach", "approach_and_slide", every=2))
    seen = Verdict("no fault", Case())
    while run.k < 1500:
        run.step(seen, None, FAULTS["no fault"])
    assert not seen.wrong, seen.wrong
    assert set(run.controller.phases()) == {CLOSED}
    assert_allclose(run.plant.truth().alpha, 10.0, rtol=0.2)


@parametrize(
    ("fault", "scenario", "every"),
    [
        ("speeds mirrored", "limited_rod", 0),  # hardly carries its weight, and brakes all the same
        ("encoder stuck", "hinge_ball_rod", 0),  # held 0.3 s after the stop, not creeping
        ("encoders stuck, speeds too", "panda_wrist", 0),  # at 2 mrad/s
        ("encoders stuck, speeds zero", "limited_rod", 2),  # commanded between two readings
    ],
)
def test_arms_rest_after_a_fault_that_is_hard_to_find(fault, scenario, every):
    run = Run(Case("contact", scenario, every))
    run.lead_in()
    verdict = run.judge(fault)
    assert verdict.state is SAFE_STOP and not verdict.wrong, verdict
