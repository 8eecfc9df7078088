"""The tick of some rigs beside the floor, `pin.computeAllTerms` of the same arms."""

from collections.abc import Callable, Iterable

from rich.table import Table

from benchmarks.cases import BATCHES, CASES, SPECIAL_CASES, BatchCase, TickCase
from benchmarks.measuring import cells, require_count, spread, take_turns
from paper.study import Data, table_of

ALL_CASES: dict[str, Callable[[], TickCase | BatchCase]] = {**CASES, **SPECIAL_CASES, **BATCHES}
FEWER = 20  #: a batch has so many times fewer rounds: each ticks thousands of rows


def measure(rounds: int = 1000, cases: Iterable[str] = tuple(ALL_CASES)) -> Data:
    """{case: {tick_p50_us, floor_p50_us, ratio, p99_9_us}}; tick and floor take turns.

    Every tick is checked to have ended as the case says. Times of a batch are those of one row:
    the whole tick, and the floor of all rows, over their number.

    Raises:
        InvalidInputError: no rounds, or a timed tick ended otherwise.
    """
    require_count(rounds, "rounds")
    result = {}
    for name in cases:
        case = ALL_CASES[name]()
        tick, unwind = case.tick()
        rows = getattr(case, "rows", 1)
        count = rounds if rows == 1 else max(1, rounds // FEWER)
        times = take_turns({"tick": tick, "floor": case.floor()}, count, between=unwind)
        ticks, floors = (spread(found / rows) for found in times.values())
        result[name] = {
            "tick_p50_us": ticks["p50"],
            "floor_p50_us": floors["p50"],
            "ratio": ticks["p50"] / floors["p50"],
            "p99_9_us": ticks["p99_9"],
        }
    return result


def tables(result: Data) -> list[Table]:
    """All cases in one table; those of a batch for each row."""
    rows = (f"{name}; {cells(row)}" for name, row in result.items())
    return [table_of("tick", "case; tick p50 (µs); floor p50 (µs); ratio; tick p99.9 (µs)", rows)]
