"""The tick of some rigs beside the floor, `pin.computeAllTerms` of the same arms."""

from collections.abc import Callable
from functools import partial

from benchmarks.cases import BATCHES, CASES, SPECIAL_CASES, BatchCase, TickCase, repeatable
from benchmarks.measuring import Call, Rows, spread, take_turns
from osc_contact.control.records import STILL, UNNAMED
from osc_contact.law.compiled import rows as law_on_rows

ALL_CASES: dict[str, Callable[[], TickCase | BatchCase]] = {**CASES, **SPECIAL_CASES, **BATCHES}
FEWER = 20  #: a batch has so many times fewer rounds: each ticks thousands of rows


def measure(rounds: int) -> dict[str, Rows]:
    """{"tick": rows} in µs; tick, the law's one call in it and floor take turns.

    Every tick is checked to have ended as the case states. Times of a batch are those of one row:
    the whole tick, and the floor of all rows, over their number. The law is timed by itself where
    nothing else is a case's own.

    Args:
        rounds: timed calls of each case.

    Raises:
        InvalidInputError: a timed tick ended otherwise.
    """
    found = []
    for name, make in ALL_CASES.items():
        case = make()
        rows = getattr(case, "rows", 1)
        tick, unwind = case.tick()
        calls = {"tick": tick, "floor": case.floor()}
        if name in CASES:
            calls["law"] = law_of(CASES[name]())
        count = rounds if rows == 1 else max(1, rounds // FEWER)
        times = take_turns(calls, count, unwind)
        p50 = {part: spread(some / rows)["p50"] for part, some in times.items()}
        found.append(
            {
                "case": name,
                **{f"{part} p50 (µs)": p50.get(part) for part in ("tick", "law", "floor")},
                "tick / floor": p50["tick"] / p50["floor"],
                "tick p99.9 (µs)": spread(times["tick"] / rows)["p99_9"],
            }
        )
    return {"tick": found}


def law_of(case: TickCase) -> Call:
    """The law's one call in a tick; the state of its loops moves on."""
    controller = repeatable(case.controller())
    m, r = case.given
    controller.tick(m, r)
    given = (m.q, m.v, m.wrenches, r.X_WD.homogeneous, r.V_D, r.A_D, r.alpha_d, STILL, UNNAMED)
    return partial(law_on_rows(), controller.records.rows.raw, 0, given)
