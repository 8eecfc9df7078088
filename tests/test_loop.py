"""The control loop: hardware without a truth, judges, own controllers, and how it ends."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from itertools import count, repeat

import numpy as np
from complaints import invalid_input, recording_error
from numpy.testing import assert_array_equal
from processes import SIGNALS, wait_until
from pytest import approx, mark, raises
from rigs import assert_near, placed, vector
from samples import first, parametrize
from scenario_runs import assert_same_run, rig_of, run_of

import osc_contact as osc
from osc_contact.lab.runs.run import start

TICKS = 30
pytestmark = mark.usefixtures("usual_handlers")


RIGID = ("two_contact_rod", "plant.type=rigid", "plant.step=1 ms")


def plan(rig, ticks=TICKS):
    return rig.references.each(ticks, 1.0 / rig.scenario.control.rate)


def started(*scenario):
    """A rig, its plant and its controller."""
    rig = rig_of(*scenario)
    return (rig, *start(rig))


class Hardware:
    """A robot as a driver offers it: no truth, no start to choose; a plant plays the machine."""

    def __init__(self, plant):
        self._plant = plant
        self.sent = []
        self.stopped = 0

    def measure(self):
        return self._plant.measure()

    def command(self, tau, duration):
        self.sent.append((tau, duration))
        self._plant.command(tau, duration)

    def stop(self, reason=""):
        self.stopped += 1


@parametrize("scenario", [RIGID, RIGID[:1]], ids=["rigid", "mujoco"])
def test_a_plant_in_the_loop_leaves_what_run_leaves(scenario):
    rig, plant, controller = started(*scenario)
    recorder = osc.Recorder(controller, plant, subject=rig.subject(controller))
    osc.run_loop(plant, controller, plan(rig), recorder=recorder)
    assert_same_run(recorder.recording(), run_of(rig.scenario, duration=TICKS * 1e-3))


@parametrize("scenario", [RIGID, ("moving_face", "plant.type=rigid", "control.rate=500 Hz")])
def test_hardware_without_a_truth_leaves_a_recording(scenario):
    """Faces are measured, and what encoders and wrists give is what a judge measures."""
    rig, plant, controller = started(*scenario)
    robot = Hardware(plant)
    recorder = osc.Recorder(controller, subject=rig.subject(controller))
    osc.run_loop(robot, controller, plan(rig), recorder=recorder)
    found = recorder.recording({"where": "cell 3"})
    assert robot.stopped == 1 and len(robot.sent) == TICKS
    assert "alpha_true" not in found and found.meta["where"] == "cell 3"
    assert_array_equal(found["tau"], [tau for tau, _ in robot.sent])
    assert {duration for _, duration in robot.sent} == {1.0 / rig.scenario.control.rate}
    run = run_of(rig.scenario, duration=TICKS * controller.dt)
    for channel in ("pose", "twist", "N", "face_pose", "contact_point"):
        assert_near(found[channel], run[channel], atol=1e-9, name=channel)
    assert_near(found["alpha_meas"], run["alpha_true"], atol=1e-9, rtol=1e-6)
    assert np.ptp(run["pose"][:, :3], axis=0).max() > 1e-7
    assert found["closed"].all() and found.magnitude_names == ["left_end", "right_end"]
    with recording_error("no judge took part"):
        osc.metrics(found)


@parametrize("kind, chunks", {"named": TICKS - 1, "by another": TICKS - 1, "temporary": 0})
def test_a_temporary_file_gets_rows_block_by_block(kind, chunks, tmp_path, monkeypatch):
    """Nothing can be recovered of it; unless another thread writes, which is handed little at once.

    Clocks here show a second later each time.
    """
    monkeypatch.setattr("osc_contact.loop.recorder.perf_counter", count().__next__)
    rig, plant, controller = started(*RIGID)
    journal = tmp_path / "unfinished.mcap" if kind == "named" else None
    recorder = osc.Recorder(controller, plant, journal=journal)
    if kind == "by another":
        recorder.hand_over = lambda write: write()
    osc.run_loop(plant, controller, plan(rig), recorder=recorder)
    assert len(list(recorder.journal.read().rows())) == chunks
    assert len(recorder.recording()) == TICKS


def test_ticks_that_are_held_are_recorded_and_do_not_end_the_loop():
    rig, plant, _ = started(*RIGID)

    class Deaf(Hardware):
        def measure(self):
            read = super().measure()
            if len(self.sent) in (0, 9):
                return replace(read, q=read.q * np.nan)
            return replace(read, v=read.v[:3]) if len(self.sent) == 4 else read

    controller = rig.controller()  # held before its first tick
    recorder = osc.Recorder(controller)
    osc.run_loop(Deaf(plant), controller, plan(rig), recorder=recorder, check=False)
    found = recorder.recording()
    assert found["status"].tolist() == [2 if k in (0, 4, 9) else 0 for k in range(TICKS)]
    assert np.isnan(found["q"][[0, 4, 9]]).all() and np.isfinite(found["tau"]).all()
    assert np.isfinite(found["pose"][10:]).all()


def test_progress_is_reported_now_and_then():
    shown = []
    loop_of(Robot(), 250, progress=shown.append)
    assert shown == approx([0.1, 0.2])


def test_a_viewer_needs_what_is_recorded():
    rig, plant, controller = started(*RIGID)

    class Viewer:
        def show(self, tick):
            seen.append({name: np.array(tick[name]) for name in tick})

    seen = []
    with invalid_input("recorder"):
        osc.run_loop(plant, controller, plan(rig), viewer=Viewer())
    recorder = osc.Recorder(controller)
    osc.run_loop(Hardware(plant), controller, plan(rig, 3), recorder=recorder, viewer=Viewer())
    recording = recorder.recording()
    assert len(seen) == 3 and len(seen[0]) > 10 and seen[2]["N"].shape == (6, 2)
    for k, tick in enumerate(seen):
        for name, value in tick.items():
            assert_near(value, recording[name][k], atol=1e-14, name=name)


# How `run_loop` ends: the robot is stopped at once and with a reason, by real signals, too.


REFERENCE = osc.Reference(placed())
READING = osc.Measurement(np.zeros(1), np.zeros(1), np.zeros((1, 6)))


class Robot:
    """Notes what it is sent, in order; `at` calls something in a call of a name."""

    def __init__(self, **at):
        self.calls = []
        self.at = at

    def _note(self, name, *given):
        self.calls.append((name, *given))
        self.at.get(name, lambda: None)()

    def measure(self):
        self._note("measure")
        return READING

    def command(self, tau, duration):
        self._note("command", float(tau[0]))

    def stop(self, reason=""):
        self._note("stop", reason)

    @property
    def stops(self):
        return [given[0] for name, *given in self.calls if name == "stop"]


class Controller:
    """Enters a stop at a tick, and brakes from then on."""

    dt = 1e-3

    def __init__(self, stops_at=()):
        self.stops_at = stops_at
        self.ticks = 0
        self.state = osc.SafetyState.RUN
        self.reason = ""

    def tick(self, measurement, reference):
        if self.ticks in self.stops_at:
            self.state = osc.SafetyState.SAFE_STOP
            self.reason = f"tick {self.ticks}: an encoder"
        if self.ticks - 2 in self.stops_at:  # somebody resets it
            self.state = osc.SafetyState.RUN
        self.ticks += 1
        return vector(-1.0 if self.state is osc.SafetyState.SAFE_STOP else 1.0)


def loop_of(robot, ticks=None, stops_at=(), **how):
    """Run the loop for some ticks, or until something ends it."""
    references = repeat(REFERENCE) if ticks is None else repeat(REFERENCE, ticks)
    return osc.run_loop(robot, Controller(stops_at), references, **how)


def send(number):
    return lambda: os.kill(os.getpid(), number)


def handlers():
    return list(map(signal.getsignal, SIGNALS))


def test_a_stop_is_reported_in_its_tick_and_braking_continues():
    robot = Robot()
    loop_of(robot, 8, [3, 6])
    assert robot.stops == ["tick 3: an encoder", "tick 6: an encoder", ""]
    stop = ("stop", "tick 3: an encoder")
    at = robot.calls.index(stop)
    assert robot.calls[at - 1 : at + 2] == [("measure",), stop, ("command", -1.0)]
    sent = [given[0] for name, *given in robot.calls if name == "command"]
    assert sent == [1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0]


def test_a_stop_that_fails_hides_no_error_and_ends_no_braking(caplog):
    def fail():
        raise OSError("no brakes")

    def unplug():
        raise ConnectionError("the cable is out")

    robot = Robot(stop=fail, command=unplug)
    with raises(ConnectionError, match="cable") as caught:
        loop_of(robot, 1)
    assert robot.stops == ["ConnectionError: the cable is out"]
    assert any("no brakes" in note for note in caught.value.__notes__)
    assert "no brakes" in caplog.text

    robot = Robot()
    robot.at = {"stop": lambda: fail() if robot.stops == ["tick 1: an encoder"] else None}
    loop_of(robot, 3, [1])
    assert robot.stops == ["tick 1: an encoder", ""] and robot.calls[-2] == ("command", -1.0)

    with raises(OSError, match="no brakes"):  # nothing else went wrong: this is the error
        loop_of(Robot(stop=fail), 1)


def test_a_driver_whose_stop_takes_no_reason_is_refused_before_it_moves():
    class Old(Robot):
        def stop(self):
            self._note("stop", "")

    robot = Old()
    with invalid_input(r'Old takes no reason.*stop\(self, reason=""\)'):
        loop_of(robot, 1)
    assert not robot.calls


@parametrize("number", SIGNALS)
@parametrize("where", ["measure", "command", "waiting for ever"])
def test_a_signal_ends_the_loop_with_the_robot_stopped(number, where):
    def wait():
        threading.Timer(0.2, send(number)).start()
        time.sleep(60)

    before = handlers()
    robot = Robot(**({"measure": wait} if "waiting" in where else {where: send(number)}))
    began = time.perf_counter()
    with raises(KeyboardInterrupt if number == signal.SIGINT else SystemExit) as caught:
        loop_of(robot)
    assert robot.stops == [signal.Signals(number).name] and robot.calls[-1][0] == "stop"
    assert len(robot.calls) <= 3 and time.perf_counter() - began < 10 and handlers() == before
    if number != signal.SIGINT:
        assert caught.value.code == 128 + number


def test_no_signal_interrupts_the_record_of_a_tick_or_the_stop():
    rows = []
    robot = Robot()

    class Records:
        def append(self, *tick):
            send(signal.SIGTERM)()
            rows.append(tick)

        def latest(self):
            return {}

    ended = []
    robot.at["stop"] = lambda: (send(signal.SIGHUP)(), ended.append("whole"))
    with raises(SystemExit) as caught:
        loop_of(robot, recorder=Records())
    assert len(rows) == 1 and ended == ["whole"] and robot.stops == ["SIGTERM"]
    assert caught.value.code == 128 + signal.SIGTERM
    robot = Robot(stop=send(signal.SIGTERM))  # after the last reference: kept until it is stopped
    with raises(SystemExit):
        loop_of(robot, 1)
    assert robot.calls[-1] == ("stop", "")


def test_the_third_signal_ends_a_stop_that_does_not_return():
    robot = Robot(measure=send(signal.SIGTERM))
    robot.at["stop"] = lambda: (send(signal.SIGTERM)(), send(signal.SIGTERM)(), time.sleep(60))
    began = time.perf_counter()
    with raises(SystemExit):
        loop_of(robot, 1)
    assert time.perf_counter() - began < 10


def test_handlers_of_the_program_and_other_threads_are_left_alone():
    seen = []
    during = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: seen.append(number))
    own = signal.getsignal(signal.SIGTERM)
    try:
        robot = Robot(command=send(signal.SIGTERM))
        loop_of(robot, 3)
        assert len(seen) == 3 and robot.stops == [""]
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, before)
    robot = Robot(command=lambda: during.append(handlers()))
    usual = handlers()
    thread = threading.Thread(target=loop_of, args=(robot, 2))
    thread.start()
    thread.join()
    assert during == [usual, usual] and robot.stops == [""]


PROGRAM = """
import signal, sys
from itertools import count
from pathlib import Path
import osc_contact as osc
from osc_contact.lab.runs.run import start

