"""Compiled runs: every number of the recording is that of the same run, tick by tick in Python."""

from __future__ import annotations

import numpy as np
import pytest

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts.detection import collision_shapes
from osc_contact.law.jit import PLAIN_PYTHON
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.recorder.memory import MemoryJournal
from osc_contact.runs import driven
from osc_contact.runs.compiled_loop import compiled_loop
from osc_contact.runs.driven_log import DrivenLog
from osc_contact.runs.preflight import require_ready
from osc_contact.runs.run import run_rig, start
from osc_contact.sweeps.rows import Workshop

compares = pytest.mark.skipif(PLAIN_PYTHON, reason="no compiled run to compare with")

PLAIN = ["two_contact_rod", "panda_edge", "hinge_ball_rod", "three_arm_plate", "limited_rod"]
OTHERS = ["workcell", "moving_face", "approach_and_slide"]  # sensors, faces that move, phases


def compare(one: osc.Recording, other: osc.Recording) -> None:
    assert set(one.channels) == set(other.channels)
    for name in set(one.channels) - {"tick_s"}:
        np.testing.assert_array_equal(np.asarray(other[name]), np.asarray(one[name]), name)
    clocks = {"wall_s", "cpu_s"}
    assert {k: v for k, v in one.meta.items() if k not in clocks} == {
        k: v for k, v in other.meta.items() if k not in clocks
    }


