"""Sensors that lie: which readings are rejected, which may be missing, what stops the arms."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import fixture
from rigs import held_tick, rig_of, rigid_plant, ticked
from samples import parametrize

import osc_contact as osc
from benchmarks.cases import CASES
from osc_contact.interface import Stamps
from osc_contact.sensing.velocity_estimate import VelocityEstimate

RUN, DEGRADED, HOLD, SAFE_STOP = osc.SafetyState
NAN = float("nan")


@fixture
def case():
    return CASES["two_contact_rod"]()


def driven(case, change, ticks, begin=20):
    """A controller on the exact plant whose readings are changed from a tick on."""
    plant = rigid_plant(case.measurement.q, case.chain, case.pairs)
    controller = case.controller()
    start = case.reference.X_WD
    for k in range(begin + ticks):
        seen = plant.measure()
        given = change(seen, k - begin) if k >= begin else seen
        goal = pin.SE3(start.rotation, start.translation + np.array([1e-4 * k, 0.0, 0.0]))
        plant.command(controller.tick(given, replace(case.reference, X_WD=goal)), 1e-3)
        if k == begin - 1:
            assert controller.state is RUN, controller.reason
    return controller


def moved(m, joint, by):
    q = m.q.copy()
    q[joint] += by
    return replace(m, q=q)


def test_a_rotation_that_is_none_is_refused(case):
    X = case.reference.X_WD.copy()
    X.rotation = 1.01 * X.rotation
    controller = case.controller()
    wrong = replace(case.reference, X_WD=X)
    held_tick(controller, "its rotation is none", case.measurement, wrong)
    X.rotation = np.array(case.reference.X_WD.rotation, dtype=np.float32).astype(float)
    controller.reset()
    ticked(controller, case.measurement, replace(case.reference, X_WD=X))


def test_a_wrench_that_no_sensor_measures_is_rejected(case):
    controller = case.controller()
    last = controller.tick(*case.given)
    sums = controller.force_integral.copy()
    wrenches = case.measurement.wrenches.copy()
    wrenches[1, 2] = -1001.0
    tau = controller.tick(replace(case.measurement, wrenches=wrenches), case.reference)
    assert controller.status is osc.Status.HELD
    assert f"arm '{case.chain.arms[1].name}' reads more than it measures" in controller.reason
    assert_array_equal(tau, last)
    assert_array_equal(controller.force_integral, sums)
    ticked(controller, *case.given)
    assert controller.state is RUN


def pushed(m, by):
    """The second joint reads so much more."""
    return moved(m, 1, by)


HELD = {}


def stuck(m, k):
    HELD.setdefault(k, m.q[1])
    alone = np.arange(len(m.q)) == 1
    return replace(m, q=np.where(alone, HELD[0], m.q), v=np.where(alone, 0.0, m.v))


def noisy(m, k):
    """A scale error of 4 %, noise of 0.1 mrad (mm) and 20 mrad/s."""
    rng = default_rng(k)
    noise = rng.standard_normal((2, len(m.q)))
    return replace(m, q=m.q + 1e-4 * noise[0], v=1.04 * m.v + 0.02 * noise[1])


#: What the readings become, for how many ticks, and what is reported; None: nothing.
READINGS = {
    "a jump": (lambda m, k: pushed(m, 0.5), 20, "joint .* jumps"),
    "one jump": (lambda m, k: pushed(m, 0.5 * (k == 0)), 30, None),
    "noise of encoders": (lambda m, k: pushed(m, 0.015), 2, None),
    "an encoder that stands still": (stuck, 300, "reads the very same|is not that of"),
    "another speed": (lambda m, k: replace(m, v=m.v + np.eye(len(m.v))[0]), 40, "is not that of"),
    "a slow slip": (lambda m, k: pushed(m, 1e-4 * k), 300, "from what speeds add up to"),
    "a slip back": (lambda m, k: pushed(m, -3e-4 * k), 300, "from what speeds add up to"),
    "dead wrists": (lambda m, k: replace(m, wrenches=0.0 * m.wrenches), 255, "the very same"),
    "fair readings": (noisy, 600, None),
}


@parametrize("what", READINGS)
def test_readings_that_contradict_one_another_stop_the_arms(case, what):
    change, ticks, words = READINGS[what]
    controller = driven(case, change, ticks)
    assert (controller.state is SAFE_STOP) == (words is not None), controller.reason
    assert words is None or re.search(words, controller.reason), controller.reason
    controller.reset()
    controller.tick(*case.given)
    assert controller.state is RUN, controller.reason


def test_a_packet_that_repeats_itself_in_free_motion_stops_the_arms(case):
    free = osc.Controller(case.chain, (), case.gains, posture=case.posture)
    still = replace(case.measurement, v=np.zeros(case.chain.nq))
    X = case.chain.state(still.q, still.v).X_WO
    for ticks in range(252):
        assert (free.state is SAFE_STOP) == (ticks == 251)
        free.tick(still, osc.Reference(X))
    assert "a packet repeats itself" in free.reason


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
        want = other.tick(*case.given)
        other.force_integral = sums  # what is old is not integrated
        states.append(controller.state)
        if len(states) == 1:
            assert_allclose(tau, want, rtol=0, atol=1e-1)
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
            assert f"packet {k} came" in controller.reason
    for _ in range(45):
        controller.tick(number(60), case.reference)
    assert controller.state is SAFE_STOP
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


def test_rows_of_a_batch_judge_their_own_sensors(case):
    batch = osc.BatchController([case.controller() for _ in range(4)])
    one = case.controller()
    m = case.measurement
    r = case.reference

    def four(x):
        return np.tile(np.asarray(x, dtype=float), (4,) + (1,) * np.ndim(x))

    q = four(m.q)
    wrenches = four(m.wrenches)
    X = four(r.X_WD.homogeneous)
    for k in range(25):
        if k == 1:
            q[1, case.chain.actuated[0]] += 0.6
            wrenches[2, 0, 0] = 1e4
        valid = np.array([True, True, True, k < 1])
        tau = batch.tick(
            q,
            four(m.v),
            wrenches,
            X,
            V_D=four(r.V_D),
            A_D=four(r.A_D),
            alpha_d=four(r.alpha_d),
            squeeze_d=np.full(4, float(r.squeeze_d)),
            wrench_valid=valid,
        )
        assert_array_equal(tau[3], one.tick(replace(m, wrench_valid=k < 1), r))
    assert batch.state.tolist() == [RUN, SAFE_STOP, SAFE_STOP, HOLD]


def test_one_bad_encoder_sample_does_not_blind_the_velocity_estimate():
    estimate = VelocityEstimate.with_bandwidth(np.array([200.0, 200.0]), 1e-3)
    for k in range(400):
        x = np.array([0.5e-3 * k, -1e-3 * k])
        if k == 200:
            x[0] = NAN
        position, speed = estimate.update(x)
    assert_allclose(speed, [0.5, -1.0], rtol=1e-6)
    assert_allclose(position, x, rtol=1e-6)


@parametrize("bad", [NAN, 1e6, 0.5])
def test_an_observed_arm_runs_on_after_one_bad_encoder_sample(bad):
    rig = rig_of("workcell")
    observer = rig.observer()
    m = rig.plant(0).measure()
    for k in range(300):
        stamps = Stamps(*[1e-3 * k] * 4)
        q = m.q + 1e-4 * k
        if k == 150:
            q = q.copy()
            q[2] += bad
        seen = observer.complete(replace(m, q=q, stamps=stamps), None)
        assert np.isnan(seen.q).any() == (k == 150)
    assert_allclose(seen.v[:4], 0.1, rtol=0.1)
