"""Why a tick was held, in words: sentences of the law, filled in when they are read."""

from collections.abc import Callable
from typing import Any

import numpy as np

from osc_contact.control.inputs import require_sizes
from osc_contact.control.records import Settings, TickRecords
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Reference
from osc_contact.law import records as at
from osc_contact.law.columns import CONTRADICTION
from osc_contact.law.command_filter import UNREACHABLE
from osc_contact.law.reasons import LASTING, SENTENCES
from osc_contact.law.tick import BAD_INPUT, STOPPED

#: Values of sentences, of the joint, arm or column at fault i, or of where the geometry fails.
_FACTS: dict[str, Callable[[TickRecords, Settings, int], Any]] = {
    "joint": lambda rows, given, i: given.chain.joint_names[i],
    "speed": lambda rows, given, i: given.chain.model.velocityLimit[i],
    "low": lambda rows, given, i: given.chain.model.lowerPositionLimit[i],
    "high": lambda rows, given, i: given.chain.model.upperPositionLimit[i],
    "arm": lambda rows, given, i: given.chain.arms[i].name,
    "contact": lambda rows, given, i: _contact(rows, given, i),
    "force": lambda rows, given, i: float(rows.memory.columns.alpha[i]),
    "safety": lambda rows, given, i: given.safety,
    "closure_mm": lambda rows, given, i: 1e3 * given.safety.closure_error,
    "head": lambda rows, given, i: rows.model,
    "amount": lambda rows, given, i: float(rows.work.amount),
    "column": lambda rows, given, i: int(rows.work.where),
    "column_contact": lambda rows, given, i: _contact(rows, given, int(rows.work.where)),
    "n_gamma": lambda rows, given, i: float(rows.work.columns.n_gamma_all[int(rows.work.where)]),
    "kept": lambda rows, given, i: int(rows.kept()[int(rows.work.where)]),
    "kept_contact": lambda rows, given, i: _contact(
        rows, given, int(rows.kept()[int(rows.work.where)])
    ),
}


def _contact(records: TickRecords, settings: Settings, column: int) -> str:
    return settings.contacts[records.model.columns.contact[column]].name


class _Facts(dict[str, Any]):
    """The values that a sentence names, each found as it is named."""

    def __init__(self, records: TickRecords, settings: Settings) -> None:
        self.where = (records, settings, int(records.memory.culprit))

    def __missing__(self, name: str) -> Any:
        return _FACTS[name](*self.where)


def explain(
    records: TickRecords,
    settings: Settings,
    measurement: Measurement,
    reference: Reference,
    failure: Exception | None,
) -> str:
    """The sentence for a tick that ended HELD.

    Args:
        records: of the tick. settings: of the controller.
        measurement, reference: what came in. failure: error of Python code called in it.
    """
    code = int(records.work.reason)
    facts = _Facts(records, settings)
    if code == STOPPED:
        cause = int(records.memory.cause)
        why = "a tick could not be computed" if failure is None else str(failure)
        if cause in (UNREACHABLE, CONTRADICTION):  # where they were is not remembered
            why = ""
        elif cause != BAD_INPUT:
            why = SENTENCES.get(cause, "").format_map(facts)
        why = why or "code called in the tick failed"
        return f"stopped, until reset() is called. Cause: {why}{_unbraked(records, settings)}"
    if failure is not None:
        return f"{failure}{_unbraked(records, settings)}"
    if code == BAD_INPUT:
        try:
            require_sizes(measurement, reference, settings)
        except OscContactError as error:
            return str(error)
        return (
            f"reference alpha_d: {np.size(reference.alpha_d)} forces for "
            f"{len(records.work.columns)} columns of N; give one for each degree of constraint, "
            "contact after contact"
        )
    lasting = (code >= LASTING) * ". See why, then call reset()"
    return SENTENCES[code].format_map(facts) + lasting


def _unbraked(records: TickRecords, settings: Settings) -> str:
    """A sentence about a stopped joint without any sound reading; empty: there is none."""
    joint = int(records.memory.unbraked)
    if joint < 0 or records.memory.state != at.SAFE_STOP:
        return ""
    return (
        f". No sound reading of joint {settings.chain.joint_names[joint]} is left: its motor "
        "cannot brake it reliably, engage the mechanical brakes"
    )
