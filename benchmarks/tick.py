"""The tick of some rigs beside the floor, `pin.computeAllTerms` of the same arms."""

from collections.abc import Callable

from benchmarks.cases import BATCHES, CASES, SPECIAL_CASES, BatchCase, TickCase
from benchmarks.measuring import Report, cells, spread, take_turns
from paper.study import table_of

ALL_CASES: dict[str, Callable[[], TickCase | BatchCase]] = {**CASES, **SPECIAL_CASES, **BATCHES}
FEWER = 20  #: a batch has so many times fewer rounds: each ticks thousands of rows


def measure(rounds: int) -> Report:
    """{"cases": {case: {tick_p50_us, floor_p50_us, ratio, p99_9_us}}}; tick and floor take turns.

    Every tick is checked to have ended as the case says. Times of a batch are those of one row:
    the whole tick, and the floor of all rows, over their number.

    Args:
        rounds: timed calls of each case.

    Raises:
        InvalidInputError: a timed tick ended otherwise.
    """
    found = {}
    for name, make in ALL_CASES.items():
        case = make()
        tick, unwind = case.tick()
        rows = getattr(case, "rows", 1)
        count = rounds if rows == 1 else max(1, rounds // FEWER)
        times = take_turns({"tick": tick, "floor": case.floor()}, count, unwind)
        ticks, floors = (spread(some / rows) for some in times.values())
        found[name] = {
            "tick_p50_us": ticks["p50"],
            "floor_p50_us": floors["p50"],
            "ratio": ticks["p50"] / floors["p50"],
            "p99_9_us": ticks["p99_9"],
        }
    lines = (f"{name}; {cells(row)}" for name, row in found.items())
    heads = "case; tick p50 (µs); floor p50 (µs); ratio; tick p99.9 (µs)"
    return Report({"cases": found}, [table_of("tick", heads, lines)])
