"""Experiments beside the main job: each gives figures, a table and its numbers by one name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from osc_contact.experiments.report import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["STUDIES", "Study", "write_study"]


@dataclass(frozen=True)
class Study:
    """What an experiment found.

    Attributes:
        figures: by file name, without suffix.
        table: to print.
        data: the numbers, for JSON.
    """

    figures: Mapping[str, Figure]
    table: Table
    data: Mapping[str, Any]


def write_study(
    name: str, folder: Path, seed: int = 0, duration: float | None = None
) -> tuple[Study, list[Path]]:
    """Run a study; write its figures (PNG, PDF) and NAME.json into a folder.

    Args:
        name: one of `STUDIES`.
        folder: made if need be.
        seed: of everything random.
        duration: of simulated runs (s); default: the study's own.
    """
    from osc_contact.visual.style import save

    folder.mkdir(parents=True, exist_ok=True)
    study = STUDIES[name](seed, duration)
    written = [
        path
        for title, figure in study.figures.items()
        for path in save(figure, folder / title, (".png", ".pdf"))
    ]
    written.append(folder / f"{name}.json")
    write_json(study.data, written[-1])
    return study, written


def _kinematic_stability(seed: int, duration: float | None) -> Study:
    from osc_contact.experiments import kinematic_stability as experiment
    from osc_contact.experiments.kinematic_stability.picture import draw

    results = experiment.run(seed, duration=1.0 if duration is None else duration)
    table = Table(
        "arm", "postures", "classic unstable", "classic least λ (1/s²)", "ours least λ (1/s²)",
        "classic leaves the posture", "ours: error first → last", title="kinematic stability",
    )  # fmt: skip
    for found, rows in ((r.found, r.as_dict()) for r in results):
        left = rows["classic_left_after_s"]
        table.add_row(
            found.arm.name,
            str(found.tried),
            str(found.unstable),
            f"{found.classic[0].real:.4g}",
            f"{found.ours_least:.4g}",
            "not" if left is None else f"after {left:.3f} s",
            f"{rows['first_error_mrad']:.3g} → {rows['last_error_mrad']:.3g} mrad",
        )
    return Study(
        {"kinematic_stability": draw(results)}, table, {"arms": [r.as_dict() for r in results]}
    )


def _fig2(seed: int, duration: float | None) -> Study:
    from osc_contact.experiments import cone_in_groove as experiment
    from osc_contact.experiments.cone_in_groove.picture import draw_run, draw_state

    result = experiment.run(5.0 if duration is None else duration)
    found = result.as_dict()
    table = Table("quantity", "value", title="fig. 2: a Panda turns a cone in its groove")
    frame = found["raibert_craig"]
    rms = ", ".join(f"{1e3 * value:.2g}" for value in found["wall_force_rms_N"])
    rows = {
        "constraint frame": "describes it" if frame["describes_it"] else frame["reason"],
        "force step → motion": f"{found['force_step_to_motion']:.2g} of the free object's answer",
        "motion step → force": f"{found['motion_step_to_force']:.2g} of the force it means",
        "forces": f"rms error {rms} mN; least push {found['wall_force_least_N']:.2f} N",
        "turn": f"{np.rad2deg(found['turned_rad']):.1f}°, "
        f"rms error {1e6 * found['turn_rms_rad']:.2g} µrad",
        "slide": f"{1e3 * found['slid_m']:.1f} mm, rms error {1e6 * found['slide_rms_m']:.2g} µm",
        "contact power": f"at most {found['contact_power_W']:.2g} W",
        "N per tick": f"changes by at most {found['N_change_per_tick']:.2g}, its change by "
        f"{found['N_second_difference']:.2g} (1, m)",
    }
    for row in rows.items():
        table.add_row(*row)
    return Study({"fig2": draw_state(result.rig), "fig2_run": draw_run(result)}, table, found)


STUDIES: dict[str, Callable[[int, float | None], Study]] = {
    "fig2": _fig2,
    "kinematic_stability": _kinematic_stability,
}