folder = Path(sys.argv[1])
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may ignore it
signal.signal(signal.SIGHUP, signal.SIG_DFL)
rig = osc.build_rig(osc.load_scenario("two_contact_rod", ["plant.type=rigid"]))
plant, controller = start(rig)

class Robot:
    measure = plant.measure

    def command(self, tau, duration):
        plant.command(tau, duration)
        if plant.time > 0.05:
            (folder / "moving").touch()

    def stop(self, reason=""):
        with (folder / "stops").open("a") as file:
            file.write(reason + "\\n")

recorder = osc.Recorder(controller, plant, journal=folder / "unfinished.mcap")
try:
    osc.run_loop(Robot(), controller, (rig.references.at(0.0) for _ in count()), recorder=recorder)
finally:
    recorder.recording().save(folder / "recording.npz")
"""


@parametrize("number", first(SIGNALS, 1))
def test_a_process_that_is_signalled_stops_its_robot_and_keeps_its_recording(number, tmp_path):
    command = [sys.executable, "-c", PROGRAM, tmp_path]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    wait_until((tmp_path / "moving").exists, process=process)
    process.send_signal(number)
    errors = process.communicate(timeout=60)[1]
    expected = -signal.SIGINT if number == signal.SIGINT else 128 + number
    assert process.returncode == expected, errors
    assert (tmp_path / "stops").read_text().split("\n")[:-1] == [signal.Signals(number).name]
    recording = osc.Recording.load(tmp_path / "recording.npz")
    assert len(recording) >= 50 and np.isfinite(recording["tau"]).all()
    assert_near(np.diff(recording["t"]), 1e-3, atol=1e-9)
