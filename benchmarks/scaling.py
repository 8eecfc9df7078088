"""How the tick grows: with arms, with the degree of constraint r, with contacts."""

import numpy as np

from benchmarks.cases import KINDS, RandomRig, faces_of
from benchmarks.measuring import Rows, take_turns
from osc_contact.spatial import Array

ARMS = (1, 2, 3, 4, 5, 6, 7, 8)
RANKS = (0, 1, 2, 3, 4, 5, 6)
BLOCKS = 5
CONTACTS = (1, 2, 4, 8, 16)


def measure(rounds: int) -> dict[str, Rows]:
    """{"arms": rows, "ranks": rows, "contacts": rows}.

    `arms`: 1 to 8 of each kind and mixed, two contacts. `ranks`: r from 0 to 6, each with as many
    contacts, two arms. `contacts`: 1 to 16 on two arms, those beyond the sixth dependent; and all
    of them with r = 1. The tick takes turns with `pin.computeAllTerms` of the same arms.

    Args:
        rounds: of each rig.
    """
    rng = np.random.default_rng(0)
    kinds = {kind: [kind] for kind in KINDS} | {"mixed": ["ur5", "scara"]}
    sized = [
        _Timed("arms", kind, RandomRig((arms * max(ARMS))[:count], rng), 2, 2, rng)
        for kind, arms in kinds.items()
        for count in ARMS
    ]
    pair = RandomRig(["ur5", "ur5"], rng)
    sizes = [(c, min(c, 6)) for c in CONTACTS] + [(c, 1) for c in CONTACTS[1:]]
    for what, counts in {"ranks": [(r, r) for r in RANKS], "contacts": sizes}.items():
        sized += [_Timed(what, "ur5", pair, *count, rng) for count in counts]
    blocks = min(BLOCKS, rounds)
    for _ in range(blocks):  # what disturbs the machine for a while does not hit one size only
        for one in sized:
            one.blocks.append(take_turns(one.calls, rounds // blocks, one.unwind))
    return {
        what: [one.row() for one in sized if one.what == what]
        for what in ("arms", "ranks", "contacts")
    }


class _Timed:
    """One size: in which table, what it is, what is called, the times of each block."""

    def __init__(
        self, what: str, kind: str, rig: RandomRig, contacts: int, r: int, rng: np.random.Generator
    ) -> None:
        self.what = what
        self.case = rig.case(kind, faces_of(rig, contacts, r, rng))
        tick, self.unwind = self.case.tick()
        self.calls = {"tick": tick, "floor": self.case.floor()}
        self.blocks: list[dict[str, Array]] = []
        self.r = r

    def row(self) -> dict[str, object]:
        chain = self.case.chain
        tick, floor = (
            float(np.median([block[name] for block in self.blocks])) for name in self.calls
        )
        return {
            "kind": self.case.name,
            "arms": len(chain.arms),
            "joints": chain.nq,
            "d": chain.state(self.case.posture, np.zeros(chain.nq)).d,
            "contacts": len(self.case.pairs),
            "r": self.r,
            "tick p50 (µs)": tick,
            "floor p50 (µs)": floor,
            "tick / floor": tick / floor,
            "tick / arm (µs)": tick / len(chain.arms),
        }
