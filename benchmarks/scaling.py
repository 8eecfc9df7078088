"""Benchmark of the tick over the number of arms, the degree of constraint r, and contacts."""

import numpy as np

from benchmarks.cases import KINDS, RandomRig, faces_of
from benchmarks.measuring import Rows, take_turns

ARMS = range(1, 9)
RANKS = range(7)
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
    sizes = [
        ("arms", kind, RandomRig((arms * max(ARMS))[:count], rng), 2, 2)
        for kind, arms in kinds.items()
        for count in ARMS
    ]
    pair = RandomRig(["ur5", "ur5"], rng)
    sizes += [("ranks", "ur5", pair, r, r) for r in RANKS]
    sizes += [("contacts", "ur5", pair, c, min(c, 6)) for c in CONTACTS]
    sizes += [("contacts", "ur5", pair, c, 1) for c in CONTACTS[1:]]
    tables: dict[str, Rows] = {"arms": [], "ranks": [], "contacts": []}
    for what, kind, rig, contacts, r in sizes:
        case = rig.case(kind, faces_of(rig, contacts, r, rng))
        ticked, unwind = case.tick()
        times = take_turns({"tick": ticked, "floor": case.floor()}, rounds, unwind)
        tick, floor = (float(np.median(some)) for some in times.values())
        arms = len(case.chain.arms)
        tables[what].append(
            {
                "kind": kind,
                "arms": arms,
                "contacts": contacts,
                "r": r,
                "tick p50 (µs)": tick,
                "floor p50 (µs)": floor,
                "tick / floor": tick / floor,
                "tick / arm (µs)": tick / arms,
            }
        )
    return tables
