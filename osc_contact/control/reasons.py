"""Sentences on ticks that were held and on stops; their values are filled in when they are read."""

from typing import Any

import numpy as np

from osc_contact.control.controller_settings import Settings
from osc_contact.control.ending import TickEnd
from osc_contact.control.inputs import require_sizes
from osc_contact.control.records import TickRecords
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Reference
from osc_contact.law import records as at
from osc_contact.law.columns import CONTRADICTION
from osc_contact.law.command_filter import UNREACHABLE
from osc_contact.law.hopping import CONTACT_HOPS
from osc_contact.law.reasons import LASTING, SENTENCES
from osc_contact.law.tick import BAD_INPUT, STOPPED


class _Facts(dict[str, Any]):
    """Values for the names in a sentence of `law.reasons`, looked up as `format_map` asks for them.

    Attributes:
        rows: records of the tick.
        settings: settings of the controller.
    """

    def __init__(self, records: TickRecords, settings: Settings) -> None:
        """Store the sources of the values: records of the tick, and settings of the controller."""
        self.rows = records
        self.settings = settings

    def __missing__(self, name: str) -> Any:
        """Look up the value of a name in a sentence.

        Joints, arms and contacts are the `culprit` of a stop in MEMORY; columns of N are those at
        index `where` of WORK.

        Args:
            name: a name such as "joint", "force" (N) or "column".

        Raises:
            KeyError: no sentence has this name.
        """
        rows = self.rows
        chain = self.settings.chain
        # what `culprit` numbers (a joint, arm, contact or column of N) depends on the reason: each
        # sentence uses only the names that fit its own
        i = int(rows.memory.culprit)
        where = int(rows.work.where)
        match name:
            case "joint":
                return chain.joint_names[i]
            case "speed":
                return chain.model.velocityLimit[i]
            case "low":
                return chain.model.lowerPositionLimit[i]
            case "high":
                return chain.model.upperPositionLimit[i]
            case "arm":
                return chain.arms[i].name
            case "contact":
                return self._contact_name(i)
            case "force":
                return float(rows.memory.columns.alpha[i])
            # `hopping` counts from 1; 0 means that no contact hops
            case "hopping":
                return self._contact_name(int(rows.memory.hopping) - 1)
            case "hop_percent":
                return 100.0 * float(rows.memory.columns.hop_share[int(rows.memory.hopping) - 1])
            case "safety":
                return self.settings.safety
            case "closure_mm":
                return 1e3 * self.settings.safety.closure_error
            case "head":
                return rows.model
            case "reached":
                return float(rows.memory.reached)
            case "ceiling":
                return float(rows.memory.ceiling)
            case "amount":
                return float(rows.work.reason_amount)
            case "column":
                return where
            case "column_contact":
                return self._contact_name(where)
            case "n_gamma":
                return float(rows.work.columns.n_gamma[where])
            case "kept":
                return int(rows.kept()[where])
            case "kept_contact":
                return self._contact_name(rows.kept()[where])
        raise KeyError(name)

    def _contact_name(self, column: int) -> str:
        """Name of the contact that a column of N (its index) belongs to."""
        return self.settings.contacts[self.rows.model.columns.contact[column]].name


def explain(records: TickRecords, settings: Settings, ended: TickEnd) -> str:
    """Sentence on a tick that ended HELD, or on a stop of the arms.

    WORK has the reason of the tick, MEMORY the cause of a stop. A sensor fault stops the arms in
    the tick that detects it, even if this is held for another reason; then the sentence is on the
    fault.

    Args:
        records: records of the tick.
        settings: settings of the controller.
        ended: inputs of a tick that ended HELD, and the error of Python code called in it.
    """
    failure = ended.failure
    memory = records.memory
    code = int(records.work.reason)
    cause = int(memory.cause)
    warning = ""
    if joint := unbraked_joint(records, settings):
        warning = (
            f". No sound reading of joint {joint} is left: its motor "
            "cannot brake it reliably, engage the mechanical brakes"
        )
    facts = _Facts(records, settings)
    stopped = memory.state == at.SAFE_STOP
    if stopped and code != cause and memory.age == 1:
        return f"{SENTENCES[cause].format_map(facts)}{warning}{_ADVICE_TO_RESET}"
    if code == STOPPED or (stopped and code != cause):
        sentence = "a tick could not be computed" if failure is None else str(failure)
        if cause in _OF_A_COLUMN:
            sentence = _OF_A_COLUMN[cause]
        elif cause != BAD_INPUT:
            sentence = SENTENCES.get(cause, "").format_map(facts)
        sentence = sentence or "code called in the tick failed"
        return f"stopped, until reset() is called. Cause: {sentence}{warning}"
    if failure is not None:
        return f"{failure}{warning}"
    if code == BAD_INPUT and ended.inputs is not None:
        return _describe_input(records, settings, *ended.inputs) + warning
    lasting = _ADVICE_TO_RESET if code >= LASTING else ""
    return f"{SENTENCES[code].format_map(facts)}{warning}{lasting}"


_ADVICE_TO_RESET = ". See why, then call reset()"
#: Causes of stops without their column, as WORK of that tick is gone afterwards.
_OF_A_COLUMN = {
    UNREACHABLE: "the arms could not push on a contact; leave it out of N",
    CONTRADICTION: (
        "contacts were singular: their forces depend on each other, but the accelerations that "
        "keep them do not; drop one of them"
    ),
}


def _describe_input(
    records: TickRecords, settings: Settings, measurement: Measurement, reference: Reference
) -> str:
    """Sentence on the first input of a tick that is not finite or has a wrong size.

    Args:
        records: records of the tick.
        settings: settings of the controller.
        measurement, reference: inputs of the tick.
    """
    try:
        require_sizes(measurement, reference, settings)
    except OscContactError as error:
        return str(error)
    return (
        f"reference alpha_d: {np.size(reference.alpha_d)} forces for "
        f"{len(records.work.columns)} columns of N; give one for each degree of constraint, "
        "contact after contact"
    )


def hopping_contact(records: TickRecords, settings: Settings) -> str:
    """Sentence on the contact that hops in a tick of status HOPPING.

    Args:
        records: records of the tick.
        settings: settings of the controller.
    """
    return SENTENCES[CONTACT_HOPS].format_map(_Facts(records, settings))


def unbraked_joint(records: TickRecords, settings: Settings) -> str | None:
    """Name of a joint of stopped arms whose position and speed sensors are both faulty, or None.

    Args:
        records: records of the controller.
        settings: its settings, with the names of the joints.
    """
    joint = int(records.memory.unbraked)
    stopped = joint >= 0 and records.memory.state == at.SAFE_STOP
    return settings.chain.joint_names[joint] if stopped else None
