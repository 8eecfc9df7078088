"""Experiments beside the main job: each gives figures, a table and its numbers by one name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from osc_contact.errors import InvalidInputError, ViewerError
from osc_contact.runs.report import write_json
from osc_contact.scenarios import load_scenario
from paper.statements import Answer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["SLOW", "STUDIES", "WITH_SAMPLES", "Ask", "Study", "write_study"]


@dataclass(frozen=True)
class Study:
    """What an experiment found.

    Attributes:
        figures: by file name, without suffix.
        table: to print.
        data: the numbers, for JSON.
        answers: of a study named as a figure of the paper, to what the paper states about it, by
            the keys of `PAPER`.
        pages: what writes a page to a path, by file name without suffix.
    """

    figures: Mapping[str, Figure]
    table: Table
    data: Mapping[str, Any]
    answers: Mapping[str, Answer] = field(default_factory=dict)
    pages: Mapping[str, Callable[[Path], Path]] = field(default_factory=dict)


@dataclass(frozen=True)
class Ask:
    """What a study may be asked for.

    Attributes:
        seed: of everything random.
        duration: of simulated runs (s); default: the study's own.
        changes: "key=value" of its scenario, where it has one.
        samples: of what varies, where something does; default: the study's own.
        folder: for what a study keeps while it goes on; None: nothing.
        tell: called with what it does next.
    """

    seed: int = 0
    duration: float | None = None
    changes: Sequence[str] = ()
    samples: int | None = None
    folder: Path | None = None
    tell: Callable[[str], None] = lambda _: None


def write_study(name: str, folder: Path, ask: Ask) -> tuple[Study, list[Path]]:
    """Run a study; write its figures (PNG, SVG, PDF) and NAME.json into a folder.

    Args:
        name: one of `STUDIES`.
        folder: made if need be.
        ask: seed, duration and more.

    Raises:
        InvalidInputError: changes of a scenario for a study that has none.
    """
    from osc_contact.visual.style import PRINT, save

    if ask.changes and name not in WITH_SCENARIO:
        raise InvalidInputError(f"{name} is not made from a scenario; leave --set out")
    folder.mkdir(parents=True, exist_ok=True)
    study = STUDIES[name](replace(ask, folder=folder))
    written = [
        path
        for title, figure in study.figures.items()
        for path in save(figure, folder / title, PRINT)
    ]
    written += [write(folder / f"{title}.html") for title, write in study.pages.items()]
    written.append(folder / f"{name}.json")
    write_json(study.data, written[-1])
    return study, written


def _kinematic_stability(ask: Ask) -> Study:
    from paper import kinematic_stability as experiment
    from paper.kinematic_stability.picture import draw

    results = experiment.run(ask.seed, duration=1.0 if ask.duration is None else ask.duration)
    table = Table(
        "arm", "postures", "classic unstable", "classic least λ (1/s²)", "ours least λ (1/s²)",
        "classic leaves the posture", "ours: error first → last", title="kinematic stability",
    )  # fmt: skip
    for worst, rows in ((r.worst, r.as_dict()) for r in results):
        left = rows["classic_left_after_s"]
        table.add_row(
            worst.arm.name,
            str(worst.tried),
            str(worst.unstable),
            f"{worst.classic[0].real:.4g}",
            f"{worst.ours_least:.4g}",
            "not" if left is None else f"after {left:.3f} s",
            f"{rows['first_error_mrad']:.3g} → {rows['last_error_mrad']:.3g} mrad",
        )
    return Study(
        {"kinematic_stability": draw(results)}, table, {"arms": [r.as_dict() for r in results]}
    )


def _fig2(ask: Ask) -> Study:
    from paper import cone_in_groove as experiment
    from paper.cone_in_groove.picture import draw_run, draw_state

    result = experiment.run(5.0 if ask.duration is None else ask.duration)
    data = result.as_dict()
    table = Table("quantity", "value", title="fig. 2: a Panda turns a cone in its groove")
    frame = data["raibert_craig"]
    rms = ", ".join(f"{1e3 * value:.2g}" for value in data["wall_force_rms_N"])
    rows = {
        "constraint frame": "describes it" if frame["describes_it"] else frame["reason"],
        "force step → motion": f"{data['force_step_to_motion']:.2g} of the free object's answer",
        "motion step → force": f"{data['motion_step_to_force']:.2g} of the force it means",
        "forces": f"rms error {rms} mN; least push {data['wall_force_least_N']:.2f} N",
        "turn": f"{np.rad2deg(data['turned_rad']):.1f}°, "
        f"rms error {1e6 * data['turn_rms_rad']:.2g} µrad",
        "slide": f"{1e3 * data['slid_m']:.1f} mm, rms error {1e6 * data['slide_rms_m']:.2g} µm",
        "contact power": f"at most {data['contact_power_W']:.2g} W",
        "N per tick": f"changes by at most {data['N_change_per_tick']:.2g}, its change by "
        f"{data['N_second_difference']:.2g} (1, m)",
    }
    for row in rows.items():
        table.add_row(*row)
    answers = {
        "freedoms": Answer(
            f"T has {6 - data['r']} columns. A Panda turns the cone by "
            f"{np.rad2deg(data['turned_rad']):.1f}° and slides it by "
            f"{1e3 * data['slid_m']:.1f} mm while all four wall forces push.",
            data["r"] == 4 and data["wall_force_least_N"] > 0.0,
        ),
        "axes": Answer(f"They are {data['axes_deg']:.1f}° apart.", 1.0 < data["axes_deg"] < 89.0),
        "frame": Answer(f"No frame: {frame['reason']}.", not frame["describes_it"]),
    }
    figures = {"fig2": draw_state(result.seat), "fig2_run": draw_run(result)}
    return Study(figures, table, data, answers)


def _fig3(ask: Ask) -> Study:
    from paper import fig3 as experiment

    duration = 1.4 if ask.duration is None else ask.duration
    ask.tell("making contact")
    cell = experiment.run(duration, ask.seed, ask.changes)
    table = Table("part", "what it is", title="fig. 3: the workcell")
    data = cell.as_dict()
    for part, words in data.items():
        table.add_row(part, words)
    figures = {}
    ask.tell("rendering")
    try:
        figures["fig3"] = experiment.draw(cell)
    except ViewerError as error:  # the page is there all the same
        table.add_row("picture", f"not rendered: {error}")
    pages = {"fig3": partial(cell.page, cell.shots()[0])}
    return Study(figures, table, data, cell.answers(), pages)


def _moving_face(ask: Ask) -> Study:
    from paper import moving_face as experiment

    cases = experiment.run(duration=10.0 if ask.duration is None else ask.duration, tell=ask.tell)
    table = Table(
        "left face", "law", "left force, rms", "peak", "right force, rms", "closed", "face travels",
        title="moving_face on mujoco",
    )  # fmt: skip
    for row in (case.row for case in cases):
        table.add_row(
            row["face"],
            row["law"],
            f"{row['left_end_rms_error_rel']:.3%}",
            f"{row['left_end_peak_error_N']:.3f} N",
            f"{row['right_end_rms_error_rel']:.3%}",
            f"{row['contact_fraction']:.2%}",
            f"{1e3 * row['travel_m']:.1f} mm",
        )
    return Study(
        {"moving_face": experiment.draw(cases)}, table, {"cases": [case.row for case in cases]}
    )


def _baselines(ask: Ask) -> Study:
    from paper.baselines.compare import compare
    from paper.baselines.figure import draw
    from paper.baselines.table import comparison_table

    changes = list(ask.changes)
    if ask.duration is not None:
        changes.append(f"duration={ask.duration!r}")
    ask.tell("best frames")
    comparison = compare(
        load_scenario("two_contact_rod", changes),
        seed=ask.seed,
        progress=lambda what, t: ask.tell(f"{what} {t:.1f} s"),
    )
    result = comparison.as_dict()
    return Study({"baselines": draw(comparison)}, comparison_table(result), result)


def _robustness(ask: Ask) -> Study:
    from paper import robustness as experiment
    from paper.robustness_picture import draw, tabulate

    changes = list(ask.changes)
    if ask.duration is not None:
        changes.append(f"duration={ask.duration!r}")
    samples = experiment.SAMPLES if ask.samples is None else ask.samples
    found = experiment.run(samples, ask.seed, changes, ask.folder, tell=ask.tell)
    return Study({"robustness": draw(found)}, tabulate(found), found.as_dict())


def _workcell(ask: Ask) -> Study:
    from paper import workcell as experiment

    rungs = experiment.ladder(
        duration=8.0 if ask.duration is None else ask.duration,
        seed=ask.seed,
        overrides=ask.changes,
        progress=ask.tell,
    )
    table = Table("what is real", "force, rms", "peak", "sensed within", "closed", title="workcell")
    data = {rung.real: rung.as_dict() for rung in rungs}
    for real, errors in data.items():
        numbers = ["diverged" if value is None else f"{value:.3%}" for value in errors.values()]
        table.add_row(real, *numbers)
    return Study({"workcell": experiment.draw(rungs)}, table, data)


def _fig7(ask: Ask) -> Study:
    from paper import contact_phases as experiment
    from paper.contact_phases_pictures import draw_collisions

    knocked, quiet = experiment.fig7(ask.duration, ask.seed, ask.changes, ask.tell)
    hits = experiment.collisions(knocked)
    late = [hit.flagged for hit in hits]
    flagged = [after for after in late if after is not None]
    data: dict[str, Any] = {
        "collisions": [vars(hit) for hit in hits],
        "flagged": len(flagged),
        "slowest_flag_s": max(flagged, default=None),
        "false_alarms": {
            name: {"count": experiment.false_alarms(r), "duration_s": float(r["t"][-1])}
            for name, r in {experiment.KNOCKED: knocked, **quiet}.items()
        },
    }
    table = Table("quantity", "value", title="fig. 7: contacts lost and made again, on mujoco")
    share = f"{len(flagged)} of {len(hits)}"
    table.add_row("collisions flagged within 20 ms", share)
    if flagged:
        table.add_row("slowest flag", f"{1e3 * max(flagged):.0f} ms after the collision")
    if hits:
        met = [1e3 * hit.speed for hit in hits]
        table.add_row("met at", f"{min(met):.0f} … {max(met):.0f} mm/s")
        peaks = [hit.power for hit in hits]
        table.add_row("peaks of projected power", f"{min(peaks):.3f} … {max(peaks):.3f} W")
    for name, r in quiet.items():
        rms = float(np.sqrt(np.mean(r["power_projected"][r["t"] >= 1.0] ** 2)))
        table.add_row(f"projected power of {name}, rms", f"{rms:.2g} W")
    for name, alarms in data["false_alarms"].items():
        table.add_row(
            f"false alarms in {alarms['duration_s']:.0f} s of {name}", str(alarms["count"])
        )
    figures = {"fig7": draw_collisions(knocked)}
    return Study(figures, table, data, experiment.answers(knocked))


def _approach_and_slide(ask: Ask) -> Study:
    from paper import contact_phases as experiment
    from paper.contact_phases_pictures import draw_landing

    changes = list(ask.changes)
    if ask.duration is not None:
        changes.append(f"duration={ask.duration!r}")
    runs = experiment.landings(range(ask.seed, ask.seed + experiment.SEEDS), changes, ask.tell)
    rows = [run.as_dict() for run in runs]
    table = Table(
        "seed", "standoff", "tilt", "contacts made at", "peak / command", "force error, rms",
        "largest torque rate", "success", title="approach_and_slide on mujoco",
    )  # fmt: skip
    for row in rows:
        made = ", ".join("–" if t is None else f"{t:.2f}" for t in row["made_s"])
        rms = row["force_rms_rel"]
        table.add_row(
            str(row["seed"]),
            f"{1e3 * row['standoff_m']:.1f} mm",
            f"{1e3 * row['tilt_rad']:.1f} mrad",
            f"{made} s",
            f"{row['peak_over_command']:.3f}",
            "–" if rms is None else f"{rms:.2%}",
            f"{row['torque_rate']:.1f} of {row['torque_rate_limit']:g} 1/s",
            "yes" if row["success"] else "no",
        )
    won = sum(row["success"] for row in rows)
    worst = max(row["peak_over_command"] for row in rows)
    table.add_row("all", "", "", "", f"≤ {worst:.3f}", "", "", f"{won} of {len(rows)}")
    return Study({"approach_and_slide": draw_landing(runs)}, table, {"runs": rows})


STUDIES: dict[str, Callable[[Ask], Study]] = {
    "fig2": _fig2,
    "fig3": _fig3,
    "kinematic_stability": _kinematic_stability,
    "moving_face": _moving_face,
    "baselines": _baselines,
    "robustness": _robustness,
    "workcell": _workcell,
    "fig7": _fig7,
    "approach_and_slide": _approach_and_slide,
}
WITH_SCENARIO = {"fig3", "baselines", "robustness", "workcell", "fig7", "approach_and_slide"}
"""whose scenario can be changed"""
WITH_SAMPLES = {"robustness"}
"""whose runs are samples"""
SLOW = {"baselines", "robustness", "workcell", "fig7", "approach_and_slide"}
"""several minutes: not in `reproduce all`"""
