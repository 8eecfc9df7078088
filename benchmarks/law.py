"""What of a tick is the law's one call, beside Pinocchio's `computeAllTerms` of the same arms."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rich.table import Table

from benchmarks.cases import CASES, repeatable
from benchmarks.measuring import cells, machine, spread, take_turns
from osc_contact import Controller, Measurement, Reference
from osc_contact.control.records import STILL
from osc_contact.law.compiled import rows
from paper.study import Data, table_of


def kernel_call(
    controller: Controller, measurement: Measurement, reference: Reference
) -> Callable[[], Any]:
    """The law's call of a tick by itself, to be timed; the state of the loops moves on.

    Args:
        controller: whose tick is timed. measurement, reference: of the tick.
    """
    controller.tick(measurement, reference)
    args = (
        controller._records.rows.raw,
        0,
        measurement.q,
        measurement.v,
        measurement.wrenches,
        reference.X_WD.homogeneous,
        reference.V_D,
        reference.A_D,
        reference.alpha_d,
        STILL,
    )
    return partial(rows(), *args)


def measure(rounds: int) -> Data:
    """{"machine", "cases": {name: {"tick" | "law" | "floor": spread}}} (µs), in turns.

    Args:
        rounds: timed calls of each case.

    Raises:
        InvalidInputError: no rounds, or a timed tick ended otherwise.
    """
    cases = {}
    for name, make in CASES.items():
        case = make()
        controller = repeatable(case.controller())
        tick, unwind = case.ticking(controller)
        call = kernel_call(controller, case.measurement, case.reference)
        calls = {"tick": tick, "law": call, "floor": case.floor()}
        times = take_turns(calls, rounds, between=unwind)
        cases[name] = {part: spread(found) for part, found in times.items()}
    return {"machine": machine(), "cases": cases}


def tables(result: Data) -> list[Table]:
    """A row for each part of each case."""
    rows = [
        f"{name}; {part}; {cells(times)}"
        for name, parts in result["cases"].items()
        for part, times in parts.items()
    ]
    return [table_of("the law in the tick", "case; µs; p50; p99; p99.9; max", rows)]
