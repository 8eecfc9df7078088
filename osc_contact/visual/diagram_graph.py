"""The graph behind a diagram: who puts out what, the column of each block, ports and wires."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from osc_contact.errors import InvalidInputError

__all__ = ["PORT", "Block", "Node", "Port", "back", "graph"]

PORT = 0.30  #: distance of two ports (in)


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
class Node:
    """A block, the open end of a signal, or (dummy) a wire's way through a column.

    Attributes:
        kind: block, open (a signal comes in from outside), end (one leaves) or dummy.
        layer: column. x: left edge. y: middle. width, height: of the box (in).
        skirt: room below the box (in) for the stubs of the buses it reads.
        buses: signals that come in at the lower edge instead of along a wire.
        ins, outs: ports of the left and of the right edge.
    """

    kind: str
    layer: int
    block: Block | None = None
    width: float = 0.0
    height: float = 0.12
    x: float = 0.0
    y: float = 0.0
    skirt: float = 0.0
    buses: tuple[str, ...] = ()
    ins: list[Port] = field(default_factory=list)
    outs: list[Port] = field(default_factory=list)

    def place(self, ports: list[Port]) -> None:
        """Spread the ports of one side evenly about the node's middle, first on top."""
        for i, port in enumerate(ports):
            port.dy = PORT * (0.5 * (len(ports) - 1) - i)


@dataclass(eq=False)
class Port:
    """Where a signal leaves or enters a node, and what it is wired to."""

    node: Node
    signal: str
    dy: float = 0.0
    targets: list[Port] = field(default_factory=list)
    sources: list[Port] = field(default_factory=list)

    @property
    def y(self) -> float:
        """Height of the port (in)."""
        return self.node.y + self.dy


def back(source: Port, sink: Port) -> bool:
    """Whether the wire runs against the columns, so that it must return below."""
    return source.node.layer >= sink.node.layer


def graph(
    blocks: Sequence[Block],
    buses: Sequence[str],
    block_node: Callable[[Block, int, tuple[str, ...]], Node],
    open_node: Callable[[str, int], Node],
) -> tuple[list[list[Node]], list[Port]]:
    """Nodes by column with connected ports, and the out-ports that return below.

    Args:
        blocks: the last one closes the loop.
        buses: signals that are named at each reader instead of wired.
        block_node: makes the sized node of a block, given its column and the buses it reads.
        open_node: makes the sized open end of a signal, given its column.

    Raises:
        InvalidInputError: two blocks put out one signal, or a loop past the last block.
    """
    wired = [tuple(s for s in b.inputs if s not in buses) for b in blocks]
    producers, last = _producers(blocks), blocks[-1]
    layer = _layers(blocks, wired)
    opens = any(
        layer[i] == 0 and any(s not in producers for s in inputs) for i, inputs in enumerate(wired)
    )
    nodes = [
        block_node(b, layer[i] + opens, tuple(s for s in buses if s in b.inputs))
        for i, b in enumerate(blocks)
    ]
    of_block = {id(b): node for b, node in zip(blocks, nodes, strict=True)}
    columns: list[list[Node]] = [[] for _ in range(max(n.layer for n in nodes) + 1)]
    wanted: dict[str, list[Node]] = {}
    for block, node, inputs in zip(blocks, nodes, wired, strict=True):
        columns[node.layer].append(node)
        node.outs += [Port(node, s) for s in block.outputs]
        for s in inputs:
            wanted.setdefault(s, []).append(node)
    returns: list[Port] = []
    for s, sinks in wanted.items():
        home = producers.get(s)
        if home is last:
            returns.append(_port(nodes[-1], s))
            for sink in sinks:
                _connect(returns[-1], sink)
        elif home is None:
            start = open_node(s, min(n.layer for n in sinks) - 1)
            columns[start.layer].append(start)
            start.outs.append(Port(start, s))
            _route(columns, start.outs[0], sinks)
        else:
            _route(columns, _port(of_block[id(home)], s), sinks)
    for port in nodes[-1].outs:
        if producers[port.signal] is not last:
            returns.append(port)
            _connect(port, of_block[id(producers[port.signal])])
    _add_ends(columns, [p for node in nodes for p in node.outs if not p.targets])
    return columns, returns


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


def _layers(blocks: Sequence[Block], wired: Sequence[tuple[str, ...]]) -> list[int]:
    """Column of each block: longest path, blocks without inputs pulled next to their use."""
    producers, last = _producers(blocks), len(blocks) - 1
    before = [
        [j for j, other in enumerate(blocks[:-1]) if any(producers.get(s) is other for s in inputs)]
        for inputs in wired
    ]
    layer: dict[int, int] = {}
    while len(layer) < len(blocks):
        waiting = [i for i in range(len(blocks)) if i not in layer]
        ready = [i for i in waiting if all(j in layer for j in before[i])]
        if not ready:
            names = [blocks[i].name for i in waiting]
            raise InvalidInputError(f"the blocks {names} wait for one another: cut the loop")
        for i in ready:
            layer[i] = max((layer[j] + 1 for j in before[i]), default=0)
    for i, needs in enumerate(before):
        users = [layer[k] for k, others in enumerate(before) if i in others]
        if not needs and users:
            layer[i] = min(users) - 1
    layer[last] = max([layer[last], *(n + 1 for i, n in layer.items() if i != last)])
    return [layer[i] for i in range(len(blocks))]


def _route(columns: list[list[Node]], source: Port, sinks: Sequence[Node]) -> None:
    """Lead one signal from column to column, through dummies where it only passes."""
    port = source
    for column in range(source.node.layer + 1, max(n.layer for n in sinks) + 1):
        for sink in sinks:
            if sink.layer == column:
                _connect(port, sink)
        if any(sink.layer > column for sink in sinks):
            dummy = Node("dummy", column)
            columns[column].append(dummy)
            _connect(port, dummy)
            port = Port(dummy, source.signal)
            dummy.outs.append(port)


def _add_ends(columns: list[list[Node]], ports: Iterable[Port]) -> None:
    """What nobody takes leaves to the right."""
    for port in ports:
        end = Node("end", port.node.layer + 1)
        if end.layer == len(columns):
            columns.append([])
        columns[end.layer].append(end)
        _connect(port, end)


def _connect(source: Port, sink: Node) -> None:
    port = Port(sink, source.signal, sources=[source])
    sink.ins.append(port)
    source.targets.append(port)


def _port(node: Node, signal: str) -> Port:
    return next(p for p in node.outs if p.signal == signal)
