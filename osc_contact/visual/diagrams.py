"""Signal-flow diagrams drawn from the wiring itself (figs. 4 and 5): blocks in, figure out.

Blocks stand in columns (longest path from the inputs), wires run at right angles. Inside a gap
between two columns every signal has a vertical track of its own; names stand at the ends of the
wires, outside the tracks, so that no name is crossed or covered. What the last block feeds back
returns in lanes below the blocks. A bus, read nearly everywhere, is named below each reader.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.visual import OKABE_ITO
from osc_contact.visual.diagram_graph import PORT, Block, Node, Port, back, graph
from osc_contact.visual.diagram_layout import Net, align, nets, order, untangle
from osc_contact.visual.diagram_text import (
    EQUATION_SIZE,
    NAME_SIZE,
    SIGNAL_SIZE,
    Words,
    folded_equation,
    folded_name,
)
from osc_contact.visual.style import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Block", "draw_blocks"]

GROUPS: dict[str, tuple[str, str]] = {
    "force": (OKABE_ITO["vermillion"], "force control"),
    "motion": (OKABE_ITO["blue"], "motion control"),
    "filter": (OKABE_ITO["purple"], "projection and dynamics"),
    "model": (OKABE_ITO["green"], "model"),
    "plant": ("#555B63", "plant"),
}
TRACK, LANE, PAD, STUB = 0.11, 0.26, 0.08, 0.2
WIRE = "#2B2F36"


def draw_blocks(
    blocks: Sequence[Block],
    title: str,
    buses: Sequence[str] = (),
    labels: Mapping[str, str] | None = None,
) -> Figure:
    """Draw the wiring of the blocks; the last block closes the loop.

    A signal runs from the block that puts it out to every block that takes it in. A signal that
    nobody puts out comes from the left as an open end, one that nobody takes leaves to the
    right. What the last block puts out and earlier blocks take (or, when a sensor without
    inputs puts out the same signal, that sensor) returns below. Names may hold mathtext;
    plain names such as ``alpha_d`` are set as formulas.

    Args:
        blocks: in the order of the signal flow.
        title: heading.
        buses: signals that are named with an arrow below each reader instead of being wired.
        labels: how signals are written, where the formula made from the name will not do.

    Raises:
        InvalidInputError: no blocks, an unknown group, two blocks that put out one signal,
            or a loop that does not pass through the last block.
    """
    if not blocks:
        raise InvalidInputError("a diagram needs at least one block")
    for block in blocks:
        if block.group not in GROUPS:
            raise InvalidInputError(
                f"block {block.name!r} has the group {block.group!r}: use one of {list(GROUPS)}"
            )
    with style():
        figure, ax = _canvas()
        pen = _Pen(ax, Words(ax, labels or {}))
        columns, returns = graph(blocks, buses, pen.block_node, pen.open_node)
        order(columns)
        align(columns)
        pen.draw(columns, returns)
        _frame(figure, ax, columns, title, [block.group for block in blocks])
    return figure


class _Pen:
    """Sizes and draws nodes and wires on one axes measured in inches."""

    def __init__(self, ax: Axes, words: Words) -> None:
        self.ax = ax
        self.words = words

    def block_node(self, block: Block, layer: int, buses: tuple[str, ...]) -> Node:
        name = self.words.size(folded_name(block.name), NAME_SIZE, weight="bold")
        equation = self.words.size(folded_equation(block.equation), EQUATION_SIZE)
        ports = max(len(block.inputs) - len(buses), len(block.outputs), 1)
        height = max(name[1] + equation[1] + 3.0 * PAD, PORT * ports + PAD)
        stubs = sum(self.words.label_width(self.words.label(s)) for s in buses)
        width = max(name[0], equation[0], stubs, 0.8) + 2 * PAD
        skirt = STUB + 0.16 if buses else 0.0
        return Node("block", layer, block, width, height, skirt=skirt, buses=buses)

    def open_node(self, signal: str, layer: int) -> Node:
        width = self.words.label_width(self.words.label(signal)) + PAD - 0.08
        return Node("open", layer, height=0.2, width=width)

    def draw(self, columns: list[list[Node]], returns: list[Port]) -> None:
        """Place columns and tracks from left to right and draw everything."""
        floor = min(n.y - 0.5 * n.height - n.skirt for column in columns for n in column) - 0.15
        returns.sort(key=lambda p: p.y)
        lanes = [floor - LANE * (k + 0.5) for k in range(len(returns))]
        gaps = nets(columns, returns, lanes)
        x = 0.0
        for i, gap in enumerate(gaps):
            left = columns[i - 1] if i else []
            right = columns[i] if i < len(columns) else []
            bent = untangle([net for net in gap if not net.straight])
            out_zone = self._zone(self._source_label(p) for n in left for p in n.outs)
            in_zone = self._zone(self._sink_label(p) for n in right for p in n.ins)
            begin = x
            for k, net in enumerate(bent):
                net.track = begin + out_zone + TRACK * (k + 1)
            room = out_zone + TRACK * (len(bent) + 1) + in_zone + (0.18 if in_zone else 0.22)
            x = begin + room if bent or (i and right) else begin
            for net in gap:
                self._net(net, begin, x)
            for port in (p for n in left for p in n.outs):
                self._name(begin + 0.06, port.y, self._source_label(port), "left")
            width = max([n.width for n in right], default=0.0)
            for node in right:
                node.x, node.width = x, width
                self._node(node)
            x += width
        self._lanes(returns, lanes, gaps)

    def _lanes(self, returns: list[Port], lanes: list[float], gaps: list[list[Net]]) -> None:
        tracks = [
            [n.track for gap in gaps for n in gap if n.port is port and n.lane is not None]
            for port in returns
        ]
        starts = max((t for ts in tracks for t in ts[:-1]), default=0.0)
        middle = 0.5 * (starts + min((ts[-1] for ts in tracks), default=0.0))
        for port, lane, ends in zip(returns, lanes, tracks, strict=True):
            self._wire([min(ends), max(ends)], [lane, lane])
            self._name(middle, lane, self._source_label(port), "center")

    def _net(self, net: Net, left: float, right: float) -> None:
        if net.straight:
            self._wire([left, right], [net.ends[0]] * 2)
            return
        if net.start is not None:
            self._wire([left, net.track], [net.start] * 2)
        self._wire([net.track] * 2, net.span)
        for y in net.ends:
            self._wire([net.track, right], [y] * 2)
        low, high = net.span
        stops = [y for y in (net.start, *net.ends) if y is not None]
        for y in set(stops):
            if low + 1e-6 < y < high - 1e-6 or stops.count(y) > 1:
                self.ax.plot([net.track], [y], "o", ms=3.5, color=WIRE, zorder=4)

    def _node(self, node: Node) -> None:
        if node.kind == "open":
            label = self.words.label(node.outs[0].signal)
            at = node.x + node.width - 0.04
            self.ax.text(at, node.y, label, size=SIGNAL_SIZE, ha="right", va="center")
        elif node.kind == "dummy":
            self._wire([node.x, node.x + node.width], [node.y] * 2)
        for port in node.ins if node.kind != "dummy" else []:
            self._arrow((node.x - 0.16, port.y), (node.x, port.y))
            self._name(node.x - 0.14, port.y, self._sink_label(port), "right")
        if node.block is not None:
            self._box(node, node.block)

    def _box(self, node: Node, block: Block) -> None:
        from matplotlib.colors import to_rgb
        from matplotlib.patches import FancyBboxPatch

        edge, _ = GROUPS[block.group]
        low, middle = node.y - 0.5 * node.height, node.x + 0.5 * node.width
        self.ax.add_patch(
            FancyBboxPatch(
                (node.x, low), node.width, node.height,
                boxstyle="round,pad=0,rounding_size=0.07", ec=edge, lw=1.4, zorder=3,
                fc=tuple(1.0 - 0.14 * (1.0 - channel) for channel in to_rgb(edge)),
            )
        )  # fmt: skip
        name, equation = folded_name(block.name), folded_equation(block.equation)
        tall = self.words.size(name, NAME_SIZE, weight="bold")[1]
        under = self.words.size(equation, EQUATION_SIZE)[1]
        top = node.y + 0.5 * (tall + under + (PAD if equation else 0.0))
        centred: Any = {"ha": "center", "va": "center", "zorder": 5}
        self.ax.text(middle, top - 0.5 * tall, name, size=NAME_SIZE, weight="bold", **centred)
        self.ax.text(middle, top - tall - PAD - 0.5 * under, equation, size=EQUATION_SIZE,
                     **centred)  # fmt: skip
        for k, signal in enumerate(node.buses):
            x = node.x + node.width * (k + 0.5) / len(node.buses)
            self._arrow((x, low - STUB), (x, low))
            self.ax.text(x, low - STUB - 0.01, self.words.label(signal), size=SIGNAL_SIZE,
                         ha="center", va="top")  # fmt: skip

    def _source_label(self, port: Port) -> str:
        return self.words.label(port.signal) if port.node.kind == "block" else ""

    def _sink_label(self, port: Port) -> str:
        """A wire is named again where it ends, unless it comes straight from the block before."""
        source = port.sources[0]
        direct = source.node.kind in ("block", "open") and len(source.targets) == 1
        if port.node.kind != "block" or (direct and not back(source, port)):
            return ""
        return self.words.label(port.signal)

    def _zone(self, labels: Any) -> float:
        return max([self.words.label_width(label) for label in labels], default=0.0)

    def _name(self, x: float, y: float, label: str, side: str) -> None:
        self.ax.text(x, y + 0.02, label, size=SIGNAL_SIZE, ha=side, va="bottom")

    def _wire(self, x: Sequence[float], y: Sequence[float]) -> None:
        self.ax.plot(x, y, color=WIRE, lw=1.1, solid_capstyle="round", zorder=2)

    def _arrow(self, tail: tuple[float, float], tip: tuple[float, float]) -> None:
        look: Any = {"arrowstyle": "-|>", "color": WIRE, "lw": 1.1, "mutation_scale": 9}
        self.ax.annotate("", tip, tail, zorder=3, arrowprops={**look, "shrinkA": 0, "shrinkB": 0})


def _canvas() -> tuple[Figure, Axes]:
    """Figure whose axes are measured in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16.0, 9.0), dpi=100)
    figure.set_layout_engine("none")
    FigureCanvasAgg(figure)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set(xlim=(0.0, 16.0), ylim=(0.0, 9.0))
    ax.axis("off")
    return figure, ax


def _frame(
    figure: Figure, ax: Axes, columns: list[list[Node]], title: str, groups: Sequence[str]
) -> None:
    """Fit figure and axes to the content; title above, the colours' meaning below."""
    from matplotlib.patches import Patch

    nodes = [node for column in columns for node in column]
    ys = [y for line in ax.lines for y in np.ravel(line.get_ydata())]
    xs = [x for line in ax.lines for x in np.ravel(line.get_xdata())]
    low = min([n.y - 0.5 * n.height - n.skirt for n in nodes] + ys) - 0.6
    high = max([n.y + 0.5 * n.height for n in nodes] + ys) + 0.65
    left = min([n.x for n in nodes] + xs) - 0.25
    right = max([n.x + n.width for n in nodes] + xs) + 0.25
    figure.set_size_inches(right - left, high - low)
    ax.set(xlim=(left, right), ylim=(low, high))
    ax.text(left + 0.25, high - 0.2, title, size=13, weight="bold", va="top")
    shown = [meaning for group, meaning in GROUPS.items() if group in groups]
    handles = [Patch(fc=colour, alpha=0.6, label=meaning) for colour, meaning in shown]
    ax.legend(handles=handles, loc="lower right", ncols=len(shown), borderaxespad=0.8)
