"""The comparison in one figure: cross-talk as bars on a log scale, and steps over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from osc_contact.spatial import Array
from osc_contact.visual import OKABE_ITO
from osc_contact.visual.style import style
from paper.baselines.compare import OURS, Comparison
from paper.baselines.steps import FORCE_STEP_N, MOTION_STEP_M

__all__ = ["draw"]

_COLOURS = ("blue", "vermillion", "orange", "purple")
_DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
_HATCHES = ("", "//", "..", "xx")
_BEFORE_S = 0.05


def draw(comparison: Comparison) -> Figure:
    """Top: what a force step does to the motion. Bottom: what a motion step does to the force.

    Left: at one instant on the rigid plant, dimensionless. Middle: peak on MuJoCo. Right: over
    time on MuJoCo, every step after the other.
    """
    with style():
        figure = Figure(figsize=(10.0, 5.4))
        grid = figure.subplots(2, 3, gridspec_kw={"width_ratios": [1.0, 1.0, 2.7]})
        instant = np.array([comparison.measured[key].norms for key in comparison.laws])
        peaks = np.array([comparison.peaks("mujoco", key) for key in comparison.laws]) * [1e6, 1.0]
        r = comparison.instant.contact.r
        first = next(iter(comparison.steps["mujoco"].values()))
        names = [f"{c.name.replace('_', ' ')}" for c in comparison.scenario.contacts]
        forces = [f"{name}: +{FORCE_STEP_N:g} N" for name in names]
        motions = [f"free motion {i + 1}: +{1e3 * MOTION_STEP_M:g} mm"
                   for i in range(len(first.starts) - r)]  # fmt: skip
        rows = (
            (
                "force step → motion",
                r"$\|m\,G_f M^{-1}\|$",
                "displacement (µm)",
                "farthest point of the object since the last step",
                forces,
            ),
            (
                "motion step → force",
                r"$\|G_m K^{-1}\|/m$",
                "force error (N)",
                "contact with the larger error",
                motions,
            ),
        )
        for i, (title, symbol, unit, what, steps) in enumerate(rows):
            left, middle, right = grid[i]
            _bars(left, comparison, instant[:, i], limit=1e-9)
            left.set(title=f"({'ad'[i]}) {title}", ylabel=f"{symbol}  (1)")
            _bars(middle, comparison, peaks[:, i])
            middle.set(title=f"({'be'[i]}) largest of all steps", ylabel=unit)
            _history(right, comparison, i == 0, steps)
            right.set(title=f"({'cf'[i]}) {what}", ylabel=unit)
        for ax, where in zip(grid[0], ("rigid plant, one instant", "MuJoCo", "MuJoCo"),
                             strict=True):  # fmt: skip
            ax.text(0.5, 1.19, where, transform=ax.transAxes, ha="center", weight="bold")
        grid[1, 2].set_xlabel("time (s)")
        figure.legend(
            *_entries(comparison), loc="outside lower center", ncols=len(comparison.laws),
            handlelength=3.6, handler_map={tuple: HandlerTuple(ndivide=None)},
        )  # fmt: skip
    return figure


def _bars(ax: Axes, comparison: Comparison, values: Array, limit: float | None = None) -> None:
    """One bar for each law, with its number."""
    low = 10.0 ** (np.floor(np.log10(values.min())) - 0.5)
    for i, value in enumerate(values):
        ax.bar(i, value - low, bottom=low, width=0.7, color=OKABE_ITO[_COLOURS[i]],
               hatch=_HATCHES[i], edgecolor="white", lw=0.0)  # fmt: skip
        ax.annotate(_number(value), (i, value), (0, 2), textcoords="offset points",
                    ha="center", fontsize=8.5)  # fmt: skip
    ax.set_yscale("log")
    ax.set_ylim(low, values.max() * (values.max() / low) ** 0.13)
    ax.set_xticks([])
    ax.grid(False, axis="x")
    if limit is not None:
        ax.axhline(limit, color="black", lw=0.8, ls=(0, (4, 3)))
        ax.annotate("limit", (0.0, limit), (0, 2), textcoords="offset points", ha="center",
                    fontsize=8.5)  # fmt: skip


def _history(ax: Axes, comparison: Comparison, of_forces: bool, steps: list[str]) -> None:
    """The effect of every step of one kind on the other quantity."""
    r = comparison.instant.contact.r
    offset = 0 if of_forces else r
    for i, run in enumerate(comparison.steps["mujoco"].values()):
        for k in range(offset, offset + len(steps)):
            rows = run.window(k, _BEFORE_S if k == offset else 0.0)
            if of_forces:
                effect = 1e6 * run.motion_effect(k, _BEFORE_S if k == offset else 0.0)
            else:
                error = run.force_effect(k, _BEFORE_S if k == offset else 0.0)
                effect = np.abs(error).max(axis=1)
            ax.plot(run.t[rows], effect, color=OKABE_ITO[_COLOURS[i]], ls=_DASHES[i],
                    lw=1.8 if i == 0 else 1.3, zorder=4 - i)  # fmt: skip
    ax.margins(x=0.0)
    top = ax.get_ylim()[1]
    ax.set_ylim(-0.03 * top, 1.15 * top)
    for words, start in zip(steps, run.starts[offset:], strict=False):
        ax.axvline(start, color="black", lw=0.7)
        ax.annotate(words, (start, 1.15 * top), (3, -2), textcoords="offset points",
                    va="top", fontsize=8.5)  # fmt: skip


def _entries(comparison: Comparison) -> tuple[list[Any], list[str]]:

    handles: list[Any] = []
    labels: list[str] = []
    for i, key in enumerate(comparison.laws):
        colour = OKABE_ITO[_COLOURS[i]]
        patch = Patch(facecolor=colour, hatch=_HATCHES[i], edgecolor="white", lw=0.0)
        handles.append((patch, Line2D([], [], color=colour, ls=_DASHES[i], lw=1.6)))
        labels.append(comparison.label(key) + ("" if key == OURS else ", best frame"))
    return handles, labels


def _number(value: float) -> str:
    if 1e-3 <= value < 1e4:
        return f"{value:#.2g}" if value < 10 else f"{value:.0f}"
    mantissa, exponent = f"{value:.0e}".split("e")
    return rf"${mantissa}\cdot10^{{{int(exponent)}}}$"
