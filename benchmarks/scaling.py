"""How the tick grows: with arms, with the degree of constraint r, with contacts."""

from itertools import chain

import numpy as np

from benchmarks.cases import KINDS, RandomRig, faces_of
from benchmarks.measuring import Report, joined, take_turns
from osc_contact.spatial import Array
from paper.study import Data, table_of

ARMS = (1, 2, 3, 4, 5, 6, 7, 8)
RANKS = (0, 1, 2, 3, 4, 5, 6)
BLOCKS = 5
CONTACTS = (1, 2, 4, 8, 16)


def measure(rounds: int) -> Report:
    """{"arms": rows, "ranks": rows, "contacts": rows}.

    `arms`: 1 to 8 of each kind and mixed, two contacts. `ranks`: r from 0 to 6, each with as many
    contacts, two arms. `contacts`: 1 to 16 on two arms, those beyond the sixth dependent; and all
    of them with r = 1. The tick takes turns with `pin.computeAllTerms` of the same arms.

    Args:
        rounds: of each rig.
    """
    rng = np.random.default_rng(0)
    timed = {
        "arms": [
            _Timed(kind, RandomRig(_kinds(kind, count), rng), 2, 2, rng)
            for kind in (*KINDS, "mixed")
            for count in ARMS
        ]
    }
    pair = RandomRig(["ur5", "ur5"], rng)
    sizes = [(c, min(c, 6)) for c in CONTACTS] + [(c, 1) for c in CONTACTS[1:]]
    for what, counts in {"ranks": [(r, r) for r in RANKS], "contacts": sizes}.items():
        timed[what] = [_Timed("ur5", pair, *count, rng) for count in counts]
    blocks = min(BLOCKS, rounds)
    for _ in range(blocks):  # what disturbs the machine for a while does not hit one size only
        for one in chain.from_iterable(timed.values()):
            one.blocks.append(take_turns(one.calls, rounds // blocks, one.unwind))
    rows = {what: [one.row() for one in some] for what, some in timed.items()}
    titles = {"arms": "arms, two contacts", "ranks": "constraints", "contacts": "contacts"}
    heads = (
        "kind; arms; joints; d; contacts; r; tick p50 (µs); floor p50 (µs); tick / floor; "
        "tick / arm (µs)"
    )
    count = rounds // blocks * blocks
    tables = []
    for what, title in titles.items():
        lines = (
            [f"{x:.2f}" if isinstance(x, float) else x for x in row.values()] for row in rows[what]
        )
        tables.append(table_of(f"{title}: {count} rounds", heads, lines))
    return Report({"rounds": count, **rows}, tables)


def _kinds(kind: str, count: int) -> list[str]:
    """`count` arms of a kind; mixed: UR5s and SCARAs by turns."""
    return [("ur5", "scara")[i % 2] if kind == "mixed" else kind for i in range(count)]


class _Timed:
    """One size: what it is, what is called, the times of each block."""

    def __init__(
        self, kind: str, rig: RandomRig, contacts: int, r: int, rng: np.random.Generator
    ) -> None:
        case = rig.case(kind, faces_of(rig, contacts, r, rng))
        tick, self.unwind = case.tick()
        self.calls = {"tick": tick, "floor": case.floor()}
        self.blocks: list[dict[str, Array]] = []
        self.size: Data = {
            "kind": kind,
            "arms": len(case.chain.arms),
            "joints": case.chain.nq,
            "d": case.chain.state(rig.q, case.measurement.v).d,
            "contacts": contacts,
            "r": r,
        }

    def row(self) -> Data:
        tick, floor = (float(np.median(times)) for times in joined(self.blocks).values())
        return self.size | {
            "tick_p50_us": tick,
            "floor_p50_us": floor,
            "ratio": tick / floor,
            "tick_per_arm_us": tick / self.size["arms"],
        }
