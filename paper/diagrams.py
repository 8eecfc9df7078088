"""Figs. 4 and 5: the boxes of the control loop at fixed places, and the connections between them.

No signal gets lost: what a box reads and no connection brings is named below it, what it puts out
and no connection takes is named beside it.
"""

import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Patch

from osc_contact.lab.visual import OKABE_ITO
from osc_contact.lab.visual.plots import style

Point = tuple[float, float]


class Block(NamedTuple):
    """One box of fig. 4 or 5.

    Its name, the place of its middle (in), what it computes, what goes in and out.
    """

    name: str
    group: str
    place: Point
    equation: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


#: The boxes of fig. 4 in the order in which the signals meet them.
BLOCKS = (
    Block(
        "closed chain",
        "model",
        (0.0, 6.4),
        "$\\Lambda_S,\\ \\mu,\\ p,\\ S,\\ \\sigma,\\ G$\n(13)",
        ("q", "v"),
        ("state",),
    ),
    Block(
        "contact geometry",
        "model",
        (2.7, 6.1),
        r"$N,\ T,\ n_\gamma$",
        ("touched", "state"),
        ("parts", "contact", "friction_wrenches"),
    ),
    Block(
        "environment",
        "model",
        (5.4, 6.4),
        r"$\Phi_e,\ b_e,\ V_e$  (14)",
        ("touched", "parts", "state", "friction_wrenches"),
        ("environment",),
    ),
    Block(
        "sum of wrist sensors",
        "force",
        (0.0, 0.0),
        r"$\Sigma$ at $O$",
        ("wrenches", "state"),
        ("f_meas",),
    ),
    Block(
        "force filter",
        "force",
        (2.7, 0.0),
        r"$\Omega_f(\Lambda_{out})$",
        ("f_meas", "state", "contact", "environment", "friction_wrenches"),
        ("f_c_meas",),
    ),
    Block(
        "generalised inverse",
        "force",
        (5.4, 0.0),
        r"$N^{\#}$",
        ("f_c_meas", "contact"),
        ("alpha_meas",),
    ),
    Block(
        "force law",
        "force",
        (8.1, 0.0),
        r"$\alpha_d + K_i\int(\alpha_d-\alpha_{meas})$",
        ("alpha_d", "contact", "state", "environment", "alpha_meas"),
        ("alpha_u",),
    ),
    Block(
        "to operational space",
        "force",
        (10.8, 0.0),
        r"$N\alpha_u$  (16)",
        ("contact", "friction_wrenches", "alpha_u"),
        ("f_ccomm",),
    ),
    Block(
        "motion law",
        "motion",
        (2.7, 3.55),
        r"$\ddot x_d + K_d\dot e + K_p e + K_i\int e$",
        ("contact", "state", "reference"),
        ("a_u",),
    ),
    Block(
        "motion filter",
        "filter",
        (5.4, 3.4),
        r"$\Omega_m(B)$  (24)",
        ("state", "contact", "a_u", "alpha_u", "environment", "friction_wrenches", "q", "v"),
        ("eta_c",),
    ),
    Block(
        "dynamic control structure",
        "filter",
        (8.1, 3.25),
        "$\\Lambda_S\\dot\\eta_c+b_S+S^Tf_{ccomm}$\n(21)",
        ("state", "eta_c", "f_ccomm"),
        ("f_S",),
    ),
    Block(
        "torque allocation",
        "filter",
        (10.8, 3.4),
        "$G\\tau = f_S$,\nsqueeze in null$(G)$",
        ("state", "q", "v", "f_S", "eta_c", "squeeze_d"),
        ("tau",),
    ),
)

PLANT = Block(
    "arms, object, environment", "plant", (8.9, 6.4), "", ("tau",), ("q", "v", "wrenches")
)
#: The control loop of fig. 4.
LOOP = (*BLOCKS, PLANT)

