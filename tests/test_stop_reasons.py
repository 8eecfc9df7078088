"""Why the arms stop, and the request for brakes: in words, in the tick in which both are known."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from pytest import fixture, raises
from samples import parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.lab.runs.run import start
from osc_contact.law.reasons import CODES, LASTING, SENTENCES, declare_reason
from osc_contact.loop.recorder import Recorder

SAFE_STOP = osc.SafetyState.SAFE_STOP


class Case:
    """A packaged scenario at its start, where sensors may read the same again and again."""

    def __init__(self, name):
        self.rig = rig_of(name)
        plant, controller = start(self.rig)
        self.measurement, self.reference = plant.measure(), self.rig.references.at(0.0)
        self.given = (self.measurement, self.reference)
        self.chain = controller.chain

    def controller(self):
        return start(self.rig)[1]


@fixture(scope="module")
def case():
    return Case("two_contact_rod")


def first_words(name):
    """Words of a reason's sentence before the first value."""
    return SENTENCES[CODES[name]].partition("{")[0]


#: what makes a tick held: changes of measurement, of reference, of MEMORY
HELD = {
    "OUT_OF_RANGE": ({"wrenches": lambda x: x + 1e5 * (np.arange(len(x)) == 0)[:, None]}, {}, {}),
    "JUMPED": ({"q": lambda q: q + 1.0 * (np.arange(len(q)) == 0)}, {}, {}),
    "NO_ROTATION": ({}, {"X_WD": lambda X: pin.SE3(2.0 * X.rotation, X.translation)}, {}),
    "WRENCH_TIMEOUT": ({"wrench_valid": lambda _: False}, {}, {"wrench_age": 1000}),
    "BAD_INPUT": ({}, {"V_D": lambda V: V * np.nan}, {}),
}
#: which row of a table is at fault: a joint with a motor, of a number that no arm has; an arm
ROWS = {"joints": 3, "arms": 1}
#: evidence in tables of MEMORY that one tick more completes: cause, table, field
FAULTS = {
    "stuck": ("STUCK", "joints", "gained"),
    "mirrored": ("DISAGREE", "joints", "error"),
    "drifting": ("DISAGREE", "joints", "drift"),
    "frozen wrist": ("WRIST_FROZEN", "arms", "same"),
    "saturated wrist": ("WRIST_SATURATED", "arms", "constant"),
    "frozen packet": ("FROZEN", "", "frozen"),
}
#: what needs readings that the other one is without
IMPOSSIBLE = {
    ("JUMPED", "frozen packet"),
    ("OUT_OF_RANGE", "frozen packet"),
    ("WRENCH_TIMEOUT", "frozen wrist"),
    ("WRENCH_TIMEOUT", "saturated wrist"),
}


def prepared(case, fault):
    """A controller after a tick, which one tick more with the same readings will stop."""
    controller = case.controller()
    controller.tick(*case.given)
    controller.tick(*case.given)
    _, table, field = FAULTS[fault]
    memory = controller.records.memory
    memory.joints["turning"] = 1.0  # their positions have been noisy
    memory.arms["lively"] = 1.0  # so have all numbers of their wrists
    if table:
        getattr(memory, table)[field][ROWS[table]] = 1e3
    else:
        setattr(memory, field, 1e3)
    return controller


def at_fault(of, fault):
    """The name that its sentence has to contain."""
    match FAULTS[fault][1]:
        case "joints":
            return of.chain.joint_names[ROWS["joints"]]
        case "arms":
            return of.chain.arms[ROWS["arms"]].name
    return ""


@parametrize("name, code", [("STUCK", 99), ("CHANNEL_DEAD", CODES["STUCK"])])
def test_a_reason_with_the_name_or_code_of_another_names_it(name, code):
    with raises(ValueError, match=f"reason {name}, code {code}: STUCK has code {CODES['STUCK']}"):
        declare_reason(name, code, "")


@parametrize("held", HELD)
@parametrize("fault", FAULTS)
def test_a_fault_found_in_a_tick_that_is_held_for_another_reason_is_the_one_reported(
    case, held, fault
):
    """The joint or arm in the sentence is that of the fault, not of the other reason."""
    controller = prepared(case, fault)
    of_measurement, of_reference, of_memory = HELD[held]
    m, r = case.measurement, case.reference
    m = replace(m, **{name: change(getattr(m, name)) for name, change in of_measurement.items()})
    r = replace(r, **{name: change(getattr(r, name)) for name, change in of_reference.items()})
    for name, value in of_memory.items():
        setattr(controller.records.memory, name, value)
    controller.tick(m, r)
    assert controller.status is osc.Status.HELD
    if (held, fault) in IMPOSSIBLE:
        assert controller.state is not SAFE_STOP
        return
    assert controller.state is SAFE_STOP
    cause = FAULTS[fault][0]
    for _ in range(3):  # also in the ticks after it
        assert first_words(cause) in controller.reason
        assert at_fault(case, fault) in controller.reason
        controller.tick(m, r)


@parametrize("held", [name for name, code in CODES.items() if 0 < code < LASTING])
def test_no_pair_of_reason_and_cause_is_without_a_sentence(case, held):
    """Even with an index that the other one's kind has not."""
    controller = case.controller()
    controller.tick(*case.given)
    controller.tick(replace(case.measurement, q=case.measurement.q * np.nan), case.reference)
    memory = controller.records.memory
    memory.state = SAFE_STOP
    sizes = {"joint": len(case.chain.joint_names), "arm": len(case.chain.arms)}
    for cause, sentence in SENTENCES.items():
        if cause < LASTING:
            continue
        size = next((n for name, n in sizes.items() if f"{{{name}}}" in sentence), 2)
        memory.cause, memory.culprit = cause, size - 1
        controller.records.work.reason = CODES[held]
        for memory.age in (1, 2):
            assert sentence.partition("{")[0] in controller.reason