def spy(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Ticks that Python had a part in."""
    seen: list[int] = []
    inner = DrivenLog.note

    def note(self, *args):
        seen.append(self.count)
        inner(self, *args)

    monkeypatch.setattr(DrivenLog, "note", note)
    return seen


def python_run(*args, **kwargs) -> osc.Recording:
    """`osc.run`, tick by tick in Python."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(driven, "compiled_loop", lambda: None)
        return osc.run(*args, **kwargs)


@pytest.mark.parametrize("name", PLAIN)
@compares
def test_recording_is_that_of_the_same_run(name, monkeypatch) -> None:
    scenario = osc.load_scenario(name, ["duration=0.7 s"])
    one, by_hand = python_run(scenario, seed=3), spy(monkeypatch)
    other = osc.run(scenario, seed=3)
    compare(one, other)
    assert 1e-7 < other["tick_s"].min() < other["tick_s"].mean() < 5e-3
    ticks = round(0.7 * scenario.control.rate)
    assert 1 <= len(by_hand) < 0.5 * ticks  # the others were compiled


@compares
def test_contacts_that_open_and_close_do_so_in_compiled_runs_too(monkeypatch) -> None:
    gone = "force.left_end=[{type: step, value: 10 N, start: 0.2 s}]"
    scenario = osc.load_scenario("two_contact_rod", [gone, "duration=0.5 s"])
    one, by_hand, other = python_run(scenario), spy(monkeypatch), osc.run(scenario)
    assert set(np.unique(one["contact_phase"][:, 0])) == {0, 1, 2}
    compare(one, other)
    assert 195 <= len(by_hand) < 260  # while it was open


@compares
def test_runs_are_compiled_here_and_the_same_where_they_cannot_be(monkeypatch) -> None:
    """With the numba and MuJoCo of the constraints they are; with others Python runs every tick."""
    assert compiled_loop() is not None
    scenario = osc.load_scenario("two_contact_rod", ["duration=0.1 s"])
    compiled, by_hand = osc.run(scenario), spy(monkeypatch)
    compare(compiled, python_run(scenario))
    assert len(by_hand) == 100


@pytest.mark.parametrize("name", OTHERS)
@compares
def test_what_python_has_a_part_in_runs_as_ever(name, monkeypatch) -> None:
    scenario = osc.load_scenario(name, ["duration=0.1 s"])
    one, by_hand = python_run(scenario, seed=3), spy(monkeypatch)
    compare(one, osc.run(scenario, seed=3))
    assert len(by_hand) == round(0.1 * scenario.control.rate)


@compares
def test_ticks_at_a_motor_limit_are_those_of_the_quadratic_program(monkeypatch) -> None:
    """Weak motors: a good part of the ticks saturates, in Python, and the rest goes on from it."""
    weak = ["arms.left.effort_factor=0.09", "arms.right.effort_factor=0.09", "gains.force.rise=0"]
    scenario = osc.load_scenario("two_contact_rod", [*weak, "duration=0.3 s"])
    one, by_hand, other = python_run(scenario), spy(monkeypatch), osc.run(scenario)
    saturated = int(np.count_nonzero(np.asarray(one["status"]) == 1))
    assert 5 <= saturated <= len(by_hand) < 300
    compare(one, other)


@compares
def test_a_run_that_diverges_leaves_what_came_before(monkeypatch) -> None:
    """Something hits the arm after the first tick, which Python does; the next is compiled."""
    command = MujocoPlant.command

    def hit(plant, tau, duration):
        command(plant, tau, duration)
        plant.data.xfrc_applied[:] = 1e14

    monkeypatch.setattr(MujocoPlant, "command", hit)
    scenario = osc.load_scenario("two_contact_rod", ["duration=0.1 s"])
    with pytest.raises(osc.PlantError, match="diverged") as single:
        python_run(scenario)
    with pytest.raises(osc.PlantError) as compiled:
        osc.run(scenario)
    assert str(single.value) == str(compiled.value)
    assert len(compiled.value.recording) == 2
    compare(single.value.recording, compiled.value.recording)


def test_rigs_of_a_workshop_are_those_built_alone() -> None:
    """In an order in which every chain that is kept has been used by another run."""
    workshop = Workshop()
    changes = [(m, n) for m in (1.0, 1.2) for n in ("0.50", "0.53")]
    scenarios = [
        osc.load_scenario(
            "two_contact_rod",
            [f"model_error.object_mass={m}", f"contacts.left_end.face.normal.0={n}",
             "duration=0.05 s"],
        )
        for m, n in changes
    ]  # fmt: skip
    for scenario in scenarios:
        compare(osc.run(scenario), run_rig(workshop.rig(scenario), journal=MemoryJournal()))
    rigs = [workshop.rig(scenario) for scenario in scenarios]
    assert len({id(rig.chain) for rig in rigs}) == 1 and len({id(rig.model) for rig in rigs}) == 2
    assert len({rig.q_contact.tobytes() for rig in rigs}) == 2  # the normals do vary


def test_files_that_changed_are_read_anew_and_what_is_returned_is_nobodys(tmp_path) -> None:
    """What was read is kept by its bytes: same length, same second, another robot."""
    file = tmp_path / "body.urdf"
    text = robots.urdf_path("rod").read_text()
    heavier = text.replace('<mass value="1.5"/>', '<mass value="2.5"/>')
    assert len(heavier) == len(text) and heavier != text
    masses = []
    for one in (text, heavier, text):
        file.write_text(one)
        masses.append(robots.load_body(file).mass)
        robots.load_body(file).mass = 99.0
    assert masses[0] == masses[2] == 1.5 and masses[1] == 2.5
    arm = robots.load_model(robots.urdf_path("scara_left"))
    arm.armature = arm.armature + 5.0
    assert not robots.load_model(robots.urdf_path("scara_left")).armature.any()
    (shape, *_), n = collision_shapes(file), len(collision_shapes(file))
    file.write_text(text.replace("<sphere radius", "<sphere  radius").replace("0.01", "0.02"))
    assert len(collision_shapes(file)) == n and collision_shapes(file)[0] is not shape


def test_doubts_and_refusals_are_those_of_a_run() -> None:
    scenario = osc.load_scenario("two_contact_rod", ["duration=0.05 s", "control.rate=80 Hz"])
    rig = osc.build_rig(scenario)
    assert require_ready(rig) == run_rig(rig).meta["doubts"] != []
    with pytest.raises(osc.ScenarioError):
        run_rig(osc.build_rig(scenario.replaced(control={"rate": 20.0})))


def test_start_leaves_the_controller_that_only_gave_first_torques_behind() -> None:
    """Both controllers of a start know nothing of one another."""
    rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
    _, controller = start(rig)
    assert not controller._records.memory.ticked
