"""Signal-flow diagrams drawn from the wiring itself (figs. 4 and 5): blocks in, figure out.

Blocks stand in columns (longest path from the inputs), wires run at right angles. Inside a gap
between two columns every signal has a vertical track of its own; names stand at the ends of the
wires, outside the tracks, so that no name is crossed or covered. What the last block feeds back
returns in lanes below the blocks.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.visual import OKABE_ITO
from osc_contact.visual.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Block", "draw_blocks"]

GROUPS: dict[str, str] = {
    "force": OKABE_ITO["vermillion"],
    "motion": OKABE_ITO["blue"],
    "filter": OKABE_ITO["purple"],
    "model": OKABE_ITO["green"],
    "plant": "#555B63",
}
_GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|eta|theta|vartheta|lambda|Lambda|mu|nu|xi|rho|sigma|tau|phi|"
    "Phi|psi|omega|Omega"
)
PORT, ROW_GAP, TRACK, LANE, PAD = 0.30, 0.24, 0.11, 0.26, 0.08
WIRE = "#2B2F36"
NAME_SIZE, EQUATION_SIZE, SIGNAL_SIZE = 9.5, 9.0, 8.5


class Block(Protocol):
    """What a block must tell; ``group`` is force, motion, filter, model or plant."""

    @property
    def name(self) -> str: ...
    @property
    def inputs(self) -> tuple[str, ...]: ...
    @property
    def outputs(self) -> tuple[str, ...]: ...
    @property
    def equation(self) -> str: ...
    @property
    def group(self) -> str: ...


@dataclass(eq=False)
class _Node:
    """A block, the open end of a signal, or (dummy) a wire's way through a column."""

    kind: str
    layer: int
    block: Block | None = None
    width: float = 0.0
    height: float = 0.12
    x: float = 0.0
    y: float = 0.0
    ins: list[_Port] = field(default_factory=list)
    outs: list[_Port] = field(default_factory=list)

    def place(self, ports: list[_Port]) -> None:
        """Spread the ports of one side evenly about the node's middle, first on top."""
        for i, port in enumerate(ports):
            port.dy = PORT * (0.5 * (len(ports) - 1) - i)


@dataclass(eq=False)
class _Port:
    node: _Node
    signal: str
    label: str
    dy: float = 0.0
    targets: list[_Port] = field(default_factory=list)
    sources: list[_Port] = field(default_factory=list)

    @property
    def y(self) -> float:
        return self.node.y + self.dy


