"""The process made for the loop, its deadlines and the thread beside it; shadow mode."""

import gc
import os
import re
import sys
import threading
import time
from itertools import repeat

import numpy as np
from complaints import invalid_input, plant_error
from pytest import approx, raises
from rigs import assert_near, placed, vector
from samples import parametrize
from scenario_runs import rig_of
from test_loop import REFERENCE, Controller, Robot, loop_of
from test_own_driver import HOME, Driver

import osc_contact as osc
from osc_contact.lab.reports.report import verdict_table
from osc_contact.loop import realtime as process
from osc_contact.loop.realtime import LoopReport, latency


def state_of_process():
    return (gc.isenabled(), os.sched_getscheduler(0), sys.getswitchinterval())


class Paced(Robot):
    """Keeps its time, and notes in which state the process is."""

    def measure(self):
        time.sleep(1e-3)
        self.state = state_of_process()
        return super().measure()


class Slow(Controller):
    def tick(self, measurement, reference):
        time.sleep(1e-3)
        return super().tick(measurement, reference)


def test_the_process_is_made_for_the_loop_and_given_back(caplog, monkeypatch):
    monkeypatch.setattr(process, "MOST_MISSED", 10**9)
    before = state_of_process()
    robot = Paced()
    report = loop_of(robot, 50, realtime=True)
    collects, policy, interval = robot.state
    assert not collects and interval == approx(5e-5)
    permitted = not any("priority" in note for note in report.notes)
    assert (policy == os.SCHED_FIFO) == permitted
    assert all("permit it by" in note and note in caplog.text for note in report.notes)
    assert state_of_process() == before
    assert report.ticks == 50 == sum(report.histogram)
    us = report.read_to_write_us
    assert 0.0 < us["p50"] <= us["p99"] <= us["p99_9"]
    assert robot.stops == [""]


def test_twenty_missed_deadlines_in_a_row_stop_the_robot():
    robot = Paced()
    with plant_error(r"20 deadlines in a row were missed.* Free the mach"):
        osc.run_loop(robot, Slow(), repeat(REFERENCE), realtime=True)
    assert len(robot.stops) == 1 and robot.stops[0].startswith("PlantError: 20 deadlines")
    report = osc.run_loop(Paced(), Slow(), repeat(REFERENCE, 40))
    assert report.missed >= 39, "counted, but a plant that takes its time is no fault"


def test_what_counts_as_missed():
    report = LoopReport(1e-3)
    for read, seconds, missed in (
        (0.0, 1e-4, 0),
        (1e-3, 4.9e-4, 0),
        (2e-3, 5.1e-4, 1),
        (4e-3, 1e-4, 2),
        (5.4e-3, 1e-4, 2),
    ):
        report.note(read, seconds)
        assert report.missed == missed
    assert report.in_a_row == 0
    report.notes = ["a note"]
    assert report.read_to_write_us == approx(
        {"p50": 105.0, "p99": 515.0, "p99_9": 515.0, "max": 510.0}
    )
    assert report.as_dict()["notes"] == ["a note"]
    times = "p50 105 µs, p99.9 515 µs, max 510 µs; 2 of 5 deadlines missed"
    assert latency(report.as_dict()) == times


def keeping_home(robot, ticks):
    """A controller, and references, of a driver's robot that stays at home."""
    goal = osc.Reference(robot.chain.state(HOME).X_WO)
    return (osc.Controller(robot.chain, [], dt=1e-3, posture=HOME), repeat(goal, ticks))


