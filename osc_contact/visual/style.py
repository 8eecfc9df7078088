"""The one look of all figures, stacked panels with one time axis, and files that appear whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from osc_contact.files import whole_file
from osc_contact.visual import OKABE_ITO

__all__ = ["PRINT", "legend", "panels", "save", "style"]

PRINT = (".png", ".svg", ".pdf")  #: of a figure of the paper or of a study


@contextmanager
def style() -> Iterator[None]:
    """The one look of all figures: Okabe-Ito colours, light grid, no box, constrained layout."""
    cycle = [OKABE_ITO[n] for n in ("blue", "vermillion", "green", "purple", "orange", "sky")]
    look: Any = {
        "axes.prop_cycle": cycler(color=[*cycle, OKABE_ITO["black"], "#999999"]),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.titlesize": 10,
        "axes.titlelocation": "left",
        "axes.labelsize": 9.5,
        "grid.color": "#E3E5E8",
        "grid.linewidth": 0.6,
        "xtick.labelsize": 9,
        "ytick.labelsize": 9,
        "legend.fontsize": 8.5,
        "legend.frameon": False,
        "lines.linewidth": 1.1,
        "mathtext.fontset": "dejavusans",
        "figure.constrained_layout.use": True,
        "figure.facecolor": "white",
        "svg.fonttype": "path",
        "pdf.fonttype": 42,
        "svg.hashsalt": "osc_contact",
    }
    with matplotlib.rc_context(look):
        yield


def panels(count: int, height: float) -> tuple[Figure, Sequence[Axes]]:
    """Panels below one another with one time axis; Agg canvas, no global state."""
    figure = Figure(figsize=(8.0, height * count + 0.4))
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for ax in axes:
        ax.margins(x=0.01)  # the first moments do not hide in the axis
    figure.align_ylabels(axes)
    return figure, list(axes)


def legend(ax: Axes) -> None:
    """Legend right of the panel, where it covers nothing."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def save(
    figure: Figure, path_without_suffix: str | Path, suffixes: Sequence[str] = (".png", ".svg")
) -> tuple[Path, ...]:
    """Write the figure as PNG (150 dpi), SVG, PDF; each file appears complete or not at all.

    Args:
        figure: to write.
        path_without_suffix: the suffixes are appended to it.
        suffixes: one file each.

    Returns:
        The paths, one for each suffix.
    """
    base = Path(path_without_suffix)
    written = []
    undated: dict[str, Any] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    for suffix in suffixes:
        written.append(base.with_name(base.name + suffix))
        with whole_file(written[-1]) as unfinished:
            figure.savefig(unfinished, dpi=150, format=suffix[1:], metadata=undated.get(suffix))
        figure.set_layout_engine("none")  # laid out once, alike in all files
    return tuple(written)