def draw_blocks(blocks: Sequence[Block], title: str) -> Figure:
    """Draw the wiring of the blocks; the last block closes the loop.

    A signal runs from the block that puts it out to every block that takes it in. A signal that
    nobody puts out comes from the left as an open end, one that nobody takes leaves to the
    right. What the last block puts out and earlier blocks take (or, when a sensor without
    inputs puts out the same signal, that sensor) returns below. Names may hold mathtext;
    plain names such as ``alpha_d`` are set as formulas.

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
        columns, returns = _graph(blocks, _layers(blocks), ax)
        _order(columns)
        _align(columns)
        _draw(ax, columns, returns)
        _frame(figure, ax, columns, returns, title, [block.group for block in blocks])
    return figure


def _producers(blocks: Sequence[Block]) -> dict[str, Block]:
    """Who puts out each signal; the last block only where nobody else does."""
    found: dict[str, Block] = {}
    for block in blocks[:-1]:
        for signal in block.outputs:
            if signal in found:
                raise InvalidInputError(
                    f"{found[signal].name!r} and {block.name!r} both put out {signal!r}: rename one"
                )
            found[signal] = block
    return {signal: blocks[-1] for signal in blocks[-1].outputs} | found


def _layers(blocks: Sequence[Block]) -> dict[int, int]:
    """Column of each block: longest path, blocks without inputs pulled next to their use."""
    producers = _producers(blocks)
    before = {
        i: [j for j, other in enumerate(blocks[:-1])
            if any(producers.get(s) is other for s in block.inputs)]
        for i, block in enumerate(blocks)
    }  # fmt: skip
    layer: dict[int, int] = {}
    while len(layer) < len(blocks):
        ready = [i for i in before if i not in layer and all(j in layer for j in before[i])]
        if not ready:
            names = [blocks[i].name for i in before if i not in layer]
            raise InvalidInputError(f"the blocks {names} wait for one another: cut the loop")
        for i in ready:
            layer[i] = max((layer[j] + 1 for j in before[i]), default=0)
    for i, needs in before.items():
        users = [layer[k] for k in before if i in before[k]]
        if not needs and users:
            layer[i] = min(users) - 1
    layer[len(blocks) - 1] = max(layer.values()) if len(blocks) == 1 else max(
        [layer[len(blocks) - 1]] + [n + 1 for i, n in layer.items() if i != len(blocks) - 1]
    )  # fmt: skip
    return layer


def _graph(
    blocks: Sequence[Block], layer: dict[int, int], ax: Axes
) -> tuple[list[list[_Node]], list[_Port]]:
    """Nodes by column with connected ports, and the out-ports that return below."""
    producers, last = _producers(blocks), blocks[-1]
    offset = 1 if any(layer[i] == 0 and any(s not in producers for s in b.inputs)
                      for i, b in enumerate(blocks)) else 0  # fmt: skip
    nodes = {id(b): _block_node(b, layer[i] + offset, ax) for i, b in enumerate(blocks)}
    columns: list[list[_Node]] = [[] for _ in range(max(n.layer for n in nodes.values()) + 1)]
    for node in nodes.values():
        columns[node.layer].append(node)
    used = {s for b in blocks for s in b.inputs} | {
        s for s in last.outputs if producers[s] is not last
    }
    for b in blocks:
        for s in b.outputs:
            nodes[id(b)].outs.append(_Port(nodes[id(b)], s, _pretty(s)))
    returns: list[_Port] = []
    wanted: dict[str, list[_Node]] = {}
    for b in blocks:
        for s in b.inputs:
            wanted.setdefault(s, []).append(nodes[id(b)])
    for s, sinks in wanted.items():
        home = producers.get(s)
        if home is last:
            returns.append(next(p for p in nodes[id(last)].outs if p.signal == s))
            for sink in sinks:
                _connect(returns[-1], sink)
            continue
        if home is None:
            start = _Node("open", min(n.layer for n in sinks) - 1, height=0.2)
            start.width = _size(ax, _pretty(s), SIGNAL_SIZE)[0] + PAD
            columns[start.layer].append(start)
            source = _Port(start, s, "")
            start.outs.append(source)
        else:
            source = next(p for p in nodes[id(home)].outs if p.signal == s)
        _route(columns, source, sinks)
    for port in nodes[id(last)].outs:
        home = producers[port.signal]
        if home is not last:
            returns.append(port)
            _connect(port, nodes[id(home)])
    for column in list(columns):
        for node in list(column):
            for port in node.outs if node.kind == "block" else []:
                if port.signal not in used:
                    end = _Node("end", node.layer + 1)
                    if end.layer == len(columns):
                        columns.append([])
                    columns[end.layer].append(end)
                    _connect(port, end)
    return columns, returns


def _route(columns: list[list[_Node]], source: _Port, sinks: Sequence[_Node]) -> None:
    """Lead one signal from column to column, through dummies where it only passes."""
    port = source
    for column in range(source.node.layer + 1, max(n.layer for n in sinks) + 1):
        for sink in sinks:
            if sink.layer == column:
                _connect(port, sink)
        if any(sink.layer > column for sink in sinks):
            dummy = _Node("dummy", column)
            columns[column].append(dummy)
            _connect(port, dummy)
            port = _Port(dummy, source.signal, "")
            dummy.outs.append(port)


def _connect(source: _Port, sink: _Node) -> None:
    label = _pretty(source.signal) if sink.kind == "block" else ""
    port = _Port(sink, source.signal, label, sources=[source])
    sink.ins.append(port)
    source.targets.append(port)


def _block_node(block: Block, layer: int, ax: Axes) -> _Node:
    name = _size(ax, _folded(block.name), NAME_SIZE, weight="bold")
    equation = _size(ax, block.equation, EQUATION_SIZE) if block.equation else (0.0, 0.0)
    ports = max(len(block.inputs), len(block.outputs), 1)
    height = max(name[1] + equation[1] + 3.0 * PAD, PORT * ports + PAD)
    return _Node("block", layer, block, max(name[0], equation[0], 0.8) + 2 * PAD, height)


def _order(columns: list[list[_Node]]) -> None:
    """Order columns and ports by the mean height of what they are wired to (12 sweeps)."""
    for column in columns:
        for i, node in enumerate(column):
            node.y = -float(i)
    for sweep in range(12):
        forward = sweep % 2 == 0
        for column in columns if forward else columns[::-1]:
            keys = {}
            for node in column:
                ports = node.ins if forward else node.outs
                ys = [q.y for p in ports for q in (p.sources if forward else p.targets)
                      if (q.node.layer < node.layer) == forward]  # fmt: skip
                keys[id(node)] = float(np.mean(ys)) if ys else node.y
            column.sort(key=lambda n: -keys[id(n)])
            for i, node in enumerate(column):
                node.y = 0.5 * (len(column) - 1) - i
                node.ins.sort(key=lambda p: -max(q.y - 99 * _back(q, p) for q in p.sources))
                node.outs.sort(key=lambda p: -_mean([q.y - 99 * _back(p, q) for q in p.targets]))
                node.place(node.ins)
                node.place(node.outs)


def _back(source: _Port, sink: _Port) -> bool:
    return source.node.layer >= sink.node.layer


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0


def _align(columns: list[list[_Node]]) -> None:
    """Heights: each node towards the straight wire, kept apart in the order of its column."""
    for column in columns:
        y = 0.0
        for node in column:
            node.y = y - 0.5 * node.height
            y -= node.height + ROW_GAP
        for node in column:
            node.y -= 0.5 * y
    for sweep in range(60):
        for column in columns if sweep % 2 == 0 else columns[::-1]:
            wish = []
            for node in column:
                pulls = [q.y - p.dy for p in node.ins for q in p.sources if not _back(q, p)]
                pulls += [q.y - p.dy for p in node.outs for q in p.targets if not _back(p, q)]
                wish.append(float(np.median(pulls)) if pulls else node.y)
            gaps = [0.5 * (a.height + b.height) + ROW_GAP for a, b in pairwise(column)]
            for node, y in zip(column, _apart(wish, gaps), strict=True):
                node.y = y
    for _ in range(6):
        for column in columns:
            for i, node in enumerate(column):
                _straighten(node, column[i - 1] if i else None, column[i + 1 :])


def _straighten(node: _Node, above: _Node | None, below: Sequence[_Node]) -> None:
    """Move the node, as far as its neighbours leave room, to where most wires run straight."""
    wires = [q.y - p.dy for p in node.ins for q in p.sources if not _back(q, p)]
    wires += [q.y - p.dy for p in node.outs for q in p.targets if not _back(p, q)]
    top = above.y - 0.5 * (above.height + node.height) - ROW_GAP if above else np.inf
    low = below[0].y + 0.5 * (below[0].height + node.height) + ROW_GAP if below else -np.inf
    room = [y for y in [node.y, *wires] if low - 1e-9 <= y <= top + 1e-9] or [node.y]
    node.y = max(room, key=lambda y: (sum(abs(y - w) < 1e-6 for w in wires), -abs(y - node.y)))


def _apart(wish: list[float], gaps: list[float]) -> list[float]:
    """Nearest heights (least squares) that fall by at least the gaps: pool adjacent violators."""
    drop = np.concatenate([[0.0], np.cumsum(gaps)])
    pools: list[list[float]] = []
    for value in np.asarray(wish) + drop:
        pools.append([float(value), 1.0])
        while len(pools) > 1 and pools[-1][0] > pools[-2][0]:
            (a, n), (b, m) = pools[-2], pools.pop()
            pools[-1] = [(a * n + b * m) / (n + m), n + m]
    flat = np.concatenate([np.full(int(n), value) for value, n in pools])
    return [float(y) for y in flat - drop]


@dataclass(eq=False)
class _Net:
    """One signal inside one gap: from a height (or a lane below) to heights on the right."""

    port: _Port
    start: float | None
    ends: list[float] = field(default_factory=list)
    lane: float | None = None
    track: float = 0.0

    @property
    def span(self) -> tuple[float, float]:
        stops = [y for y in (self.start, self.lane, *self.ends) if y is not None]
        return min(stops), max(stops)

    @property
    def straight(self) -> bool:
        low, high = self.span
        return high - low < 1e-6


def _nets(columns: list[list[_Node]], returns: list[_Port], lanes: list[float]) -> list[list[_Net]]:
    """The nets of every gap; gap i lies left of column i, the last one right of all columns."""
    gaps: list[list[_Net]] = [[] for _ in range(len(columns) + 1)]
    for i, column in enumerate(columns):
        for port in (p for node in column for p in node.outs):
            ends = [q.y for q in port.targets if not _back(port, q)]
            if ends:
                gaps[i + 1].append(_Net(port, port.y, ends))
    for port, lane in zip(returns, lanes, strict=True):
        gaps[port.node.layer + 1].append(_Net(port, port.y, lane=lane))
        for i in range(len(columns)):
            ends = [q.y for q in port.targets if q.node.layer == i and _back(port, q)]
            if ends:
                gaps[i].append(_Net(port, None, ends, lane=lane))
    return gaps


def _cost(nets: Sequence[_Net]) -> float:
    """Crossings of the nets in this order of tracks; runs on top of one another count 9."""
    cost = 0.0
    for i, net in enumerate(nets):
        for j, other in enumerate(nets):
            if i == j:
                continue
            low, high = other.span
            passing = net.ends if j > i else ([net.start] if net.start is not None else [])
            for y in passing:
                if low - 0.05 < y < high + 0.05:
                    cost += 1.0 if low + 0.05 < y < high - 0.05 else 9.0
    return cost


def _untangle(nets: list[_Net]) -> list[_Net]:
    """Order of the tracks with few crossings: move one net at a time while it helps."""
    best, cost = nets, _cost(nets)
    improved = True
    while improved:
        improved = False
        for i in range(len(best)):
            for j in range(len(best)):
                trial = best[:i] + best[i + 1 :]
                trial.insert(j, best[i])
                if _cost(trial) < cost:
                    best, cost, improved = trial, _cost(trial), True
    return best


def _draw(ax: Axes, columns: list[list[_Node]], returns: list[_Port]) -> None:
    floor = min(n.y - 0.5 * n.height for column in columns for n in column) - 0.15
    returns.sort(key=lambda p: p.y)
    lanes = [floor - LANE * (k + 0.5) for k in range(len(returns))]
    gaps = _nets(columns, returns, lanes)
    x = 0.0
    for i, gap in enumerate(gaps):
        left = columns[i - 1] if i else []
        right = columns[i] if i < len(columns) else []
        bent = _untangle([net for net in gap if not net.straight])
        out_zone = max([_label_width(ax, p.label) for n in left for p in n.outs], default=0.0)
        in_zone = max([_label_width(ax, _sink_label(p)) for n in right for p in n.ins], default=0.0)
        begin = x
        for k, net in enumerate(bent):
            net.track = begin + out_zone + TRACK * (k + 1)
        x = begin + out_zone + TRACK * (len(bent) + 1) + in_zone + (0.18 if in_zone else 0.22)
        x = x if i and right else (x if bent else begin)
        for net in gap:
            _draw_net(ax, net, begin, x)
        for node in left:
            for port in node.outs:
                ax.text(begin + 0.06, port.y + 0.02, port.label, size=SIGNAL_SIZE, va="bottom")
        width = max([n.width for n in right], default=0.0)
        for node in right:
            node.x, node.width = x, width
            _draw_node(ax, node)
        x += width
    tracks = [[n.track for g in gaps for n in g if n.port is p and n.lane is not None]
              for p in returns]  # fmt: skip
    middle = 0.5 * (max((t for ts in tracks for t in ts[:-1]), default=0.0)
                    + min((ts[-1] for ts in tracks), default=0.0))  # fmt: skip
    for port, lane, ends in zip(returns, lanes, tracks, strict=True):
        ax.plot([min(ends), max(ends)], [lane] * 2, color=WIRE, lw=1.1, zorder=2)
        ax.text(middle, lane + 0.02, port.label, size=SIGNAL_SIZE, ha="center", va="bottom")


def _draw_net(ax: Axes, net: _Net, left: float, right: float) -> None:
    line: Any = {"color": WIRE, "lw": 1.1, "solid_capstyle": "round", "zorder": 2}
    if net.straight:
        ax.plot([left, right], [net.ends[0]] * 2, **line)
        return
    if net.start is not None:
        ax.plot([left, net.track], [net.start] * 2, **line)
    ax.plot([net.track] * 2, net.span, **line)
    for y in net.ends:
        ax.plot([net.track, right], [y] * 2, **line)
    low, high = net.span
    stops = [y for y in (net.start, *net.ends) if y is not None]
    for y in set(stops):
        if low + 1e-6 < y < high - 1e-6 or stops.count(y) > 1:
            ax.plot([net.track], [y], "o", ms=3.5, color=WIRE, zorder=4)


def _draw_node(ax: Axes, node: _Node) -> None:
    from matplotlib.colors import to_rgb
    from matplotlib.patches import FancyBboxPatch

    if node.kind == "open":
        label = _pretty(node.outs[0].signal)
        right = node.x + node.width
        ax.text(right - 0.04, node.y, label, size=SIGNAL_SIZE, ha="right", va="center")
    elif node.kind == "dummy":
        ax.plot([node.x, node.x + node.width], [node.y] * 2, color=WIRE, lw=1.1, zorder=2)
    for port in node.ins if node.kind != "dummy" else []:
        ax.annotate(
            "", (node.x, port.y), (node.x - 0.16, port.y), zorder=3,
            arrowprops={"arrowstyle": "-|>", "color": WIRE, "lw": 1.1,
                        "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9},
        )  # fmt: skip
        ax.text(
            node.x - 0.14, port.y + 0.02, _sink_label(port), size=SIGNAL_SIZE,
            ha="right", va="bottom",
        )  # fmt: skip
    if node.block is None:
        return
    edge = GROUPS[node.block.group]
    ax.add_patch(
        FancyBboxPatch(
            (node.x, node.y - 0.5 * node.height), node.width, node.height,
            boxstyle="round,pad=0,rounding_size=0.07", ec=edge, lw=1.4, zorder=3,
            fc=tuple(1.0 - 0.14 * (1.0 - channel) for channel in to_rgb(edge)),
        )
    )  # fmt: skip
    middle, equation = node.x + 0.5 * node.width, node.block.equation
    name = _size(ax, _folded(node.block.name), NAME_SIZE, weight="bold")[1]
    under = _size(ax, equation, EQUATION_SIZE)[1] if equation else 0.0
    top = node.y + 0.5 * (name + under + (PAD if equation else 0.0))
    ax.text(middle, top - 0.5 * name, _folded(node.block.name), size=NAME_SIZE, weight="bold",
            ha="center", va="center", zorder=5)  # fmt: skip
    ax.text(middle, top - name - PAD - 0.5 * under, equation, size=EQUATION_SIZE,
            ha="center", va="center", zorder=5)  # fmt: skip


def _sink_label(port: _Port) -> str:
    """A wire is named again where it ends, unless it comes straight from the block before."""
    source = port.sources[0]
    direct = source.node.kind in ("block", "open") and len(source.targets) == 1
    return "" if direct and not _back(source, port) else port.label


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
    figure: Figure, ax: Axes, columns: list[list[_Node]], returns: list[_Port], title: str,
    groups: Sequence[str],
) -> None:  # fmt: skip
    """Fit figure and axes to the content; title above, the colours' meaning below."""
    from matplotlib.patches import Patch

    nodes = [node for column in columns for node in column]
    ys = [y for line in ax.lines for y in np.ravel(line.get_ydata())]
    xs = [x for line in ax.lines for x in np.ravel(line.get_xdata())]
    low = min([n.y - 0.5 * n.height for n in nodes] + ys) - 0.6
    high = max([n.y + 0.5 * n.height for n in nodes] + ys) + 0.65
    left = min([n.x for n in nodes] + xs) - 0.25
    right = max([n.x + n.width for n in nodes] + xs) + 0.25
    figure.set_size_inches(right - left, high - low)
    ax.set(xlim=(left, right), ylim=(low, high))
    ax.text(left + 0.25, high - 0.2, title, size=13, weight="bold", va="top")
    shown = [group for group in GROUPS if group in groups]
    handles = [Patch(fc=GROUPS[group], alpha=0.6, label=group) for group in shown]
    ax.legend(handles=handles, loc="lower right", ncols=len(shown), borderaxespad=0.8)


