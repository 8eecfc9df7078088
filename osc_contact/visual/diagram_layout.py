"""Where the blocks of a diagram stand and how its wires run: heights, crossings, tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from osc_contact.visual.diagram_graph import Node, Port, back

__all__ = ["Net", "align", "nets", "order", "untangle"]

ROW_GAP, WIRE_GAP = 0.24, 0.12  # between two boxes, between two wires (in)


def order(columns: list[list[Node]]) -> None:
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
                node.ins.sort(key=lambda p: -max(q.y - 99 * back(q, p) for q in p.sources))
                node.outs.sort(key=lambda p: -_mean([q.y - 99 * back(p, q) for q in p.targets]))
                node.place(node.ins)
                node.place(node.outs)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0


def align(columns: list[list[Node]]) -> None:
    """Heights: each node towards the straight wire, kept apart in the order of its column."""
    for column in columns:
        y = 0.0
        for node in column:
            node.y = y - 0.5 * node.height
            y -= node.height + node.skirt + ROW_GAP
        for node in column:
            node.y -= 0.5 * y
    for sweep in range(60):
        for column in columns if sweep % 2 == 0 else columns[::-1]:
            wish = []
            for node in column:
                pulls = [q.y - p.dy for p in node.ins for q in p.sources if not back(q, p)]
                pulls += [q.y - p.dy for p in node.outs for q in p.targets if not back(p, q)]
                wish.append(float(np.median(pulls)) if pulls else node.y)
            gaps = [_distance(a, b) for a, b in pairwise(column)]
            for node, y in zip(column, _apart(wish, gaps), strict=True):
                node.y = y
    for _ in range(6):
        for column in columns:
            for i, node in enumerate(column):
                _straighten(node, column[i - 1] if i else None, column[i + 1 :])


def _straighten(node: Node, above: Node | None, below: Sequence[Node]) -> None:
    """Move the node, as far as its neighbours leave room, to where most wires run straight."""
    wires = [q.y - p.dy for p in node.ins for q in p.sources if not back(q, p)]
    wires += [q.y - p.dy for p in node.outs for q in p.targets if not back(p, q)]
    top = above.y - _distance(above, node) if above else np.inf
    low = below[0].y + _distance(node, below[0]) if below else -np.inf
    room = [y for y in [node.y, *wires] if low - 1e-9 <= y <= top + 1e-9] or [node.y]
    node.y = max(room, key=lambda y: (sum(abs(y - w) < 1e-6 for w in wires), -abs(y - node.y)))


def _distance(above: Node, below: Node) -> float:
    """Least distance of the middles of two neighbours in a column (in)."""
    between_wires = "block" not in (above.kind, below.kind)
    gap = WIRE_GAP if between_wires else ROW_GAP
    return 0.5 * (above.height + below.height) + above.skirt + gap


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
class Net:
    """One signal inside one gap: from a height (or a lane below) to heights on the right."""

    port: Port
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


def nets(columns: list[list[Node]], returns: list[Port], lanes: list[float]) -> list[list[Net]]:
    """The nets of every gap; gap i lies left of column i, the last one right of all columns."""
    gaps: list[list[Net]] = [[] for _ in range(len(columns) + 1)]
    for i, column in enumerate(columns):
        for port in (p for node in column for p in node.outs):
            ends = [q.y for q in port.targets if not back(port, q)]
            if ends:
                gaps[i + 1].append(Net(port, port.y, ends))
    for port, lane in zip(returns, lanes, strict=True):
        gaps[port.node.layer + 1].append(Net(port, port.y, lane=lane))
        for i in range(len(columns)):
            ends = [q.y for q in port.targets if q.node.layer == i and back(port, q)]
            if ends:
                gaps[i].append(Net(port, None, ends, lane=lane))
    return gaps


def _cost(nets: Sequence[Net]) -> float:
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


def untangle(nets: list[Net]) -> list[Net]:
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
