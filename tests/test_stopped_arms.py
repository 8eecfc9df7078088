"""Stopped arms for 15 s: they stay where they are, and encoders that die meanwhile are found.

Gravity is wrong by some degrees, joints rub, encoders are ideal, coarse or noisy, the wrists are
dead, and the moments of the stop and of the next fault are drawn.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from law_calls import holding, records, write
from pytest import mark
from rigs import assert_near, vector
from samples import first, parametrize
from scenario_runs import run_of

import osc_contact as osc
from benchmarks.fault_injection import REST_AFTER, REST_SPEED, REST_TRAVEL, Run, Verdict
from benchmarks.fault_injection import Case as Place
from benchmarks.faults import NAN
from osc_contact.law import records as at
from osc_contact.law.agreement import UNBALANCED
from osc_contact.law.plausibility import OUT_OF_RANGE
from osc_contact.law.records import FAULTY_SPEED

SAFE_STOP = osc.SafetyState.SAFE_STOP
WATCHED = 15.0  #: s after the stop
LARGEST = 100.0  #: N, of contact forces after readings were swapped
SCENARIOS = (
    "panda_edge",
    "ur5_wipe",
    "two_contact_rod",
    "panda_dome",
    "scara_peg",
    "limited_rod",
    "dual_panda_rod",
    "approach_and_slide",
)


class Stop(NamedTuple):
    """A run whose wrists die at a moment (s), and what dies so many seconds after the stop.

    Attributes:
        tilt: of gravity against the model's (°).
        reading: of the encoders, see `READINGS`.
        friction: of the joints, share of the motors' limits.
        dies: see `DEATHS`; None: nothing.
    """

    scenario: str
    moment: float
    tilt: float
    reading: str
    friction: float
    dies: str | None = None
    after: float = 0.0
    seed: int = 0


def coarse(m, rng):
    """Steps of 1e-5 rad (m), and of 1e-4 rad/s."""
    return replace(m, q=np.round(m.q / 1e-5) * 1e-5, v=np.round(m.v / 1e-4) * 1e-4)


READINGS = {
    "ideal": lambda m, rng: m,
    "positions in steps": lambda m, rng: replace(m, q=coarse(m, rng).q),
    "in steps": coarse,
    "noisy": lambda m, rng: replace(m, q=m.q + 1e-5 * rng.standard_normal(m.q.shape)),
}
#: what is repeated for ever, of all joints or of one
DEATHS = {"packet": ("q", "v", "wrenches"), "joint": ("q", "v"), "encoder": ("q",)}


@dataclass
class Seen:
    """What a stopped arm did.

    Attributes:
        travel, speed: rad, rad/s (m, m/s), beyond braking, and from half a second on.
        stopped, unbraked, found: s, when the arms were stopped, brakes were requested, and some
            reading was found faulty; None: never.
    """

    travel: float = 0.0
    speed: float = 0.0
    stopped: float | None = None
    unbraked: float | None = None
    found: float | None = None
    reasons: list = field(default_factory=list)


def stop(how):
    """Run until the wrists die, and for `WATCHED` seconds after the stop or until the brakes."""
    rubs = [f"plant.joint_friction={how.friction}"] if how.friction else []
    place = Place(scenario=how.scenario, seed=how.seed)
    run = Run(place, scenario=osc.load_scenario(how.scenario, rubs))
    angle = np.deg2rad(how.tilt)
    run.true.model.opt.gravity[:] = 9.81 * vector(np.sin(angle), 0.0, -np.cos(angle))
    rng = np.random.default_rng(how.seed)
    joint = int(rng.choice(run.act))
    seen = Seen()
    kept = {}
    measure = run.robot.measure

    def faulty():
        t = run.k * run.dt
        m = READINGS[how.reading](measure(), rng)
        if t >= how.moment:
            m = replace(m, wrenches=NAN * m.wrenches)
        if how.dies and seen.stopped is not None and t >= seen.stopped + how.after:
            for name in DEATHS[how.dies]:
                x = getattr(m, name).copy()
                dead = ... if how.dies == "packet" else joint
                x[dead] = kept.setdefault(name, x[dead].copy())
                m = replace(m, **{name: x})
        return m

    run.robot.measure = faulty
    verdict = Verdict("no fault", run.case)
    control = run.controller
    start = braking = None
    while seen.unbraked is None and run.k * run.dt < (seen.stopped or how.moment) + WATCHED:
        run.step(verdict)
        assert not verdict.wrong, verdict.wrong
        if control.state is not SAFE_STOP:
            continue
        true = run.true.measure()
        q, speeds = true.q[run.act], np.abs(true.v[run.act])
        t = run.k * run.dt
        if seen.stopped is None:
            seen.stopped = t
            start, braking = q, speeds * control.records.model.reaction
        if seen.found is None and control.records.memory.joints.faulty.any():
            seen.found = t - seen.stopped
        if control.unbraked is not None:
            seen.unbraked = t - seen.stopped
            break
        seen.travel = max(seen.travel, float((np.abs(q - start) - braking).max()))
        if t > seen.stopped + REST_AFTER:
            seen.speed = max(seen.speed, float(speeds.max()))
    seen.reasons.append(control.reason)
    return seen


def drawn(count, seed, deaths):
    """Stops drawn over scenarios, errors and moments."""
    rng = np.random.default_rng(seed)

    def one(values):
        return values[rng.integers(len(values))]

    return [
        Stop(
            one(SCENARIOS),
            round(float(rng.uniform(0.05, 2.0)), 3),
            one((0.0, 1.0, 5.0)),
            one(tuple(READINGS)),
            one((0.0, 0.01)),
            one(deaths),
            round(float(rng.uniform(1.5, 5.0)), 3),
            k,
        )
        for k in range(count)
    ]


#: those that drove on their own before
WORST = (
    Stop("panda_edge", 0.5, 5.0, "ideal", 0.01),
    Stop("ur5_wipe", 0.6, 1.0, "in steps", 0.01),
    Stop("two_contact_rod", 0.7, 1.0, "in steps", 0.01),
    Stop("panda_edge", 0.5, 1.0, "in steps", 0.0),
)


@parametrize("how", first([*WORST, *drawn(24, 54, (None,))], len(WORST)), ids=str)
def test_stopped_arms_stay_where_they_are(how):
    seen = stop(how)
    assert seen.stopped is not None
    assert seen.unbraked is None and seen.found is None, "its joints are sound"
    assert seen.travel < REST_TRAVEL and seen.speed < REST_SPEED, seen


#: of ideal, coarse and noisy sensors; of arms without friction
DEAD = (
    Stop("panda_edge", 0.5, 1.0, "in steps", 0.0, "packet", 2.0),
    Stop("two_contact_rod", 0.7, 0.0, "ideal", 0.0, "packet", 3.5),
    Stop("ur5_wipe", 0.4, 5.0, "noisy", 0.01, "packet", 1.5),
    Stop("panda_dome", 0.6, 1.0, "in steps", 0.0, "joint", 2.5),
)


@parametrize("how", first(DEAD, 2), ids=str)
def test_a_packet_or_joint_that_dies_while_the_stopped_arm_rests_is_found(how):
    """Within the time in which a hold is moved, or `frozen_time`."""
    seen = stop(how)
    assert seen.unbraked is not None and seen.found == seen.unbraked, "in the same tick"
    assert 0.0 < seen.unbraked - how.after < 0.35
    assert seen.travel < REST_TRAVEL and seen.speed < REST_SPEED, seen
    assert "engage the mechanical brakes" in seen.reasons[0]


def test_an_encoder_that_dies_while_the_stopped_arm_rests_is_replaced_by_its_speed():
    seen = stop(Stop("panda_edge", 0.5, 5.0, "positions in steps", 0.0, "encoder", 2.0))
    assert seen.found is not None and seen.unbraked is None
    assert seen.travel < REST_TRAVEL and seen.speed < REST_SPEED, seen


@mark.slow
@parametrize("how", drawn(24, 55, tuple(DEATHS)), ids=str)
def test_whatever_dies_stopped_arms_stay_where_they_are(how):
    """A dead encoder may remain undetected if friction holds the joint; it does not move."""
    seen = stop(how)
    assert seen.stopped is not None
    assert seen.travel < REST_TRAVEL and seen.speed < REST_SPEED, seen
    assert seen.unbraked is None or seen.unbraked >= how.after


# --- encoders and speeds swapped ------------------------------------------------------------------


class Swap(NamedTuple):
    """Joints, or arms (None), whose readings are swapped from a moment on (s)."""

    scenario: str
    moment: float
    joints: tuple[int, int] | None
    names: tuple[str, ...] = ("q", "v")


def swap(how):
    """The largest contact force (N) until the brakes are requested and 0.1 s later; the run."""
    run = Run(Place(scenario=how.scenario))
    order = np.arange(run.rig.model.nq)
    if how.joints is None:
        n = run.rig.model.arms[0].model.nq
        order = np.roll(order, n)
    else:
        order[list(how.joints)] = how.joints[::-1]
    measure = run.robot.measure

    def swapped():
        m = measure()
        if run.k * run.dt < how.moment:
            return m
        return replace(m, **{name: getattr(m, name)[order] for name in how.names})

    run.robot.measure = swapped
    verdict = Verdict("no fault", run.case)
    force = 0.0
    end = how.moment + 1.0
    while run.k * run.dt < end:
        run.step(verdict)
        assert not verdict.wrong, verdict.wrong
        t = run.k * run.dt
        if run.controller.unbraked and end > t + 0.1:
            end = min(end, t + 0.1)
        if t > how.moment:
            force = max(force, *np.abs(run.plant.truth().alpha).tolist())
    return (force, run)


SWAPS = (
    Swap("two_contact_rod", 0.8, None),
    Swap("two_contact_rod", 1.7, (0, 5)),
    Swap("panda_edge", 0.8, (1, 3)),
    Swap("two_contact_rod", 1.3, None, ("q",)),
    Swap("panda_edge", 1.4, (3, 5)),
    Swap("dual_panda_rod", 1.1, None),
    Swap("ur5_wipe", 1.3, (1, 2)),
)


@parametrize("how", first(SWAPS, 4), ids=str)
def test_readings_that_are_swapped_are_used_for_nothing(how):
    force, run = swap(how)
    assert force < LARGEST
    assert run.controller.state is SAFE_STOP
    assert "jump in one packet" in run.controller.reason
    assert run.controller.unbraked is not None
    assert "engage the mechanical brakes" in run.controller.reason


def test_brakes_are_requested_in_the_tick_in_which_a_mixed_packet_stops_the_arms():
    how = SWAPS[0]
    _, run = swap(how)
    age = run.controller.state_age
    stopped = run.k - age
    assert stopped * run.dt - how.moment < 0.02


# --- no false stops -------------------------------------------------------------------------------

#: scenario, dry friction (share of the motors' limits), bits of the encoders; None: ideal ones
RUBBING = (
    ("panda_edge", 0.01, 20),
    ("ur5_wipe", 0.01, 20),
    ("panda_dome", 0.01, 20),
    ("scara_peg", 0.01, 20),
    ("ur5_wipe", 0.02, 16),
    ("panda_edge", 0.02, None),
    ("two_contact_rod", 0.02, 18),
)


@parametrize("how", first(RUBBING, 4), ids=str)
def test_joints_that_stick_in_dry_friction_stop_nothing(how):
    scenario, friction, bits = how
    step = 0.0 if bits is None else 2.0 * np.pi / 2**bits
    errors = f"{{rate: 1 kHz, angle: {{resolution: {step} rad}}, length: {{resolution: {step} m}}}}"
    changes = [f"plant.joint_friction={friction}"]
    changes += [] if bits is None else [f"sensors.encoder={errors}"]
    meta = run_of(scenario, *changes, duration=3.0).meta
    assert meta["end_state"] != "SAFE_STOP", meta["first_reason"]


def test_a_joint_that_came_to_rest_before_the_others_stops_nothing():
    """Friction stops it fast while they move; then all readings are constant for 10 ms."""
    changes = ["plant.joint_friction=0.01", "gains.motion={frequency: 4 Hz}"]
    run = Run(Place(seed=6), scenario=osc.load_scenario("panda_dome", changes))
    measure = run.robot.measure
    run.robot.measure = lambda: coarse(measure(), None)
    verdict = Verdict("no fault", run.case)
    while run.k * run.dt < 1.2:
        run.step(verdict)
    assert run.controller.state is not SAFE_STOP, run.controller.reason


def test_the_brake_of_a_joint_with_a_faulty_speed_is_without_its_identified_rotor():
    """A rotor identified from noise of the wrist made the stopped joint oscillate at 31 Hz."""
    run = Run(Place(scenario="panda_edge"))
    verdict = Verdict("no fault", run.case)
    rotor = 0.04
    inertia = []
    for faulty in (0, FAULTY_SPEED):
        run.step(verdict)
        memory, work = run.controller.records.memory, run.controller.records.work
        memory.joints.rotor[:] = rotor
        memory.joints.faulty[6] = faulty
        run.step(verdict)
        inertia.append([work.joints[j].M[j] for j in range(7)])
    found = np.array(inertia[0]) - np.array(inertia[1])
    assert_near(found, [0, 0, 0, 0, 0, 0, rotor], atol=2e-3)


@parametrize(
    "force, more, moves",
    [
        (51.0, {}, True),
        (49.0, {}, False),
        (51.0, {"state": at.HOLD}, False),
        (51.0, {"settled": at.BRAKED}, False),
        (51.0, {"wrench_age": 1}, False),
        (51.0, {"old_wrists": 1}, False),
        (51.0, {"cause": UNBALANCED}, False),
        (51.0, {"cause": OUT_OF_RANGE}, False),
        (51.0, {"largest_sum": 40.0}, False),
    ],
)
def test_what_presses_on_a_stopped_arm_moves_its_hold(force, more, moves):
    """Above half of the ceiling of 100 N, beside the weight of 20 N, if the wrist is believed."""
    t = records(1, 2, period=1e-3, wrist_ceiling=100.0, wrist_headroom=3.0)
    how = {"state": at.SAFE_STOP, "settled": at.SETTLED, "cause": 0}
    write(t.memory, **how | more)
    t.memory.q[:] = 0.1
    write(t.memory.arms[0], weighed=1, load=[0.0, force, 20.0])
    holding._yield_holds(t, vector(0.0, 0.0, 20.0, 0.0, 0.0, 0.0))
    assert_near(t.memory.joints.hold, 0.1 / 51.0 if moves else 0.0)


HAND = np.append(np.eye(3).ravel(), [0.0, 0.0, 0.1])  # tip in the last joint


def braking(kind, column, axis=(0.0, 0.0, 1.0)):
    """Torque on a joint that accelerates an object, by its inertia, per acceleration (kg m², kg).

    Args:
        kind: of the grasp, at (0.3, 0, 0.1) m; the object's centre is at (0.5, 0, 0.1) m.
        column: of the joint, at the world's origin.
        axis: of a hinge.
    """
    t = records(arms=1, joints=1)
    arm = t.model.arms[0]
    write(arm, end=1, kind=kind, tip=HAND, tip_axis=axis)
    write(t.model, principal=[2.0, 0.01, 0.02, 0.03])
    write(t.work.joints[0], R=np.eye(3), p=[0.3, 0.0, 0.0], column=column, acceleration=1.0)
    wrench = holding._inertial_wrench(t, arm, 0.5, np.eye(3), vector(0.5, 0.0, 0.1))
    return float(np.dot(column, wrench))


@mark.parametrize("kind", [at.RIGID, at.HINGE, at.BALL])
def test_only_the_transmitted_motion_of_a_joint_accelerates_the_object(kind):
    """Its whole inertia was that of a joint which turns about the ball, and which oscillated."""
    about_z = vector(0.0, -0.3, 0.0, 0.0, 0.0, 1.0)  # through the grasp
    about_x = vector(0.0, 0.1, 0.0, 1.0, 0.0, 0.0)
    along_x = vector(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert_near(braking(kind, along_x), 0.5 * 2.0)
    turned = 0.5 * (0.03 + 2.0 * 0.2**2)
    assert_near(braking(kind, about_z), turned if kind == at.RIGID else 0.0, atol=1e-12)
    assert_near(braking(kind, about_x), 0.0 if kind == at.BALL else 0.5 * 0.01, atol=1e-12)
    across = turned if kind != at.BALL else 0.0
    assert_near(braking(kind, about_z, axis=(0.0, 1.0, 0.0)), across, atol=1e-12)


def test_noise_of_speeds_does_not_move_a_stopped_hand_about_its_ball():
    """A joint that turned it moved with 0.14 rad/s and more."""
    place = Place(scenario="hinge_ball_rod", seed=91619774)
    run = Run(place, "speed noise of 0.05 rad/s")
    before = Verdict("no fault", place)
    while run.k < run.first:
        run.step(before)
    assert not before.wrong
    verdict = run.judge("speed noise of 0.05 rad/s", stopped_for=1.5)
    assert verdict.wrong == [] and verdict.stopped is not None
