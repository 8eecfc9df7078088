"""What the comparison leaves behind: baselines.json and the figure."""

from __future__ import annotations

from pathlib import Path

from osc_contact.experiments.baselines.compare import Comparison
from osc_contact.experiments.baselines.figure import draw
from osc_contact.experiments.report import write_json
from osc_contact.visual.style import save

__all__ = ["write_comparison"]


def write_comparison(found: Comparison, folder: Path) -> tuple[Path, Path, Path]:
    """Write baselines.json, baselines.png and baselines.pdf; returns their paths."""
    numbers = folder / "baselines.json"
    write_json(found.as_dict(), numbers)
    return numbers, *save(draw(found), folder / "baselines", "pdf")
