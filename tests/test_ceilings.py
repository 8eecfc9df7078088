"""Ceilings: contact forces, wrist forces and speeds that stop the arms whatever is commanded."""

from dataclasses import replace
from math import inf

import numpy as np
import pinocchio as pin
from law_calls import ceilings, records, write
from numpy.random import default_rng
from pytest import approx, raises
from rigs import any_rotation, assert_near, refused, shift, vector
from samples import parametrize
from scenario_runs import rig_of, run_of

import osc_contact as osc
from benchmarks.cases import CASES, repeatable
from benchmarks.open_contact import pressed_from_the_air
from osc_contact.lab.checks.preflight import preflight
from osc_contact.lab.runs.run import start
from osc_contact.law.ceilings import (
    CONTACT_ABOVE_CEILING,
    FREE_WRIST_ABOVE_CEILING,
    TIP_ABOVE_CEILING,
    WRIST_ABOVE_CEILING,
)
from osc_contact.law.reasons import NO_REASON
from osc_contact.law.records import WRISTS, views
from osc_contact.loop.reference_rules import speed_ceiling
from osc_contact.settings.control import HEADROOM, LEAST_CEILING

DT = 1e-3
SAFE_STOP = osc.SafetyState.SAFE_STOP
LIMITS = {"contact_ceiling": 40.0, "wrist_ceiling": 60.0, "speed_ceiling": 0.5}


class Arms:
    """Two arms with three columns of N, of which two are kept: numbers 2 and 0."""

    def __init__(self, **settings):
        self.t = records(2, 2, 2, 3, **{"period": DT, "ceiling_time": 0.0205} | LIMITS | settings)
        write(self.t.work, rank=2, kept=[2, 0], dt=DT, X_WO=0.0)
        self.memory = self.t.memory
        self.memory.balanced = 10
        for k in range(2):
            self.t.model.arms[k].tip_joint = k
            self.t.work.joints[k].R[:] = np.eye(3)

    def tick(self, alpha=(0.0, 0.0), net=0.0, speed=0.0, arm=0):
        write(self.t.work, alpha_meas=alpha)
        for k in range(2):
            self.t.work.arms[k].net[:] = 0.0
            self.t.work.arms[k].V[:] = 0.0
        self.t.work.arms[arm].net[:3] = (net, 0.0, 0.0)
        self.t.work.arms[arm].V[:3] = (0.0, speed, 0.0)
        return ceilings.watch_ceilings(self.t)

    def ticks_until(self, reason, **given):
        """The first tick that ends with this reason, and with no other before; 0: none does."""
        for k in range(1, 60):
            found = self.tick(**given)
            if found != NO_REASON:
                assert found == reason
                return k
        return 0


@parametrize("sign", [1.0, -1.0])
@parametrize(
    "reason, given, least",
    [
        (CONTACT_ABOVE_CEILING, lambda x: {"alpha": (1.0, x)}, 40.0),
        (CONTACT_ABOVE_CEILING, lambda x: {"alpha": (x, -1.0)}, 40.0),
        (WRIST_ABOVE_CEILING, lambda x: {"net": x, "arm": 0}, 60.0),
        (WRIST_ABOVE_CEILING, lambda x: {"net": x, "arm": 1}, 60.0),
        (TIP_ABOVE_CEILING, lambda x: {"speed": x, "arm": 1}, 0.5),
    ],
)
def test_what_is_above_its_ceiling_for_too_long_stops_the_arms(reason, given, least, sign):
    assert Arms().ticks_until(reason, **given(sign * 0.999 * least)) == 0
    arms = Arms()
    assert arms.ticks_until(reason, **given(sign * 1.001 * least)) == 21
    at_fault = given(1.0).get("arm", 0)
    if reason == CONTACT_ABOVE_CEILING:
        at_fault = 0 if given(1.0)["alpha"][1] == 1.0 and given(9.0)["alpha"][1] == 9.0 else 2
    assert arms.memory.culprit == at_fault
    assert (arms.memory.reached, arms.memory.ceiling) == (approx(1.001 * least), least)
    assert Arms(ceiling_time=0.0055).ticks_until(reason, **given(sign * 2.0 * least)) == 6


@parametrize("given", [{"alpha": (90.0, 0.0)}, {"net": 90.0}, {"speed": 0.9}])
def test_time_below_a_ceiling_takes_that_above_it_away(given):
    arms = Arms()
    for _ in range(10):  # 15 ms above it, 15 ms below it
        assert {arms.tick(**given) for _ in range(15)} == {NO_REASON}
        assert {arms.tick() for _ in range(15)} == {NO_REASON}
    arms.t.work.dt = 4.0 * DT  # lost ticks count
    assert [arms.tick(**given) for _ in range(6)][:5] == [NO_REASON] * 5
    assert arms.tick(**given) != NO_REASON


