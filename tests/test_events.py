"""The event log of a run, and what a recording is of: version, law, date, robot files."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from itertools import repeat
from pathlib import Path

import numpy as np
from pytest import approx, fixture
from scenario_runs import rig_of, run_of

import osc_contact as osc
from osc_contact.control.changes import changed_settings
from osc_contact.lab.runs.run import start
from osc_contact.law.library import law_hash
from osc_contact.recorder import events
from osc_contact.recorder.events import EventLog, events_beside
from osc_contact.robots import resolve_urdf


class Stopped:
    """A robot around a plant, whose wrists break for some ticks, and which notes its stops."""

    def __init__(self, plant, broken):
        self.plant, self.broken, self.count, self.reasons = plant, broken, 0, []

    def measure(self):
        self.count += 1
        seen = self.plant.measure()
        if self.count in self.broken:
            seen = replace(seen, wrenches=np.nan * seen.wrenches)
        return seen

    def command(self, tau, duration):
        self.plant.command(tau, duration)

    def stop(self, reason=""):
        self.reasons.append(reason)


@fixture
def rig():
    return rig_of("two_contact_rod", "plant.type=rigid")


def looped(rig, ticks, *broken, journal=None, between=None):
    """A loop in which wrists break: recorder, robot."""
    plant, controller = start(rig)
    recorder = osc.Recorder(controller, plant, journal=journal)
    robot = Stopped(plant, broken)

    def references():
        for k, reference in enumerate(repeat(rig.references.at(0.0), ticks)):
            if between is not None:
                between(k, controller)
            yield reference

    osc.run_loop(robot, controller, references(), recorder=recorder, check=False)
    return (recorder, robot)


def of(found, *kinds):
    return [one for one in found if one["event"] in kinds]


def test_states_and_stops_are_logged_with_their_reasons_and_times(rig, tmp_path):
    began = datetime.now(UTC)
    journal = tmp_path / "unfinished.mcap"
    recorder, robot = looped(rig, 60, 5, *range(20, 60), journal=journal)
    lines = [json.loads(line) for line in events_beside(journal).read_text().splitlines()]
    assert lines == recorder._events.events, "each is written as it comes"
    states = [(round(1e3 * one["t"]), one["from"], one["to"]) for one in of(lines, "state")]
    assert states == [
        (4, "RUN", "DEGRADED"),
        (5, "DEGRADED", "RUN"),
        (19, "RUN", "DEGRADED"),
        (21, "DEGRADED", "HOLD"),
        (38, "HOLD", "SAFE_STOP"),
    ]
    assert "wrenches" in of(lines, "state")[0]["reason"]
    stops = of(lines, "stop")
    assert [one["reason"] for one in stops] == robot.reasons
    assert "wrenches" in stops[0]["reason"] and stops[-1]["reason"] == ""
    times = [datetime.fromisoformat(one["time"]) for one in lines]
    assert times == sorted(times) and all(one.utcoffset() == timedelta(0) for one in times)
    assert began <= times[0] and times[-1] <= datetime.now(UTC)


def test_a_request_for_brakes_is_logged(rig):
    plant, controller = start(rig)
    recorder = osc.Recorder(controller, plant)
    seen, reference = plant.measure(), rig.references.at(0.0)
    controller.tick(seen, reference)
    blind = osc.Measurement(np.nan * seen.q, np.nan * seen.v, np.nan * seen.wrenches)
    for _ in range(40):
        tau = controller.tick(blind, reference)
        recorder.append(blind, reference, tau, 0.0)
    (brakes,) = of(recorder.recording().events, "brakes")
    assert brakes["joint"] == controller.unbraked and "mechanical brakes" in brakes["reason"]


def test_changes_of_settings_and_a_reset_are_logged(rig):
    def change(k, controller):
        match k:
            case 3:
                controller.f_tare = [1.0, 0.0, 0.0, 0.0, 0.0, 0.5]
            case 6:
                controller.engaged = False
            case 50:
                controller.reset()

    recorder, _ = looped(rig, 60, *range(10, 45), between=change)
    found = recorder.recording().events
    assert [(one["name"], one["value"]) for one in of(found, "setting")] == [
        ("f_tare", [1.0, 0.0, 0.0, 0.0, 0.0, 0.5]),
        ("engaged", False),
    ]
    (reset,) = of(found, "reset")
    assert (reset["from"], reset["t"]) == ("SAFE_STOP", approx(0.05))


def test_another_controller_that_continues_is_noted_with_what_it_has_otherwise(rig):
    plant, controller = start(rig)
    recorder = osc.Recorder(controller, plant)
    reference = rig.references.at(0.0)
    for k in range(20):
        if k == 10:
            limits = controller.settings.safety.replaced(contact_force=44.0)
            controller = controller.with_safety(limits).with_gains(
                osc.Gains(force=osc.ForceGains(bandwidth=4.0))
            )
            recorder.switch(controller)
        seen = plant.measure()
        tau = controller.tick(seen, reference)
        recorder.append(seen, reference, tau, 0.0)
        plant.command(tau, controller.dt)
    recording = recorder.recording()
    (one,) = of(recording.events, "settings")
    assert one["t"] == approx(0.01)
    assert one["changed"]["safety.contact_force"] == [30.0, 44.0]
    assert one["changed"]["gains.force.bandwidth"][1] == 4.0
    assert "safety.torque_rate" not in one["changed"]
    assert_continues = np.abs(np.diff(recording["alpha_meas"], axis=0)[5:]).max()
    assert assert_continues < 2.0, "rows after it are of the new controller"
    assert not changed_settings(controller.settings, controller.settings)


def test_a_ceiling_that_rises_with_the_commands_is_logged():
    rig = rig_of("two_contact_rod", "plant.type=rigid")
    plant = rig.plant()
    chain, pairs = rig.chain, rig.controlled_pairs()
    controller = osc.Controller(chain, pairs, rig.gains, posture=rig.q_contact)
    recorder = osc.Recorder(controller, plant)
    reference = rig.references.at(0.0)
    for k in range(60):
        seen = plant.measure()
        given = replace(reference, alpha_d=[10.0 + k, 8.0])
        tau = controller.tick(seen, given)
        recorder.append(seen, given, tau, 0.0)
        plant.command(tau, controller.dt)
    found = of(recorder.recording().events, "ceiling")
    contact = [one["value"] for one in found if one["name"] == "contact_ceiling"]
    assert contact[0] == 33.0 and 3 * 62.0 <= contact[-1] <= 3 * 69.0
    assert (np.diff(contact) > 0.09 * np.array(contact[:-1])).all(), "a tenth each time"


def test_a_run_keeps_its_events_beside_its_recording(tmp_path):
    recording = run_of("two_contact_rod", plant="rigid", duration=0.05)
    path = recording.save(tmp_path / "run.npz")
    again = osc.Recording.load(path)
    assert again.events == recording.events
    assert [one["event"] for one in again.events] == ["start", "stop", "end"]
    before = path.read_bytes()
    run_of("two_contact_rod", plant="rigid", duration=0.05).save(path)
    assert path.read_bytes() == before, "clocks are in the files beside it"
    (tmp_path / "other.events.jsonl").write_text(events_beside(path).read_text())
    run_of("two_contact_rod", plant="rigid", duration=0.04).save(tmp_path / "new.npz")
    (tmp_path / "new.npz").rename(tmp_path / "other.npz")
    assert osc.Recording.load(tmp_path / "other.npz").events == [], "of another recording"


def test_a_recording_has_version_law_date_and_the_robot_files_hashes(tmp_path):
    began = datetime.now(UTC).replace(microsecond=0)
    recording = run_of("two_contact_rod", plant="rigid", duration=0.02)
    meta = osc.Recording.load(recording.save(tmp_path / "run.npz")).meta
    assert (meta["version"], meta["law_hash"]) == (osc.__version__, law_hash())
    assert began <= datetime.fromisoformat(meta["date"]) <= datetime.now(UTC)
    scenario = osc.load_scenario("two_contact_rod")
    urdf, *_ = resolve_urdf(scenario.arms[0].urdf, Path.cwd())
    assert meta["robot_files"]["arms.left"] == sha256(Path(urdf).read_bytes()).hexdigest()
    assert {"arms.right", "object"} < set(meta["robot_files"])


def test_a_log_that_cannot_be_written_or_is_full_ends_no_loop(tmp_path, monkeypatch):
    monkeypatch.setattr(events, "MOST", 5)
    log = EventLog(tmp_path / "run.events.jsonl")

    def at_once(call):
        call()

    for k in range(9):
        log.note(0.1 * k, "state", {"to": "RUN", "reason": np.inf if k == 0 else ""}, at_once)
    log.note(1.0, "state", {"to": "SAFE_STOP"}, at_once)
    log.note(1.1, "stop", {"reason": "why"}, at_once)
    assert [one["event"] for one in log.events] == ["state"] * 6 + ["stop"] and log.omitted == 4
    import os

    def full(*given):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    log.note(1.2, "stop", {"reason": "again"}, at_once)
    assert "No space left" in str(log.error) and len(log.events) == 8
