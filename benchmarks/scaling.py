"""Benchmark of the tick over the number of arms, the degree of constraint r, and contacts."""

from dataclasses import replace

import numpy as np

import osc_contact as osc
from benchmarks.cases import KINDS, RandomRig, faces_of
from benchmarks.measuring import Rows, take_turns

ARMS = range(1, 9)
RANKS = range(7)
CONTACTS = (1, 2, 4, 8, 16)
KNOWN = (2, 4, 8, 12)


def measure(rounds: int) -> dict[str, Rows]:
    """{"arms": rows, "ranks": rows, "contacts": rows, "known": rows}.

    `arms`: 1 to 8 of each kind and mixed, two contacts. `ranks`: r from 0 to 6, each with as many
    contacts, two arms. `contacts`: 1 to 16 on two arms, those beyond the sixth dependent; and all
    of them with r = 1. The tick takes turns with `pin.computeAllTerms` of the same arms. `known`:
    see `measure_known`.

    Args:
        rounds: number of rounds of each rig.
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
    tables["known"] = measure_known(pair, rounds, rng)
    return tables


def measure_known(rig: RandomRig, rounds: int, rng: np.random.Generator) -> Rows:
    """Two active contacts, of 2 to 12 that a controller with contact phases is made for, in turns.

    Args:
        rig: rig of the arms.
        rounds: number of rounds of each function.
        rng: random numbers.
    """
    faces = faces_of(rig, max(KNOWN), 6, rng)
    calls = {}
    for known in KNOWN:
        case = rig.case("ur5", faces[:known])
        active = (np.arange(known) < 2).astype(float)
        case = replace(
            case,
            reference=replace(case.reference, active=active),
            life=osc.PhaseSettings(),
        )
        controller = case.controller().with_safety(osc.SafetySettings.motors_only())
        calls[str(known)] = case.tick(controller)[0]
    medians = {name: float(np.median(times)) for name, times in take_turns(calls, rounds).items()}
    return [
        {"known": int(name), "active": 2, "tick p50 (µs)": p50, "of two": p50 / medians["2"]}
        for name, p50 in medians.items()
    ]
