"""The drawings of docs/theory.md: `python docs/draw_theory.py` writes docs/images/theory_*.png."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, FancyArrowPatch, FancyBboxPatch, Polygon

from osc_contact.lab.visual.plots import save, style

IMAGES = Path(__file__).parent / "images"
BLUE, RED, GREEN, GREY, DARK = "#0072B2", "#D55E00", "#009E73", "#9AA1A9", "#2A2E33"
TILT = np.radians(20.0)
ALONG, OUT = (np.array([np.cos(TILT), np.sin(TILT)]), np.array([-np.sin(TILT), np.cos(TILT)]))


def draw_spaces() -> None:
    """A vertex on a face: the force it transmits and the motions it permits."""
    figure = Figure(figsize=(6.8, 2.7))
    left, right = figure.subplots(1, 2)
    for ax, title in ((left, "transmits: forces Nα"), (right, "permits: motions T")):
        _bare(ax, title, (-1.15, 1.15), (-0.75, 1.1))
        _face(ax, 1.0)
        ax.plot(*_segment((0, 0), (0.62, 0.8)), color=DARK, lw=7, solid_capstyle="round")
    _line(left, -0.9 * OUT, 1.15 * OUT, BLUE)
    _arrow(left, 0.62 * OUT, 0.06 * OUT, BLUE)
    _say(left, 0.66 * OUT + (-0.16, 0.06), "$N$: along one\nline, into the\nface", BLUE, "right")
    _arrow(right, (0, 0), 0.8 * ALONG, GREEN)
    _arrow(right, (0, 0), -0.8 * ALONG, GREEN)
    _say(right, 0.5 * ALONG + (0.1, -0.3), "slide", GREEN, "center")
    turn = {"arrowstyle": "<|-|>", "mutation_scale": 15, "color": RED, "lw": 2}
    right.add_patch(
        FancyArrowPatch((0.79, 0.42), (0.2, 0.87), connectionstyle="arc3,rad=0.25", **turn)
    )
    _say(right, (0.84, 0.62), "turn", RED, "left")
    save(figure, IMAGES / "theory_spaces", (".png",))


def draw_projections() -> None:
    """Both filters as what they are: projections along a direction that the inertia chooses."""
    n, t = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    inertia = np.array([[2.2, 0.9], [0.9, 1.0]])
    figure = Figure(figsize=(6.8, 3.1))
    left, right = figure.subplots(1, 2)

    _bare(left, "motion filter: $a_u$ is bent into $T$", (-0.35, 2.4), (-0.55, 1.95))
    wanted = np.array([0.6, 0.86])
    heavy = np.linalg.inv(inertia)
    kept = wanted - heavy @ n * (n @ wanted) / (n @ heavy @ n)
    size = np.sqrt((wanted - kept) @ inertia @ (wanted - kept))
    _line(left, -0.3 * t, 2.3 * t, GREEN)
    _say(left, (2.3, -0.16), "$T$: permitted", GREEN, "right")
    values, vectors = np.linalg.eigh(inertia)
    left.add_patch(
        Ellipse(wanted, *(2 * size / np.sqrt(values)), fill=False, ls="--", ec=GREY, lw=1.2,
                angle=float(np.degrees(np.arctan2(*vectors[::-1, 0]))))
    )  # fmt: skip
    _arrow(left, (0, 0), wanted, GREY)
    _arrow(left, (0, 0), kept, BLUE)
    left.plot(*_segment(wanted, kept), ":", color=DARK, lw=1.5)
    _say(left, wanted + (-0.08, 0.1), "$a_u$", DARK, "right")
    _say(left, (kept[0] - 0.05, -0.2), "$a_c$", BLUE, "center")
    _say(left, (1.0, -0.45), "dashed: equal cost ½ δaᵀB⁻¹δa", GREY, "center")

    _bare(right, "wrist filter: $f_c$ within what was felt", (-0.45, 2.4), (-0.55, 1.95))
    true, moved = 0.75 * n, 0.72 * inertia @ t
    felt = true + moved
    _line(right, -0.35 * n, 1.8 * n, BLUE)
    _say(right, (-0.08, 1.7), "$N$", BLUE, "right")
    _arrow(right, (0, 0), felt, GREY)
    _arrow(right, (0, 0), true, BLUE)
    right.plot(*_segment(felt, true), ":", color=DARK, lw=1.5)
    right.plot([felt[0], 0], [felt[1], felt[1]], ":", color=RED, lw=1.2)
    right.plot(0, felt[1], "o", mfc="white", color=RED, ms=6)
    _say(right, felt + (0.08, 0.05), "$f_{meas}$", DARK, "left")
    _say(right, (-0.07, true[1] - 0.1), "$f_c$", BLUE, "right")
    _say(right, (0.62, 1.14), "$\\Lambda_{out}\\,a$", DARK, "right")
    _say(right, (0.1, felt[1] + 0.13), "not $f_c$: across", RED, "left")
    save(figure, IMAGES / "theory_projections", (".png",))


def draw_chain() -> None:
    """Which inertia is where, from the motors to the faces."""
    figure = Figure(figsize=(7.4, 3.5))
    ax = figure.subplots()
    _bare(ax, "", (-3.1, 3.1), (-1.35, 1.55))
    hull = FancyBboxPatch((-1.24, -0.66), 2.48, 0.94, boxstyle="round,pad=0.06", fc="#EAF3FA",
                          ec=BLUE, ls="--", lw=1.2)  # fmt: skip
    ax.add_patch(hull)
    for side in (-1, 1):
        joints = np.array([(2.5, -0.9), (2.75, 0.35), (2.05, 1.2), (1.38, 0.0)]) * (side, 1)
        ax.plot(*joints.T, color=DARK, lw=5, solid_capstyle="round", solid_joinstyle="round")
        ax.plot(*joints[:3].T, "o", color="white", mec=DARK, ms=9)
        ax.plot(side * 2.5, -1.0, marker="s", ms=20, color=GREY, zorder=0)
        ax.plot(side * 1.38, 0.0, marker="s", ms=11, mfc=RED, mec="white")
        face = np.array([(0.55, -0.5), (1.2, -0.86), (1.12, -1.0), (0.47, -0.64)]) * (side, 1)
        ax.add_patch(Polygon(face, fc="#CFE3E2", ec="#3C6B68"))
        foot = np.array([0.92 * side, -0.7])
        ax.plot(*_segment((0.95 * side, 0), foot), color=DARK, lw=4, solid_capstyle="round")
        _arrow(ax, foot, foot + np.array([-0.17 * side, -0.35]), BLUE)
    ax.plot([-1.25, 1.25], [0, 0], color=DARK, lw=9, solid_capstyle="round")
    ax.plot(0, 0, "o", color="white", mec=DARK, ms=8)
    _say(ax, (0, 0.13), "$O$", DARK, "center")
    _say(ax, (0, -0.25), "object: $\\Lambda_o$", DARK, "center")
    _say(ax, (0, 0.48), "all beyond the sensors: $\\Lambda_{out}$", BLUE, "center")
    for side, arm in ((-1, "1"), (1, "2")):
        _say(ax, (side * 2.8, 0.95), f"arm {arm}: $\\Lambda_{arm}$", DARK, "center")
        _say(ax, (side * 1.52, -0.06), "wrist\nsensor", RED, "left" if side > 0 else "right")
    _say(ax, (0, -1.2), "contacts: $f_c = N\\alpha$", BLUE, "center")
    _say(ax, (0, 1.35), "motors: $\\tau$, as forces on the object $f_S = G\\tau$", DARK, "center")
    save(figure, IMAGES / "theory_chain", (".png",))


def _bare(ax: Axes, title: str, x: tuple[float, float], y: tuple[float, float]) -> None:
    ax.set(xlim=x, ylim=y, aspect="equal", title=title)
    ax.axis("off")


def _face(ax: Axes, half: float) -> None:
    corners = [-half * ALONG, half * ALONG, half * ALONG - 0.16 * OUT, -half * ALONG - 0.16 * OUT]
    ax.add_patch(Polygon(np.array(corners), fc="#CFE3E2", ec="#3C6B68"))


def _segment(a: object, b: object) -> np.ndarray:
    return np.array([a, b], dtype=float).T


def _line(ax: Axes, a: np.ndarray, b: np.ndarray, colour: str) -> None:
    ax.plot(*_segment(a, b), color=colour, lw=1.2, zorder=1)


def _arrow(ax: Axes, a: object, b: object, colour: str) -> None:
    look = {"arrowstyle": "-|>", "mutation_scale": 17, "lw": 2.4, "shrinkA": 0, "shrinkB": 0}
    ax.add_patch(FancyArrowPatch(a, b, color=colour, zorder=4, **look))


def _say(ax: Axes, at: object, text: str, colour: str, side: str) -> None:
    ax.text(*np.asarray(at, float), text, color=colour, ha=side, va="center", fontsize=10.5)


if __name__ == "__main__":
    with style():
        draw_spaces()
        draw_projections()
        draw_chain()