@parametrize("fault", FAULTS)
def test_the_robot_is_stopped_with_a_reason_in_the_tick_that_finds_the_fault(case, fault):
    """The check before the start, in which this tick would be refused, is left out."""
    controller = prepared(case, fault)
    robot = Robot(case.measurement)
    osc.run_loop(robot, controller, [case.reference] * 5, check=False)
    assert robot.calls[0][0] == "stop" and len(robot.stops) == 2 and robot.stops[1] == ""
    assert first_words(FAULTS[fault][0]) in robot.stops[0]
    assert at_fault(case, fault) in robot.stops[0]


@parametrize("fault", FAULTS)
def test_the_torques_of_the_tick_that_finds_a_fault_are_not_those_of_the_law(case, fault):
    """They brake the arms, whatever the reference; of a sound tick they follow it."""
    accelerated = replace(case.reference, A_D=case.reference.A_D + [0.1, 0, 0, 0, 0, 0])
    for found, controllers in (
        (True, [prepared(case, fault) for _ in range(2)]),
        (False, [case.controller() for _ in range(2)]),
    ):
        tau, tau_accelerated = (
            controller.tick(case.measurement, reference).copy()
            for controller, reference in zip(
                controllers, [case.reference, accelerated], strict=True
            )
        )
        assert np.array_equal(tau, tau_accelerated) == found
        assert {controller.state is SAFE_STOP for controller in controllers} == {found}


@parametrize("fault", FAULTS)
def test_a_fault_known_beforehand_is_refused_at_the_start(case, fault):
    with raises(osc.InvalidInputError) as refusal:
        osc.run_loop(Robot(case.measurement), prepared(case, fault), [case.reference] * 5)
    assert first_words(FAULTS[fault][0]) in str(refusal.value)


def test_a_dead_packet_stops_with_the_request_for_brakes_at_once(case):
    controller = prepared(case, "stuck")
    controller.records.memory.still = 1.0  # s for which joints read the very same
    robot = Robot(case.measurement)
    osc.run_loop(robot, controller, [case.reference] * 5, check=False)
    assert len(robot.stops) == 2 and "engage the mechanical brakes" in robot.stops[0]
    assert robot.stops[0].endswith("See why, then call reset()")


def test_brakes_are_requested_once_more_where_they_are_needed_after_the_stop(case):
    """Joints have no readings from 5 ms after the stop on."""
    controller = prepared(case, "frozen wrist")
    m = case.measurement
    blind = replace(m, q=m.q * np.nan, v=m.v * np.nan)
    robot = Robot(*[m] * 5, *[blind] * 40)
    osc.run_loop(robot, controller, [case.reference] * 45, check=False)
    first, request, end = robot.stops
    assert "brakes" not in first and "the wrist of arm" in first
    assert "engage the mechanical brakes" in request and "the wrist of arm" in request
    assert end == ""
    at = [k for k, call in enumerate(robot.calls) if call[0] == "stop"]
    assert at[0] == 0 and 5 <= at[1] - 1 <= 5 + 20


@parametrize("fault", FAULTS)
def test_a_recording_has_the_moment_and_the_reason_of_the_stop(case, fault):
    controller = prepared(case, fault)
    recorder = Recorder(controller)
    references = [case.reference] * 3
    osc.run_loop(Robot(case.measurement), controller, references, recorder=recorder, check=False)
    first = recorder.recording().meta["first_reason"]
    assert first.startswith(f"at 0.000 s: {first_words(FAULTS[fault][0])}")


def test_nothing_is_reported_of_a_controller_that_runs(case):
    controller = case.controller()
    controller.tick(*case.given)
    assert controller.reason == ""


class Robot:
    """Reads what it is given, the last one for ever, and notes its calls."""

    def __init__(self, *readings):
        self.readings = list(readings)
        self.calls = []

    def measure(self):
        return self.readings.pop(0) if len(self.readings) > 1 else self.readings[0]

    def command(self, tau, duration):
        self.calls.append(("command", tau))

    def stop(self, reason=""):
        self.calls.append(("stop", reason))

    @property
    def stops(self):
        return [given for name, given in self.calls if name == "stop"]


class Wild(Robot):
    """From its fourth reading on a wrist is out of range, and a speed is not that of the joint."""

    def __init__(self, plant):
        super().__init__()
        self.plant, self.count = plant, 0

    def measure(self):
        m = self.plant.measure()
        self.count += 1
        if self.count < 4:
            return m
        v = m.v + 1.5 * (np.arange(len(m.v)) == 5)
        return replace(m, v=v, wrenches=m.wrenches + 1e5)

    def command(self, tau, duration):
        super().command(tau, duration)
        self.plant.command(tau, duration)


def test_a_wrist_out_of_range_and_a_joint_that_contradicts_itself():
    rig = rig_of("panda_edge")
    plant, controller = start(rig)
    robot = Wild(plant)
    osc.run_loop(robot, controller, rig.references.each(60, controller.dt))
    assert "joint panda/panda_joint6" in robot.stops[0]
