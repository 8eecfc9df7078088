"""Why a tick was held, in words: one table of sentences, filled in when they are read."""

from collections.abc import Callable
from typing import Any

import numpy as np

from osc_contact.control.inputs import require_sizes
from osc_contact.control.records import Settings, TickRecords
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Reference
from osc_contact.law import records as at

#: Code of a reason → sentence. Names in braces are those of `_FACTS`, `safety` and `head` (MODEL).
_SENTENCES = {
    at.NO_REASON: "",
    at.OBJECT_UNKNOWN: (
        "the joints do not determine where the object is: its grasps let it move while every arm "
        "stands still. Grasp it so that this is blocked"
    ),
    at.BAD_INERTIA: (
        "the joint-space inertia of an arm is not positive definite; check the masses and inertias "
        "of its links"
    ),
    at.UNACTUATED: (
        "the motors cannot drive every motion of the object. Add a motor, or grasp so that the "
        "motion is blocked"
    ),
    at.DEGENERATE_PAIR: (
        "a contact has no N in this posture: two edges in contact are parallel (give an edge on a "
        "face, or turn the object), no one place of a curved face is nearest, or a CompiledPair "
        "returned what is not finite"
    ),
    at.DIFFERENT_BODIES: (
        "dependent contacts on different bodies: how their force is split decides how the bodies "
        "move, and no equation determines the split. Put them on one body, or drop one of them"
    ),
    at.INSEPARABLE: (
        "as seen through the arms, some contact columns are dependent: their forces cannot be "
        "separated. Keep an independent subset"
    ),
    at.BAD_METRIC: "the metric B of eq. 24 is singular in the motions that the arms permit",
    at.NO_ROTATION: (
        "reference X_WD: its rotation is none (R Rᵀ = 1 and det R = 1 are missed by more than 1e-4)"
    ),
    at.NOT_FINITE: (
        "the computed torques are not finite: the measured state or the integrals are out of any "
        "range. Check the sensors; reset the integrals"
    ),
    at.BLIND: (
        "the inertia beyond the wrist sensors is singular: the contact force cannot be determined "
        "from them. Check mass and inertia of gripper and object"
    ),
    at.UNREACHABLE: (
        "the arms cannot push on contact column {kept} ({kept_contact}): its mobility is "
        "{amount:.2g} of the free object's. The structure carries this force; leave the contact "
        "out of N."
    ),
    at.CONTRADICTION: (
        "{column_contact}: singular at this instant. Its force depends on those of other contacts, "
        "but the acceleration that keeps it does not: column {column} needs n_γ = {n_gamma:.6g}, "
        "the others imply {amount:.6g}. Drop one of these contacts, or move through this pose "
        "slower or with the others released"
    ),
    at.OUT_OF_RANGE: (
        "the wrist of arm '{arm}' reads more than it measures (force_range = {head.force_range:g} "
        "N, torque_range = {head.torque_range:g} N m)"
    ),
    at.JUMPED: (
        "joint {joint} jumps: it reads faster than plausible_speed = {safety.plausible_speed:g} "
        "times its speed limit of {speed:.4g} rad/s or m/s"
    ),
    at.WRENCH_TIMEOUT: (
        "no wrench was read for longer than wrench_timeout = {safety.wrench_timeout:g} s"
    ),
    at.OVERSPEED: (
        "joint {joint} stayed above its speed limit of {speed:.4g} rad/s or m/s for "
        "{safety.overspeed_time:g} s; the arms are braked"
    ),
    at.NEAR_END: (
        "joint {joint} came so near to the end of its range [{low:.4g}, {high:.4g}] that it could "
        "just be stopped before, braked from its speed limit in brake_time = "
        "{safety.brake_time:g} s"
    ),
    at.STUCK: (
        "the encoder of joint {joint} reads the very same though it was commanded to gain "
        "{safety.stuck_speed:g} of its speed limit"
    ),
    at.DISAGREE: (
        "the speed of joint {joint} is not that of its positions: they differ by more than "
        "{safety.speed_error:g} of its speed limit, or positions drift by more than "
        "{safety.position_drift:g} rad or m from what speeds add up to"
    ),
    at.UNBALANCED: (
        "the motor torques of arm '{arm}' contradict its wrist by more than wrist_error = "
        "{safety.wrist_error:g} of their limits: the sensor's sign, scale, offset, frame or arm is "
        "wrong, or the masses of the links, or a joint rubs"
    ),
    at.APART: (
        "arm '{arm}' is more than closure_error = {closure_mm:g} mm away from where the others "
        "hold the object: an encoder is wrong, those of two arms are swapped, or a grasp has "
        "slipped"
    ),
    at.WRIST_FROZEN: (
        "the wrist of arm '{arm}' reads the very same for {safety.frozen_time:g} s: it is dead, or "
        "its last reading repeats itself. Sensors too coarse to show any noise take frozen_time = "
        "inf"
    ),
    at.FROZEN: (
        "all readings are the very same for {safety.frozen_time:g} s: a packet repeats itself. "
        "Sensors too coarse to show any noise take frozen_time = inf"
    ),
    at.POWERED: "more than contact_power = {safety.contact_power:g} W went into the contacts",
    at.CONTACT_LOST: (
        "{contact}: less than a fifth of its command was read for {safety.contact_loss_time:g} s, "
        "or its integral stood at its bound ({force:.3g} N when last computed), or it was not held "
        "again {safety.regain_time:g} s after it was lost. Contact is lost, or a wrist sensor is "
        "dead or wired with the wrong sign"
    ),
    at.OVERFORCE: (
        "{contact}: more than {safety.contact_force:g} N and three times its command was read for "
        "{safety.overforce_time:g} s ({force:.3g} N when last computed)"
    ),
}
#: Reasons of one tick, which the next may overcome; later ones stay until `reset`.
_PASSING = (at.OUT_OF_RANGE, at.JUMPED, at.WRENCH_TIMEOUT)

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
    if code == at.STOPPED:
        cause = int(records.memory.cause)
        why = "a tick could not be computed" if failure is None else str(failure)
        if cause in (at.UNREACHABLE, at.CONTRADICTION):  # where they were is not remembered
            why = ""
        elif cause != at.BAD_INPUT:
            why = _SENTENCES.get(cause, "").format_map(facts)
        why = why or "code called in the tick failed"
        return f"stopped, until reset() is called. Cause: {why}{_unbraked(records, settings)}"
    if failure is not None:
        return f"{failure}{_unbraked(records, settings)}"
    if code == at.BAD_INPUT:
        try:
            require_sizes(measurement, reference, settings)
        except OscContactError as error:
            return str(error)
        return (
            f"reference alpha_d: {np.size(reference.alpha_d)} forces for "
            f"{len(records.work.columns)} columns of N; give one for each degree of constraint, "
            "contact after contact"
        )
    lasting = code >= at.OVERSPEED and code not in _PASSING
    return _SENTENCES[code].format_map(facts) + lasting * ". See why, then call reset()"


def _unbraked(records: TickRecords, settings: Settings) -> str:
    """A sentence about a stopped joint without any sound reading; empty: there is none."""
    joint = int(records.memory.unbraked)
    if joint < 0 or records.memory.state != at.SAFE_STOP:
        return ""
    return (
        f". No sound reading of joint {settings.chain.joint_names[joint]} is left: its motor "
        "cannot brake it reliably, engage the mechanical brakes"
    )
