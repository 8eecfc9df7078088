"""Sensors that lie: which readings are rejected, which may be missing, what stops the arms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_array_equal
from pytest import fixture
from rigs import assert_near, rig_of, ticked
from samples import parametrize

import osc_contact as osc
from benchmarks.cases import CASES
from osc_contact.interface import Stamps

RUN, DEGRADED, HOLD, SAFE_STOP = osc.SafetyState
NAN = float("nan")


@fixture
def case():
    return CASES["two_contact_rod"]()


def test_ticks_without_a_wrench_use_the_last_one_for_a_while(case):
    gone = replace(case.measurement, wrenches=np.full((2, 6), NAN), wrench_valid=False)
    controller = case.controller()
    other = case.controller()
    for each in (controller, other):
        each.tick(*case.given)
    sums = controller.force_integral.copy()
    states = []
    for _ in range(25):
        tau = controller.tick(gone, case.reference)
        expected = other.tick(*case.given)
        other.force_integral = sums  # what is old is not integrated
        states.append(controller.state)
        if len(states) == 1:
            assert_near(tau, expected, atol=1e-1, rtol=0)
        if len(states) <= 20:
            assert_array_equal(controller.force_integral, sums)
    assert states == [DEGRADED] * 20 + [DEGRADED] * 2 + [HOLD] * 3
    assert "no wrench was read for longer than wrench_timeout" in controller.reason
    first = case.controller()
    first.tick(gone, case.reference)
    assert first.status is osc.Status.HELD  # there is no last one


def test_packets_that_repeat_are_used_for_a_while_and_late_ones_are_not(case):
    def number(k):
        return replace(case.measurement, sequence=k)

    controller = case.controller()
    controller.tick(number(4), case.reference)
    for k, status in ((5, "OK"), (5, "OK"), (3, "HELD"), (6, "OK"), (60, "OK")):
        controller.tick(number(k), case.reference)
        assert controller.status is osc.Status[status], (k, controller.reason)
        if status == "HELD":
            assert "a packet came after a newer one" in controller.reason
    held = []
    for _ in range(45):
        controller.tick(number(60), case.reference)
        held.append(controller.status is osc.Status.HELD)
    assert held.index(True) == 20  # ms of wrench_timeout
    assert controller.state is SAFE_STOP
    assert controller.unbraked is not None
    assert "engage the mechanical brakes" in controller.reason
    controller.reset()
    ticked(controller, number(0), case.reference)


@parametrize("late", ["encoders", "wrists"])
def test_readings_that_grow_old_are_not_run_on(case, late):
    controller = case.controller()
    fine = []
    for k in range(60):
        stamps = Stamps(*[1e-3 * k] * 4)
        if k > 10:
            stamps = replace(stamps, **{late: 0.01})
        controller.tick(replace(case.measurement, stamps=stamps), case.reference)
        fine.append(controller.status is osc.Status.OK)
    assert fine.index(False) == 31  # 20 ms after the last one
    assert controller.state is SAFE_STOP
    assert "no new readings" in controller.reason


@parametrize(
    "given, sentence",
    [
        ({"stamps": 0.25}, "stamps is 0.25; give osc.Stamps(encoders=t, wrists=t)"),
        ({"stamps": Stamps("now")}, "stamps is Stamps(encoders='now'"),
        ({"sequence": "packet 7"}, "sequence is 'packet 7'; give the number of the packet"),
        ({"touched": 3}, "touched takes a Touched, got 3; give osc_contact.interface.Touched("),
    ],
)
def test_readings_of_other_types_are_held_and_named(case, given, sentence):
    controller = case.controller()
    ticked(controller, case.measurement, case.reference)
    assert np.isfinite(controller.tick(replace(case.measurement, **given), case.reference)).all()
    assert controller.status is osc.Status.HELD
    assert sentence in controller.reason


@parametrize("bad", [NAN, 1e6, 0.5])
def test_an_observed_arm_runs_on_after_one_bad_encoder_sample(bad):
    rig = rig_of("workcell")
    plant = rig.plant(0)
    m = plant.measure()
    observed = rig.robot(plant, rig.controller())
    observed.robot = SimpleNamespace(measure=lambda: read)
    for k in range(300):
        stamps = Stamps(*[1e-3 * k] * 4)
        q = m.q + 1e-4 * k
        if k == 150:
            q = q.copy()
            q[2] += bad
        read = replace(m, q=q, stamps=stamps)
        seen = observed.measure()
        assert np.isnan(seen.q).any() == (k == 150)
    assert_near(seen.v[:4], 0.1, rtol=0.1)


@parametrize("share, ends", [(0.99, RUN), (1.01, SAFE_STOP)])
def test_arms_that_have_the_object_at_different_places_stop(case, share, ends):
    q = case.measurement.q.copy()
    lift = case.chain.joint_names.index("right/joint3")  # m, up
    q[lift] += share * osc.SafetySettings().closure_error
    controller = case.controller()
    for _ in range(20):
        controller.tick(replace(case.measurement, q=q), case.reference)
    assert controller.state is ends
    assert ("hold the object" in controller.reason) == (ends is SAFE_STOP)