WIDTH = 1.9
HEIGHT = 1.15
PORT = 0.3  #: of a box; between two connections at one edge (in)
#: Signal and reader of each connection, the upper ones of a box first, and where it turns (in):
#: nowhere, at one x, or at x, y, x of the way around.
CONNECTIONS: dict[tuple[str, str], tuple[float, ...]] = {
    ("q", "closed chain"): (11.4, 7.45, -1.3),
    ("parts", "environment"): (),
    ("a_u", "motion filter"): (),
    ("alpha_u", "motion filter"): (9.4, 1.4, 4.1),
    ("f_meas", "force filter"): (),
    ("f_c_meas", "generalised inverse"): (),
    ("alpha_meas", "force law"): (),
    ("alpha_u", "to operational space"): (),
    ("eta_c", "dynamic control structure"): (),
    ("f_ccomm", "dynamic control structure"): (12.45, 1.75, 6.8),
    ("eta_c", "torque allocation"): (6.8, 4.3, 9.45),
    ("f_S", "torque allocation"): (),
    ("tau", PLANT.name): (12.2, 5.1, 7.6),
    ("wrenches", "sum of wrist sensors"): (12.9, -1.55, -1.3),
}
LABELS = {
    "q": r"$q,\ v$",  # v goes where q goes
    "wrenches": "wrist wrenches",
    "touched": r"$X_{WE},\ V_E$",
    "reference": r"$x_d,\ \dot x_d,\ \ddot x_d$",
    "alpha_d": r"$\alpha_{\mathrm{d}}$",
    "squeeze_d": "squeeze",
    "state": "state",
    "parts": r"$N_i$",
    "contact": r"$N,\ T$",
    "friction_wrenches": r"$N_\mu - N$",
    "environment": r"$\Phi_e,\ b_e$",
    "f_meas": r"$f_{\mathrm{meas}}$",
    "f_c_meas": r"$f_{\mathrm{c\,meas}}$",
    "alpha_meas": r"$\alpha_{\mathrm{meas}}$",
    "alpha_u": r"$\alpha_{\mathrm{u}}$",
    "f_ccomm": r"$f_{\mathrm{ccomm}}$",
    "a_u": r"$a_{\mathrm{u}}$",
    "eta_c": r"$\dot\eta_c$",
    "f_S": r"$f_{\mathrm{S}}$",
    "tau": r"$\tau$",
}
GROUPS = {
    "force": (OKABE_ITO["vermillion"], "force control"),
    "motion": (OKABE_ITO["blue"], "motion control"),
    "filter": (OKABE_ITO["purple"], "projection and dynamics"),
    "model": (OKABE_ITO["green"], "model"),
    "plant": ("#555B63", "plant"),
}
INK = "#2B2F36"
LINE = 1.1
LABEL = 11.0  #: of connections and the names on them
#: Look of signals without a connection.
NAMED: Any = {"boxstyle": "round,pad=0.18", "fc": "#E9ECF0", "ec": "none"}


def draw_blocks(blocks: Sequence[Block], title: str) -> Figure:
    """Draw boxes of the loop with every signal that they read and put out.

    Args:
        blocks: some of `LOOP`.
        title: heading.
    """
    names = [block.name for block in blocks]
    connections = {key: turns for key, turns in CONNECTIONS.items() if key[1] in names}
    taken = [signal for signal, _ in connections]
    starts: dict[str, Point] = {}
    ends: dict[tuple[str, str], Point] = {}
    for block in blocks:
        connected = [signal for signal, reader in connections if reader == block.name]
        ends |= {(s, block.name): port for s, port in _ports(block, connected, -1)}
        starts |= dict(_ports(block, _shown(block.outputs), 1))
    with style():
        figure, ax = _canvas([block.place for block in blocks], title)
        for block in blocks:
            _box(ax, block)
            bare = [s for s in _shown(block.inputs) if (s, block.name) not in connections]
            if bare:
                _name_inputs(ax, block.place, bare)
        for signal, (x, y) in starts.items():
            if signal in taken:
                _write(ax, x + 0.05, y, signal, "left")
            else:
                ax.text(x + 0.09, y, LABELS[signal], size=LABEL, va="center", bbox=NAMED)
        for (signal, reader), turns in connections.items():
            x, y = end = ends[signal, reader]
            if signal in starts:
                _wire(ax, signal, starts[signal], turns, end, taken.count(signal) > 1)
            else:
                _arrow(ax, [(x - 0.4, y), end])
                _write(ax, x - 0.45, y - 0.08, signal, "right")
        groups = dict.fromkeys(block.group for block in blocks)
        shown = [GROUPS[group] for group in groups]
        handles = [Patch(fc=colour, alpha=0.6, label=meaning) for colour, meaning in shown]
        ax.legend(handles=handles, ncols=len(handles), loc="lower right", fontsize=10)
    return figure