def test_a_disk_that_hangs_and_a_viewer_delay_no_tick(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(process, "MOST_MISSED", 10**9)  # other tests run beside it
    driver = Driver()
    controller, goals = keeping_home(driver, 1100)
    recorder = osc.Recorder(controller, driver.plant, journal=tmp_path / "run.mcap")
    threads = set()
    shown = []
    append = recorder.journal.append

    def hang(first, rows):
        threads.add(threading.current_thread().name)
        time.sleep(0.1)
        append(first, rows)

    class Viewer:
        def show(self, tick):
            threads.add(threading.current_thread().name)
            shown.append(tick["t"])
            if len(shown) == 3:
                raise OSError("no browser")

    recorder.journal.append = hang
    watched = {"recorder": recorder, "viewer": Viewer()}
    report = osc.run_loop(driver, controller, goals, realtime=True, **watched)
    assert threads == {"side work_0"} and shown == sorted(shown) and len(shown) == 3
    assert caplog.text.count("the viewer failed; the run continues without it") == 1
    recording = recorder.recording()
    assert len(recording) == 1100 and np.isfinite(recording["q"]).all()
    verdict = osc.metrics(recording)
    assert verdict["loop"] == report.as_dict()
    assert latency(verdict["loop"]) in list(verdict_table(verdict).columns[1].cells)


# --- shadow mode ----------------------------------------------------------------------------------


class Guided(Driver):
    """A driver whose tool somebody pushes to and fro, once it has rested for 0.3 s."""

    def command(self, tau, duration):
        t = 1e-3 * self.ticks - 0.3
        body = self.plant.model.site("tip").bodyid[0]
        force = 12.0 * np.sin(vector(7.0, 9.0, 5.0) * max(t, 0.0))
        arm = self.plant.data.site("tip").xpos - self.plant.data.xipos[body]
        self.plant.data.xfrc_applied[body] = [*force, *np.cross(arm, force)]
        super().command(tau, duration)


def shadow(fault="", change=lambda robot: None, ticks=4000):
    robot = Guided(fault)
    change(robot)
    report = osc.run_loop(robot, *keeping_home(robot, ticks), shadow=True)
    assert robot.stops == [""], "the controller's own stops are not carried out"
    return report.shadow


def test_shadow_mode_finds_friction_rotors_and_right_wrenches():
    def rub(robot):
        robot.plant.model.dof_frictionloss[:] = (1.0, 0.5, 1.5)
        robot.plant.model.dof_damping[:] = (0.4, 0.8, 0.2)
        robot.plant.model.dof_armature[:] = 0.25  # of which the model has 0.05

    found = shadow(change=rub)
    assert all(joint.moved for joint in found.joints)
    for key, expected, atol in (
        ("coulomb", [1.0, 0.5, 1.5], 0.25),
        ("viscous", [0.4, 0.8, 0.2], 0.3),
        ("inertia", 0.2, 0.06),
        ("offset", 0.0, 0.3),
    ):
        assert_near([getattr(j, key) for j in found.joints], expected, atol=atol)
    assert found.wrench_scale == approx(1.0, abs=0.15) and found.forces


@parametrize(
    "fault, sentence",
    {
        "mirrored wrench": "the wrench is reversed",
        "no gravity": "tare it .* or correct the payload",
        "wrench of another frame": "axes of its frame are wrong|tare it",
        "mirrored joint": "elbow.* unexplained: is it, or a joint near it, reversed",
    },
)
def test_shadow_mode_reports_why_no_force_may_be_commanded(fault, sentence):
    found = shadow(fault)
    assert not found.forces
    assert re.search(sentence, " ".join(found.findings)), found.findings


def test_shadow_mode_needs_motion_and_one_arm():
    found = shadow(change=lambda robot: setattr(robot, "ticks", -9999), ticks=1100)
    assert not found.forces and sum("was not moved" in one for one in found.findings) == 3
    assert any("hardly pushed" in one for one in found.findings)
    with invalid_input("let it run for ten seconds"):
        shadow(ticks=500)
    bare = rig_of().controller()
    with invalid_input("judges one arm"):
        osc.run_loop(Robot(), bare, [osc.Reference(placed())], shadow=True)


def test_an_error_of_the_thread_beside_the_loop_ends_the_run_after_the_stop(monkeypatch):
    """The process is given back first, and the calls after the failed one are still made.

    The thread is there before the first tick: none has to wait for it.
    """
    monkeypatch.setattr(process, "MOST_MISSED", 10**9)
    done = []
    threads = []

    class Recorder:
        hand_over = None

        def append(self, measurement, reference, tau, seconds):
            threads.append({thread.name for thread in threading.enumerate()})
            self.hand_over(lambda: done.append(1))
            self.hand_over(fail)

        def note(self, meta):
            pass

    def fail():
        raise ValueError("the disk is full")

    robot = Paced()
    with raises(ValueError, match="the disk is full"):
        loop_of(robot, 5, recorder=Recorder(), realtime=True)
    assert len(done) == 5 and robot.stops == [""] and "side work_0" in threads[0]
