"""How the tick grows: with arms, with the degree of constraint r, with contacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rich.table import Table

from benchmarks.cases import repeatable, require_status
from benchmarks.measuring import (
    joined,
    machine,
    new_axes,
    require_count,
    take_turns,
)
from benchmarks.random_arms import (
    KINDS,
    RandomRig,
    contact_of,
    faces_of,
    random_rig,
)
from osc_contact.control.controller import Status
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["draw", "measure", "tables"]

ARMS = (1, 2, 3, 4, 5, 6, 7, 8)
RANKS = (0, 1, 2, 3, 4, 5, 6)
BLOCKS = 5
CONTACTS = (1, 2, 4, 8, 16)
COLUMNS = ("kind", "arms", "joints", "d", "contacts", "r", "tick_p50_us", "floor_p50_us")


def measure(rounds: int = 300, seed: int = 0) -> dict[str, Any]:
    """{"machine": …, "arms": rows, "ranks": rows, "contacts": rows}.

    `arms`: 1 to 8 of each kind and mixed, two contacts. `ranks`: r from 0 to 6, each with as many
    contacts, two arms. `contacts`: 1 to 16 on two arms, those beyond the sixth dependent; and all
    of them with r = 1. The tick takes turns with `pin.computeAllTerms` of the same arms.

    Args:
        rounds: of each rig. seed: of the random arms and faces.

    Raises:
        InvalidInputError: no rounds.
    """
    require_count(rounds, "rounds")
    rng = np.random.default_rng(seed)
    by_arms = [
        _Timed.of(kind, random_rig(_kinds(kind, count), rng), 2, 2, rng)
        for kind in (*KINDS, "mixed")
        for count in ARMS
    ]
    pair = random_rig(["ur5", "ur5"], rng)
    by_rank = [_Timed.of("ur5", pair, r, r, rng) for r in RANKS]
    by_contacts = [_Timed.of("ur5", pair, c, min(c, 6), rng) for c in CONTACTS]
    by_contacts += [_Timed.of("ur5", pair, c, 1, rng) for c in CONTACTS[1:]]
    blocks = min(BLOCKS, rounds)
    for _ in range(blocks):  # what disturbs the machine for a while does not hit one size only
        for one in (*by_arms, *by_rank, *by_contacts):
            one.blocks.append(take_turns(one.calls, rounds // blocks, between=one.unwind))
    return {
        "machine": machine(),
        "rounds": rounds // blocks * blocks,
        "arms": [one.row() for one in by_arms],
        "ranks": [one.row() for one in by_rank],
        "contacts": [one.row() for one in by_contacts],
    }


def _kinds(kind: str, count: int) -> list[str]:
    """`count` arms of a kind; mixed: UR5s and SCARAs by turns."""
    return [("ur5", "scara")[i % 2] if kind == "mixed" else kind for i in range(count)]


@dataclass(frozen=True)
class _Timed:
    """One size: what it is, what is called, the times of each block."""

    size: dict[str, Any]
    calls: dict[str, Callable[[], object]]
    unwind: Callable[[], None]
    blocks: list[dict[str, Array]]

    @classmethod
    def of(
        cls, kind: str, rig: RandomRig, contacts: int, r: int, rng: np.random.Generator
    ) -> _Timed:
        pairs = faces_of(rig, contacts, r, rng)
        controller, measurement, reference = rig.controller(pairs)
        controller = repeatable(controller)
        chain, q, v = rig.chain, measurement.q, measurement.v
        data = chain.model.createData()
        controller.tick(measurement, reference)
        if controller.status is not Status.OK:
            raise InvalidInputError(f"{kind} × {len(chain.arms)}: {controller.reason}")

        def unwind() -> None:
            require_status(controller, kind)
            controller.motion_law.integral = np.zeros(6)
            controller.force_law.integral = np.zeros(0)

        calls: dict[str, Callable[[], object]] = {
            "tick": lambda: controller.tick(measurement, reference),
            "floor": lambda: pin.computeAllTerms(chain.model, data, q, v),
        }
        size = {
            "kind": kind,
            "arms": len(chain.arms),
            "joints": chain.nq,
            "d": chain.state(q, v).d,
            "contacts": contacts,
            "r": contact_of(rig, pairs).r,
        }
        return cls(size, calls, unwind, [])

    def row(self) -> dict[str, Any]:
        found = joined(self.blocks)
        tick, floor = (float(np.median(found[name])) for name in ("tick", "floor"))
        return self.size | {
            "tick_p50_us": tick,
            "floor_p50_us": floor,
            "ratio": tick / floor,
            "tick_per_arm_us": tick / self.size["arms"],
        }


def tables(result: dict[str, Any]) -> list[Table]:
    """One table for each thing that grows."""
    titles = {"arms": "arms, two contacts", "ranks": "constraints", "contacts": "contacts"}
    found = []
    for what, title in titles.items():
        table = Table(
            "kind", "arms", "joints", "d", "contacts", "r", "tick p50 (µs)", "floor p50 (µs)",
            "tick / floor", "tick / arm (µs)", title=f"{title}: {result['rounds']} rounds",
        )  # fmt: skip
        for row in result[what]:
            sizes = (str(row[key]) for key in COLUMNS[:6])
            times = (f"{row[key]:.1f}" for key in COLUMNS[6:])
            table.add_row(*sizes, *times, f"{row['ratio']:.2f}", f"{row['tick_per_arm_us']:.1f}")
        found.append(table)
    return found


def draw(result: dict[str, Any], path: Path) -> None:
    """Tick over arms (by kind), over r, over contacts."""
    from osc_contact.visual import OKABE_ITO
    from osc_contact.visual.plots import save, style

    with style():
        figure, axes = new_axes(3)
        colours = list(OKABE_ITO.values())
        for kind, colour in zip((*KINDS, "mixed"), colours[1:], strict=False):
            rows = [row for row in result["arms"] if row["kind"] == kind]
            _line(axes[0], rows, "arms", kind, colour)
        _line(axes[1], result["ranks"], "r", "independent contacts", colours[1])
        rows = result["contacts"]
        _line(axes[2], rows[: len(CONTACTS)], "contacts", "r = min(contacts, 6)", colours[1])
        _line(axes[2], rows[len(CONTACTS) :], "contacts", "r = 1", colours[2])
        for ax in axes:
            ax.set_ylim(bottom=0.0)
            ax.legend()
        save(figure, path.with_suffix(""))


def _line(ax: Any, rows: list[dict[str, Any]], over: str, label: str, colour: str) -> None:
    times = [row["tick_p50_us"] for row in rows]
    ax.plot([row[over] for row in rows], times, "o-", label=label, color=colour)
    ax.set(xlabel=over, ylabel="median tick (µs)")