def test_a_wrist_that_was_not_read_is_no_evidence():
    arms = Arms()
    arms.memory.wrench_missing = 1
    assert arms.ticks_until(NO_REASON, net=900.0) == 0 == arms.memory.over_wrist
    arms = Arms()
    arms.memory.balanced = 0
    assert arms.ticks_until(NO_REASON, net=900.0) == 0


@parametrize("command", [5.0, 50.0])
def test_ceilings_that_are_not_given_follow_the_largest_command_so_far(command):
    arms = Arms(
        contact_ceiling=LEAST_CEILING,
        wrist_ceiling=LEAST_CEILING,
        contact_headroom=HEADROOM,
        wrist_headroom=HEADROOM,
    )
    commands = arms.t.work.columns.alpha_d
    commands[:] = (0.2 * command, -command, 0.4 * command)
    arms.tick()
    commands[:] = 0.0  # the largest so far counts
    one = max(30.0, 3.0 * command)
    every = max(30.0, 3.0 * 1.6 * command)
    for most, reason, given in (
        (one, CONTACT_ABOVE_CEILING, lambda x: {"alpha": (x, 0.0)}),
        (every, WRIST_ABOVE_CEILING, lambda x: {"net": x}),
    ):
        assert arms.ticks_until(NO_REASON, **given(0.999 * most)) == 0
        assert arms.ticks_until(reason, **given(1.001 * most)) == 21
        arms.tick()


def test_an_internal_force_is_a_command():
    arms = Arms(contact_headroom=HEADROOM, wrist_headroom=HEADROOM)
    arms.memory.squeeze[0] = -70.0
    assert arms.ticks_until(NO_REASON, alpha=(209.0, 0.0), net=209.0) == 0
    assert arms.ticks_until(CONTACT_ABOVE_CEILING, alpha=(211.0, 0.0)) == 21


def test_a_tip_turns_about_the_centre_too():
    arms = Arms()
    own = arms.t.work.arms[1]
    arms.t.model.arms[1].tip[9:] = (0.0, 0.3, 0.0)
    arms.t.work.joints[1].p[:] = (0.0, 0.1, 0.0)
    arms.t.work.p_C[:] = (0.0, -0.1, 0.0)
    for turn, ticks in ((0.99, 0), (1.01, 21)):

        def tick(turn=turn):
            own.V[:] = (0.0, 0.0, 0.0, 0.0, 0.0, turn)  # 0.5 m away from the axis
            return ceilings.watch_ceilings(arms.t)

        found = [tick() for _ in range(21)]
        assert found == [NO_REASON] * 20 + [TIP_ABOVE_CEILING if ticks else NO_REASON]


# --- whole ticks ----------------------------------------------------------------------------------


def pressed(case, times):
    """Readings in which the contact force is so many times 10 N."""
    m = case.measurement
    state = case.chain.state(m.q, m.v)
    n = case.pairs[0].contact(state.X_WO, state.V_O).N[:, 0]
    more = shift(state.X_WO.translation).act(pin.Force(n * 10.0 * (times - 1.0)))
    return replace(m, wrenches=m.wrenches + state.sensors[0].actInv(more).vector)


@parametrize(
    "settings, words",
    [
        ({}, ["contact0: 79.9 N was read, above the ceiling of 30 N", "ceiling_time = 0.0205 s"]),
        ({"contact_ceiling": inf}, ["the wrist of arm 'arm' bears", "of 30 N (wrist_ceiling)"]),
        (
            {"contact_ceiling": 81.0, "wrist_ceiling": 79.0},
            ["beside weight and inertia", "the ceiling of 79 N (wrist_ceiling)"],
        ),
    ],
)
def test_a_force_above_its_ceiling_stops_within_20_ms(settings, words):
    case = CASES["one_panda"]()
    limits = osc.SafetySettings(ceiling_time=0.0205, overforce_time=inf, **settings)
    controller = repeatable(case.controller().with_safety(limits))
    for _ in range(60):  # accelerations fade
        controller.tick(*case.given)
        controller.motion_integral = np.zeros(6)
    seen = pressed(case, 8.0)
    passed = 0
    while controller.state is not SAFE_STOP and passed < 60:
        controller.tick(seen, case.reference)
        controller.motion_integral = np.zeros(6)
        passed += 1
    assert passed in (21, 22)
    for word in words:
        assert word in controller.reason, controller.reason


