"""The picture: which postures are unstable, and what happens in one of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from osc_contact.spatial import Array
from osc_contact.visual import contact_colour
from osc_contact.visual.style import style
from paper.kinematic_stability import Result
from paper.kinematic_stability.search import PostureMap, WorstPosture
from paper.kinematic_stability.simulate import Histories

__all__ = ["draw"]

_LIMIT = 25.0  #: 1/s, where the colours of the maps end


def draw(results: Sequence[Result]) -> Figure:
    """A row per arm: both maps of least real parts (unstable hatched), and the joint errors."""
    with style():
        figure = Figure(figsize=(12.0, 4.2 * len(results) + 0.3))
        rows = figure.subfigures(len(results), 1, squeeze=False)[:, 0]
        for row, result in zip(rows, results, strict=True):
            worst = result.worst
            row.suptitle(
                f"{worst.arm.name}: of {worst.tried} random postures (the more regular of "
                f"{worst.drawn}) the classic scheme is unstable in {worst.unstable}, "
                f"ours in {worst.ours_unstable}",
                x=0.01, ha="left", size=11.5, weight="bold",
            )  # fmt: skip
            grid = row.add_gridspec(2, 3, width_ratios=(1.0, 1.0, 1.05))
            maps = [row.add_subplot(grid[:, k]) for k in (0, 1)]
            m = result.map
            shade = _map(maps[0], m, m.classic, worst, r"classic: $M^{-1}K_q J^{-1}SJ$")
            _map(maps[1], m, m.ours, worst, r"ours: $(T^TB^{-1}T)^{-1}T^TB^{-1}K\,T,\ K=BK'$")
            bar = row.colorbar(shade, ax=maps, shrink=0.9, pad=0.02, extend="both")
            bar.set_label(r"least real part $\lambda$, as sign$(\lambda)\sqrt{|\lambda|}$ (1/s)")
            above = row.add_subplot(grid[0, 2])
            below = row.add_subplot(grid[1, 2], sharex=above)
            _errors(above, result.histories, result.histories.classic, "classic, started off ×")
            _errors(below, result.histories, result.histories.ours, "ours, from the same start")
            above.legend(loc="upper right", ncols=2)
            above.tick_params(labelbottom=False)
            below.set_xlabel("time (s)")
    return figure


def _map(ax: Axes, m: PostureMap, values: Array, worst: WorstPosture, title: str) -> Any:
    rates = np.clip(np.sign(values) * np.sqrt(np.abs(values)), -_LIMIT, _LIMIT)
    degrees = np.rad2deg(m.grid)
    shade = ax.pcolormesh(
        degrees, degrees, rates, cmap="RdBu", vmin=-_LIMIT, vmax=_LIMIT, shading="nearest",
        rasterized=True,
    )  # fmt: skip
    ax.set_facecolor("#BBBBBB")  # singular: neither
    if np.nanmin(values) < 0.0:
        ax.contourf(degrees, degrees, values, levels=[-1e30, 0.0], colors="none", hatches=["////"])
        ax.contour(degrees, degrees, values, levels=[0.0], colors="black", linewidths=1.0)
    a, b = m.joints
    ax.plot(*np.rad2deg(worst.q[[a, b]]), "X", color="black", mec="white", ms=11)
    ax.grid(False)
    ax.set(title=title, xlabel=rf"$q_{a + 1}$ (°)", ylabel=rf"$q_{b + 1}$ (°)", aspect="equal")
    ax.set(xticks=range(-180, 181, 90), yticks=range(-180, 181, 90))
    return shade


def _errors(ax: Axes, h: Histories, errors: Array, title: str) -> None:
    """All joint errors, on the scale of what they reach."""
    for i, error in enumerate(1e3 * errors.T):
        ax.plot(h.t, error, color=contact_colour(i), lw=1.6, label=f"$q_{i + 1}$")
    left = h.left_after()
    if np.isnan(errors).any() and left is not None:
        ax.axvline(left, color="black", lw=1.0, ls=(0, (3, 2)))
        ax.annotate(
            f"a joint is 0.5 rad off\nafter {left:.2f} s", (left, 0.0), (6, 0), size=8.5,
            xycoords=("data", "axes fraction"), textcoords="offset points", va="bottom",
        )  # fmt: skip
    ax.set(title=title, ylabel="joint errors (mrad)", xlim=(0.0, h.t[-1]))
