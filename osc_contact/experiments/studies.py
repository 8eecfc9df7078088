"""Experiments beside the main job: each gives figures, a table and its numbers by one name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

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


STUDIES: dict[str, Callable[[int, float | None], Study]] = {
    "kinematic_stability": _kinematic_stability,
}