def _shown(signals: Sequence[str]) -> list[str]:
    """v is drawn with q."""
    return [signal for signal in signals if signal != "v"]


def _ports(block: Block, signals: Sequence[str], side: int) -> Iterator[tuple[str, Point]]:
    """Each signal with its place at the left (-1) or the right (1) edge of a box."""
    x, y = block.place
    for k, signal in enumerate(signals):
        yield signal, (x + 0.5 * side * WIDTH, y + PORT * (0.5 * (len(signals) - 1) - k))


def _canvas(places: Sequence[Point], title: str) -> tuple[Figure, Axes]:
    """A page measured in inches around the boxes."""
    low = np.min(places, axis=0) - [0.5 * WIDTH + 1.5, 0.5 * HEIGHT + 1.6]
    high = np.max(places, axis=0) + [0.5 * WIDTH + 1.4, 0.5 * HEIGHT + 1.2]
    figure = Figure(figsize=high - low)
    figure.set_layout_engine("none")
    xlim, ylim = zip(low, high, strict=True)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=xlim, ylim=ylim)
    ax.set_axis_off()
    ax.text(low[0] + 0.2, high[1] - 0.2, title, size=15, weight="bold", va="top")
    return figure, ax


def _box(ax: Axes, block: Block) -> None:
    x, y = block.place
    colour = GROUPS[block.group][0]
    look: Any = {"boxstyle": "round,pad=0,rounding_size=0.07", "lw": 1.4, "zorder": 3}
    corner = (x - 0.5 * WIDTH, y - 0.5 * HEIGHT)
    ax.add_patch(FancyBboxPatch(corner, WIDTH, HEIGHT, fc=(colour, 0.14), ec=colour, **look))
    name = textwrap.fill(block.name, 16)
    middle = 0.26 if block.equation else 0.0
    centred: Any = {"ha": "center", "va": "center", "zorder": 5}
    ax.text(x, y + middle, name, size=12, weight="bold", **centred)
    ax.text(x, y - 0.27, block.equation, size=10.5, **centred)


def _name_inputs(ax: Axes, place: Point, signals: Sequence[str]) -> None:
    """On an arrow from below."""
    x, y = place
    edge = y - 0.5 * HEIGHT
    _arrow(ax, [(x, edge - 0.22), (x, edge)])
    names = [LABELS[signal] for signal in signals]
    rows = [" · ".join(names[k : k + 3]) for k in range(0, len(names), 3)]
    ax.text(x, edge - 0.3, "\n".join(rows), size=LABEL, ha="center", va="top", bbox=NAMED)


def _wire(
    ax: Axes, signal: str, start: Point, turns: tuple[float, ...], end: Point, branches: bool
) -> None:
    """Wire by right angles; a dot where it leaves another one."""
    points = [start]
    for k, at in enumerate(turns):
        points.append((at, points[-1][1]) if k % 2 == 0 else (points[-1][0], at))
    points += [(points[-1][0], end[1]), end]
    _arrow(ax, points)
    if turns and branches:
        ax.plot(*points[1], "o", ms=3.5, color=INK, zorder=4)
    if len(turns) > 1:
        _write(ax, 0.5 * (turns[0] + turns[2]), turns[1], signal, "center")


def _arrow(ax: Axes, points: Sequence[Point]) -> None:
    look: Any = {"arrowstyle": "-|>", "color": INK, "lw": LINE, "shrinkA": 0, "shrinkB": 0}
    ax.plot(*zip(*points[:-1], strict=True), color=INK, lw=LINE, solid_capstyle="round", zorder=2)
    ax.annotate("", points[-1], points[-2], zorder=3, arrowprops=look)


def _write(ax: Axes, x: float, y: float, signal: str, side: Any) -> None:
    ax.text(x, y + 0.03, LABELS[signal], size=LABEL, ha=side, va="bottom")
