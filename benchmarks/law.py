"""What of a tick is the law's one call, beside Pinocchio's `computeAllTerms` of the same arms."""

from functools import partial

from benchmarks.cases import CASES, repeatable
from benchmarks.measuring import Report, cells, spread, take_turns
from osc_contact.control.records import STILL
from osc_contact.law.compiled import rows
from paper.study import table_of


def measure(rounds: int) -> Report:
    """{"cases": {name: {"tick" | "law" | "floor": spread}}} (µs), in turns.

    The law's call is timed by itself; the state of the loops moves on.

    Args:
        rounds: timed calls of each case.

    Raises:
        InvalidInputError: a timed tick ended otherwise.
    """
    found = {}
    for name, make in CASES.items():
        case = make()
        m = case.measurement
        r = case.reference
        controller = repeatable(case.controller())
        tick, unwind = case.tick(controller)
        tick()
        given = (m.q, m.v, m.wrenches, r.X_WD.homogeneous, r.V_D, r.A_D, r.alpha_d, STILL)
        law = partial(rows(), controller._records.rows.raw, 0, given)
        times = take_turns({"tick": tick, "law": law, "floor": case.floor()}, rounds, unwind)
        found[name] = {part: spread(some) for part, some in times.items()}
    lines = [
        f"{name}; {part}; {cells(times)}"
        for name, parts in found.items()
        for part, times in parts.items()
    ]
    heads = "case; µs; p50; p99; p99.9; max"
    return Report({"cases": found}, [table_of("the law in the tick", heads, lines)])