def loads(rig, ticks):
    """Of each tick: the largest load of a wrist, as compared with its ceiling; f_c, its speed."""
    plant, controller = start(rig)
    t = views(controller.records.rows)
    for reference in rig.references.each(ticks, DT):
        plant.command(controller.tick(plant.measure(), reference), DT)
        rate = tuple(t.memory.centre_rate)
        yield (ceilings._largest_load(t, rate)[1], np.linalg.norm(t.work.f_c[:3]), rate)


def test_a_wrist_bears_contact_forces_without_weight_and_inertia():
    """A single arm's is what the filter reads of its contacts, while 2 kg more are accelerated."""
    rig = rig_of("panda_edge", "model_error.object_mass=1")
    found = np.array([(load, f_c) for load, f_c, _ in loads(rig, 700)])[300:]
    assert_near(found[:, 0], found[:, 1], atol=0.5)
    assert found[:, 1].min() > 5.0


# --- before the start -----------------------------------------------------------------------------


@parametrize(
    "changes, words",
    [
        (
            ["control.safety.contact_ceiling=14 N"],
            ["force.left_end is 15 N", "above safety.contact_ceiling = 14 N", "raise"],
        ),
        (
            ["control.safety.wrist_ceiling=30 N"],
            ["the sum of all commanded forces is 37 N", "above safety.wrist_ceiling = 30 N"],
        ),
        (
            ["control.safety.contact_ceiling=16 N", "squeeze=17 N"],
            ["the internal force is 17 N", "above safety.contact_ceiling = 16 N"],
        ),
        (
            ["control.safety.speed_ceiling=150 mm/s"],
            ["leads the tip of arm 'left' at 0.157 m/s", "above safety.speed_ceiling = 0.15 m/s"],
        ),
    ],
)
def test_commands_above_the_ceilings_are_refused_before_the_start(changes, words):
    with raises(osc.ScenarioError) as error:
        run_of("two_contact_rod", *changes, duration=None)
    for word in words:
        assert word in str(error.value)


def test_a_scenario_of_known_commands_has_ceilings_of_three_times_the_largest():
    rig = rig_of("two_contact_rod")
    alpha = np.abs(rig.references.overview[1].alpha_d)
    total = alpha.sum(axis=1).max() + 10.0  # squeeze
    assert rig.safety.contact_ceiling == approx(3.0 * alpha.max()) == 45.0
    assert rig.safety.wrist_ceiling == approx(3.0 * total, rel=1e-3)
    model = rig.controller().records.model
    assert (model.contact_ceiling, model.contact_headroom) == (45.0, 0.0)
    given = rig_of("two_contact_rod", "control.safety.contact_ceiling=50 N").safety
    assert (given.contact_ceiling, given.wrist_ceiling) == (50.0, rig.safety.wrist_ceiling)
    assert rig_of("panda_wrist").safety.wrist_ceiling == LEAST_CEILING
    assert rig_of("two_contact_rod", "squeeze=70 N").safety.contact_ceiling == 210.0


def test_a_brief_command_of_a_long_task_is_found():
    steps = (
        "force.left_end=[{type: constant, value: 5 N}, {type: step, start: 99.9 s, value: 200 N}, "
        "{type: step, start: 99.901 s, value: -200 N}]"
    )
    rig = rig_of("two_contact_rod", steps, "duration=99.91 s")
    assert rig.safety.contact_ceiling == approx(615.0)


def test_references_of_a_robot_are_compared_with_the_ceilings_that_are_given():
    rig = rig_of("two_contact_rod", "control.safety.contact_ceiling=9 N")
    plant, controller = start(rig)
    found = preflight(plant, controller, [rig.references.at(0.0)] * 5)
    assert any("alpha_d of" in one.text and "contact_ceiling = 9 N" in one.text for one in found)
    fast = replace(rig.references.at(0.0), alpha_d=[10.0, 10.0], V_D=vector(0, 0.6, 0, 0, 0, 0))
    with refused("contact_ceiling|speed_ceiling|V_D"):
        osc.run_loop(plant, controller, [fast] * 5)


