"""Reports of runs: tables of the command line, and files of results."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from osc_contact.errors import InvalidInputError
from osc_contact.files import Json, write_whole
from osc_contact.lab.checks.inspection import Inspection
from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.rig.dither import gain_in_words
from osc_contact.lab.rig.rig import build_rig
from osc_contact.lab.runs.verdict import metrics
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.tasks.packaged import task_content, task_verdict
from osc_contact.lab.visual.run_figures import RECORDING, FigureProcess, draw_figures
from osc_contact.loop.realtime import latency
from osc_contact.plan.stage import StageVerdict
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S
from osc_contact.robots import RobotSummary
from osc_contact.robots.summary import losses_by_arm
from osc_contact.spatial import Array

MOST_PROJECTED = 0.1  #: of the total power; a larger share is explained


def verdict_table(verdict: Json) -> Table:
    """Make the table of a run's metrics for the terminal.

    Args:
        verdict: content of metrics.json, see `metrics`; a quantity that is None has no row.
    """
    title = (
        f"{verdict['scenario']} on {verdict['plant']}, {verdict['duration_s']:g} s, "
        f"{verdict['real_time_factor']:.2f} × real time"
    )
    table = Table("quantity", "value", title=title)
    for name, force in verdict["force"].items():
        table.add_row(
            f"force {name}",
            f"rms {_percent_text(force['rms_error_rel'])}, peak "
            f"{_percent_text(force['peak_error_rel'])} of {force['mean_command_N'] or 0.0:.2f} N; "
            f"sensed within {_percent_text(force['sensing_rms_rel'])}; closed "
            f"{100 * verdict['contact_fraction'][_contact_of_force(name)]:.2f} %",
        )
    # landings, and overshoots of the answers to steps of the force
    for contact, first in verdict["first_contact_s"].items():
        words = "never" if first is None else _closing_line(first, contact, verdict["steps"])
        table.add_row(f"first contact {contact}", words)
    for row in _step_rows(verdict["steps"]):
        table.add_row(*row)
    motion = verdict["motion"]
    power = verdict["power"]
    tick = verdict["tick_us"]
    if motion["rms_error_m"] is not None:
        table.add_row(
            "free motion",
            f"rms {1e3 * motion['rms_error_m']:.4f} mm, {1e3 * motion['rms_error_rad']:.4f} mrad",
        )
    if power["total_rms_W"] is not None:
        table.add_row(
            "power",
            f"total {power['total_rms_W']:.4g} W, projected {power['projected_rms_W']:.3g} W"
            + _power_words(power["ratio"]),
        )
    # friction of the joints, as modelled and as learned
    for arm, words in losses_by_arm(verdict["joint_losses"]):
        table.add_row(f"joints {arm}, in the model", words)
    for arm, words in losses_by_arm(verdict["learned_friction"]):
        table.add_row(f"joints {arm}, learned", words)
    # estimated normals: remaining errors, and by how much these change the forces
    for name, std in verdict["normals"].items():
        if std is not None:
            table.add_row(f"normal of {name}", f"known to {np.rad2deg(std):.2g} deg")
    largest_std = max(filter(None, verdict["normals"].values()), default=0.0)
    if words := gain_in_words(verdict["force_per_normal"], largest_std):
        table.add_row("", words)
    table.add_row("tick", f"p50 {tick['p50']:.0f} µs, p99 {tick['p99']:.0f} µs")
    for row in _stage_rows(verdict):
        table.add_row(*row)
    if verdict.get("loop"):
        table.add_row("measurement to torques", latency(verdict["loop"]))
    table.add_row("ticks", ", ".join(f"{n} {name}" for name, n in verdict["status"].items() if n))
    if verdict["at_limit"]:
        motors = ", ".join(f"{joint} {n}" for joint, n in verdict["at_limit"])
        table.add_row("ticks at a motor limit", motors)
    return table


def _stage_rows(verdict: Json) -> Iterator[tuple[str, str]]:
    """Row of each stage that a plan passed; none without a plan."""
    for stage in (verdict.get("plan") or {}).get("stages", ()):
        yield f"stage {stage['name']}", str(StageVerdict(**stage)).partition(": ")[2]


def inserted_table(verdict: Json) -> Table:
    """Make the table of a packaged task's verdict for the terminal.

    Args:
        verdict: result of `task_verdict`.
    """
    inserted = verdict["inserted"]
    title = f"{verdict['scenario']}, seed {verdict['seed']}, {verdict['duration_s']:.1f} s"
    table = Table("quantity", "value", title=title)
    for row in _stage_rows(verdict):
        table.add_row(*row)
    depth = f"{1e3 * inserted['depth']:.1f} mm deep, tilted by {np.rad2deg(inserted['tilt']):.2f}°"
    table.add_row("peg in the true hole", f"{depth}, {inserted['tries']} tries")
    forces = f"sum {inserted['largest_sum']:.0f} N, single {inserted['largest_single']:.0f} N"
    table.add_row("largest contact forces", forces)
    return table


def task_lines(verdict: Json) -> Iterator[str]:
    """Lines with the verdict on the task and its causes."""
    task = verdict["task"]
    yield f"verdict: {task['word']}" + (", the task failed" if task["failed"] else "")
    yield from (f"  {why}" for why in task["why"])


def _closing_line(t: float, contact: str, steps: Sequence[Json]) -> str:
    """Line on the time at which a contact closed and the overshoot of its forces.

    Args:
        t: time at which it closed (s).
        contact: its name.
        steps: `steps` of the metrics.
    """
    first_steps = [
        s
        for s in steps
        if s["what"] == "first contact" and _contact_of_force(s["force"]) == contact
    ]
    return f"at {t:.3f} s" + "".join(f"; {_overshoot_words(s)}" for s in first_steps)


def _step_rows(steps: Sequence[Json], limit: int = 3) -> Iterator[tuple[str, str]]:
    """Make a row for each step of a force: its time, its size (N) and its overshoot.

    Args:
        steps: `steps` of the metrics.
        limit: number of steps of one force; of a force with more steps, only the one with the
            largest overshoot has a row.

    Yields:
        Label and text of a row.
    """
    by_force: dict[str, list[Json]] = {}
    for step in steps:
        if step["what"] == "step":
            by_force.setdefault(step["force"], []).append(step)
    for name, steps_of_name in by_force.items():
        label = f"step {name}"
        if len(steps_of_name) > limit:
            label = f"worst of {len(steps_of_name)} steps {name}"
            steps_of_name = [max(steps_of_name, key=lambda s: s["overshoot_rel"])]
        for s in steps_of_name:
            change = f"at {s['t_s']:.3f} s from {s['from_N']:.3g} N to {s['to_N']:.3g} N"
            yield label, f"{change}; {_overshoot_words(s)}"


def _power_words(ratio: float | None) -> str:
    """Words for the ratio of projected to total power, with its cause where it is large.

    Args:
        ratio: projected power over total power; None: unknown, without words.
    """
    if ratio is None:
        return ""
    if ratio <= MOST_PROJECTED:
        return f", ratio {_percent_text(ratio)}"
    return (
        f"; the projected part (ratio {_percent_text(ratio)}) is power into the contacts: "
        "they yielded, or the object hardly moved along them"
    )


def _overshoot_words(step: Json) -> str:
    """Words for the overshoot of a force step."""
    if not step["overshoot_N"]:
        return "no overshoot"
    return (
        f"reaches {step['peak_N']:.3g} N of {step['commanded_N']:.3g} N, "
        f"overshoot {_percent_text(step['overshoot_rel'])}"
    )


def _contact_of_force(force: str) -> str:
    """Name of the contact of a force, such as pad of pad.1."""
    return force.partition(".")[0]


def basis_tables(inspection: Inspection) -> Iterator[Table]:
    """Make the tables of N, with a column for each contact, and of T, one for each motion.

    Args:
        inspection: inspection of a scenario.
    """
    where = "(at the object's origin, world axes)"
    yield _basis_table(
        f"N: forces the contacts transmit {where}",
        inspection.N,
        inspection.contacts,
        ("force {}", "moment {} (m)"),
    )
    names = [f"t{i + 1}" for i in range(inspection.T.shape[1])]
    largest = np.abs(inspection.T).max(axis=0, initial=1e-300)
    yield _basis_table(
        f"T: motions they permit {where}",
        inspection.T / largest,
        names,
        ("linear {} (m/s)", "angular {} (rad/s)"),
    )


def scenario_table(scenarios: Mapping[str, str]) -> Table:
    """Names and descriptions of the packaged scenarios and tasks."""
    table = Table("name", "what it is", title="osc-contact run NAME")
    for name, words in scenarios.items():
        table.add_row(name, words.strip())
    return table


def robot_tables(robot: RobotSummary) -> Iterator[Table]:
    """Make the table of the joints, and that of the inertias and mobilities at the tips.

    Args:
        robot: summary of a model, from `check_robot`.
    """
    joints = Table(
        "joint",
        "type",
        "positions",
        "effort",
        "velocity",
        "moves (kg)",
        title=f"{robot.name}: joints",
    )
    for joint in robot.joints:
        angle, effort, speed = (
            ("m", "N", "m/s") if joint.kind == "prismatic" else ("rad", "N m", "rad/s")
        )
        joints.add_row(
            joint.name,
            joint.kind,
            f"{_range_text(joint.lower, joint.upper)} {angle}",
            f"{joint.effort:g} {effort}",
            f"{joint.velocity:g} {speed}",
            f"{joint.moved_mass:.4g}",
        )
    if robot.joints:
        yield joints
    # apparent inertias and mobilities, smallest and largest value over random postures
    tips = Table(
        "tip",
        "joints",
        "apparent mass (kg)",
        "apparent inertia (kg m²)",
        "mobility σ₁, σ₂, … (unit-free)",
        title="reachable at the tips",
    )
    for tip in robot.tips:
        sigma = ", ".join(_range_text(low, high, 2) for low, high in tip.mobility)
        tips.add_row(
            tip.tip,
            str(tip.joints),
            _range_text(*tip.mass, 3),
            _range_text(*tip.inertia, 3),
            sigma or "the tip's body is no solid",
        )
    if robot.tips:
        yield tips


def _range_text(low: float, high: float, digits: int = 4) -> str:
    """Write a range of two numbers; an infinite end becomes ∞.

    Args:
        low, high: ends of the range.
        digits: number of significant digits.
    """
    words = (f"{value:.{digits}g}".replace("inf", "∞") for value in (low, high))
    return " … ".join(words)


def _basis_table(title: str, basis: Array, names: Sequence[str], labels: Sequence[str]) -> Table:
    """Make the table of a basis of motions or forces.

    Args:
        title: title of the table.
        basis: (6, k) basis, a motion or a force in each column.
        names: names of the columns.
        labels: names of the three linear and of the three angular rows, with {} for the axis.
    """
    table = Table("", *names, title=title)
    for i, row in enumerate(basis):
        label = labels[i // 3].format("xyz"[i % 3])
        table.add_row(label, *(f"{round(float(value), 4) + 0.0:.4f}" for value in row))
    return table


def _percent_text(ratio: float | None) -> str:
    """Write a ratio in percent; None, an unknown ratio, becomes a dash."""
    return "–" if ratio is None else f"{100 * ratio:.3g} %"


def require_judgeable(scenario: Scenario) -> None:
    """Refuse, before it runs, a run that would end before it can be judged.

    Raises:
        InvalidInputError: with the time from which runs are judged.
    """
    if scenario.duration <= SETTLE_S:
        raise InvalidInputError(
            f"duration {scenario.duration:g} s: a run is judged from t = {SETTLE_S:g} s on; "
            "run it longer"
        )


def write_report(
    recording: Recording, scenario: Scenario, folder: Path, figures: FigureProcess | None = None
) -> Json:
    """Write metrics.json, recording.npz, the figures and scene.html; returns the metrics.

    Args:
        recording: recording of the run.
        scenario: that was run.
        folder: folder for the files.
        figures: draws them meanwhile; None: this process draws them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    recording.save(folder / RECORDING)
    if figures is not None:
        figures.begin(folder)
    verdict = metrics(recording)
    write_json(verdict, folder / "metrics.json")
    write_scene_of(recording, build_rig(scenario), folder / "scene.html")
    if figures is None or not figures.finish():
        draw_figures(recording, folder)
    return verdict


def write_task_report(recording: Recording, folder: Path) -> Json:
    """Write metrics.json, recording.npz and scene.html of a packaged task; returns the verdict.

    Args:
        recording: recording by `run_task`.
        folder: folder for the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    recording.save(folder / RECORDING)
    verdict = task_verdict(recording)
    write_json(verdict, folder / "metrics.json")
    write_scene_of(recording, task_content(recording), folder / "scene.html")
    return verdict


def write_json(data: Any, path: Path) -> None:
    """Write JSON, a file that appears complete or not at all."""
    write_whole(json.dumps(data, indent=2) + "\n", path)