def _folded(name: str) -> str:
    return "\n".join(textwrap.wrap(name, 13, break_long_words=False)) or name


def _label_width(ax: Axes, label: str) -> float:
    return _size(ax, label, SIGNAL_SIZE)[0] + 0.08 if label else 0.0


def _size(ax: Axes, text: str, size: float, weight: str = "normal") -> tuple[float, float]:
    """Width and height of a text in inches."""
    figure: Any = ax.get_figure(root=True)
    probe = ax.text(0.0, 0.0, text, size=size, weight=weight)
    box = probe.get_window_extent(figure.canvas.get_renderer())
    probe.remove()
    return box.width / figure.dpi, box.height / figure.dpi


def _pretty(signal: str) -> str:
    """``alpha_meas`` as a formula; what holds a $ stays as it is; words stay upright."""
    if "$" in signal:
        return signal
    head, _, index = signal.partition("_")
    index = index.replace("_", r"\,")
    greek = _GREEK.fullmatch(head)
    if not greek and len(head) > 1:
        return rf"$\mathrm{{{head}}}_{{\mathrm{{{index}}}}}$" if index else signal
    symbol = rf"\{head}" if greek else head
    if not index:
        return f"${symbol}$"
    return rf"${symbol}_{{\mathrm{{{index}}}}}$"