def test_the_speed_that_is_compared_is_that_of_the_tips():
    """The object turns about its origin: its tips move."""
    rng = default_rng(3)
    rig = rig_of("two_contact_rod")
    R = any_rotation(rng)
    omega = rng.standard_normal(3)
    speeds = [
        np.linalg.norm(np.cross(omega, R @ grasp.X_TO.inverse().translation))
        for grasp in rig.chain.grasps
    ]
    pose = pin.SE3ToXYZQUAT(pin.SE3(R, np.zeros(3)))

    class Task:
        chain = rig.chain
        safety = osc.SafetySettings(speed_ceiling=0.9 * min(speeds))
        commanded = np.append(np.zeros(3), omega)[None]
        poses = pose[None]
        times = np.zeros(1)

    found = [words["speed"] for _, words in speed_ceiling.quantity(Task)]
    assert_near(np.array(found), np.array(speeds), rtol=1e-9)


def test_actions_that_could_be_above_a_given_ceiling_are_refused():
    """Ceilings that are not given follow what is commanded by actions."""
    gymnasium = osc.make_vector_env("panda_edge", 1, overrides=["duration=0.1 s"], most_force=300.0)
    model = gymnasium._episodes[0].start.controller.records.model
    assert (model.contact_headroom, model.contact_ceiling) == (HEADROOM, LEAST_CEILING)
    with refused("forces of up to 300 N in 1 contacts"):
        osc.make_vector_env(
            "panda_edge",
            1,
            overrides=["duration=0.1 s", "control.safety.contact_ceiling=100 N"],
            most_force=300.0,
        )


def one_arm(columns=3, rank=0, n_arms=1):
    """The first of the arms alone; no column of N is kept."""
    arms = Arms()
    write(arms.t.model, n_arms=n_arms, n_columns=columns)
    arms.t.work.rank = rank
    return arms


def test_a_wrist_of_a_free_arm_has_little_time_above_its_ceiling():
    """With an active contact, without contacts in the model, or with another arm: `ceiling_time`.

    Two arms also bear what they squeeze, and what errors of their closed chain press.
    """
    for setup, reason, ticks in (
        ((3, 0, 1), FREE_WRIST_ABOVE_CEILING, 3),
        ((3, 2, 1), WRIST_ABOVE_CEILING, 21),
        ((0, 0, 1), WRIST_ABOVE_CEILING, 21),
        ((3, 0, 2), WRIST_ABOVE_CEILING, 21),
    ):
        assert one_arm(*setup).ticks_until(reason, net=60.1) == ticks
        assert one_arm(*setup).ticks_until(reason, net=59.9) == 0


def test_the_force_of_a_contact_that_ends_is_not_that_of_a_free_wrist():
    """Until it leaves N it has `ceiling_time`; from then on 2.5 ms, as often as it leaves."""
    arms = one_arm(rank=2)
    for _ in range(2):
        arms.t.work.rank = 2
        assert {arms.tick(net=90.0) for _ in range(8)} == {NO_REASON}
        arms.t.work.rank = 0
        assert {arms.tick(net=90.0) for _ in range(2)} == {NO_REASON}
    assert arms.tick(net=90.0) == WRIST_ABOVE_CEILING, "of 20 ms above it"
    arms = one_arm(rank=2)
    assert {arms.tick(net=90.0) for _ in range(8)} == {NO_REASON}
    arms.t.work.rank = 0
    assert arms.ticks_until(FREE_WRIST_ABOVE_CEILING, net=90.0) == 3


@parametrize("lost", [1, 2])
def test_a_single_reading_of_a_free_wrist_stops_no_arm(lost):
    """Nor does one after lost ticks, or one that repeats itself."""
    arms = one_arm()
    arms.t.work.dt = DT * (1 + lost)
    assert arms.tick(net=90.0) == NO_REASON
    arms.t.work.dt = DT
    assert arms.tick() == NO_REASON
    assert arms.tick(net=90.0) == NO_REASON
    arms.memory.repeated = WRISTS
    assert {arms.tick(net=90.0) for _ in range(4)} == {NO_REASON}
    arms.memory.repeated = 0
    assert [arms.tick(net=90.0) for _ in range(2)] == [NO_REASON, FREE_WRIST_ABOVE_CEILING]


@parametrize("speed", [0.015, 0.05])
def test_a_contact_that_is_believed_open_presses_with_60_N_at_most(speed):
    """It was 276 N in a world of others; without ceilings it is as much here.

    At 50 mm/s it was 73 N, as the motion pressed on for the whole `ceiling_time`.
    """
    recording = pressed_from_the_air(speed)
    forces = recording["alpha_true"].sum(axis=1)
    assert 30.0 < forces.max() < 60.0
    assert forces[-1] < 1.0, "the stopped arm does not press on"
