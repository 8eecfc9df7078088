"""Detection of wrist sensors whose readings, or one of whose numbers, repeat."""

from __future__ import annotations

from math import isfinite

from osc_contact.law.jit import inner
from osc_contact.law.plausibility import exceeds_range
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import WRISTS
from osc_contact.law.vectors import ZERO, fill, finiteness

WRIST_FROZEN = declare_reason(
    "WRIST_FROZEN",
    57,
    "the wrist of arm '{arm}' reads the very same for {safety.frozen_time:g} s: it is dead, or "
    "its last reading repeats itself. Sensors too coarse to show any noise take frozen_time = "
    "inf",
)
WRIST_SATURATED = declare_reason(
    "WRIST_SATURATED",
    64,
    "a force or torque of the wrist of arm '{arm}' reads the very same for "
    "{safety.frozen_time:g} s while others change: it is at the end of its range, or that channel "
    "is dead. Sensors too coarse to show any noise take frozen_time = inf",
)

_REMEMBERED = 1.0  #: s, time constant of the share of a wrist's numbers that change
_LEAST_LIVELY = 0.5  #: least share of them of a sensor of which a number that repeats is evidence


@inner
def check_wrists(t):
    """Detect wrist sensors whose readings, or one of whose numbers, repeat.

    A number that repeats is evidence only while its arm is in contact, since in the air it has no
    reason to change. Readings are compared by `_compare_reading`. Updates `same` and `unread` of
    the arms in MEMORY, and what that function updates.

    Args:
        t: Tick, of which `wrenches` of INPUT are read.

    Returns:
        WRIST_FROZEN if the reading of an arm in contact has been constant for `frozen_time`,
        WRIST_SATURATED if one of its numbers has, else NO_REASON; the index of the arm, or −1; and
        True if the readings of all wrists equal those of the last tick.
    """
    model = t.model
    memory = t.memory
    all_same = True
    reason = NO_REASON
    culprit = -1
    is_new = memory.repeated & WRISTS == 0 and memory.wrench_missing == 0
    is_pressing = memory.engaged != 0 and memory.force_rank > 0
    for k in range(model.n_arms):
        row = memory.arms[k]
        is_beyond = is_new and exceeds_range(t, k)
        if not is_new or is_beyond or not isfinite(finiteness(t.input.wrenches[k], 6)):
            row.unread += 1
            # a reading beyond the sensor's range is new evidence that readings change
            all_same = all_same and not is_beyond
            continue
        elapsed = model.period * (1 + row.unread)
        row.unread = 0
        is_pressed = is_pressing and model.arms[k].sensor_joint >= 0
        is_same, longest = _compare_reading(t, k, elapsed, is_pressed)
        row.same = row.same + elapsed if is_same else 0.0
        all_same = all_same and is_same
        if is_pressed and max(longest, row.same) > model.frozen_time:
            reason = WRIST_FROZEN if row.same > model.frozen_time else WRIST_SATURATED
            culprit = k
    return reason, culprit, all_same


@inner
def _compare_reading(t, k, elapsed, is_pressed):
    """Compare the six numbers of a wrist with those of its last reading, and store them.

    Numbers that are zero are left out, since a sensor may lack them. A number that repeats is
    evidence only if most numbers of that sensor change with each reading (`lively` of the arm, the
    low-passed share of those that change): those of a sensor whose noise is smaller than its
    resolution repeat in sound operation, too. Updates `constant` (six times in s), `lively` and
    `watched` (s for which it has been observed) of the arm, and `wrenches`, in MEMORY.

    Args:
        t: Tick.
        k: index of the arm.
        elapsed: time since its last reading (s).
        is_pressed: whether the arm is in contact.

    Returns:
        Whether all numbers equal those of the last reading; and the longest time for which one of
        them that is not zero has been constant in contact (s), 0 where that is no evidence.
    """
    row = t.memory.arms[k]
    last = t.memory.wrenches[k]
    reading = t.input.wrenches[k]
    n_read = 0
    n_same = 0
    n_constant = 0
    for i in range(6):
        is_read = reading[i] != 0.0
        n_read += 1 if is_read else 0
        if reading[i] == last[i]:
            n_same += 1
            n_constant += 1 if is_read else 0
    longest = 0.0
    for i in range(6 if n_constant > 0 and is_pressed else 0):
        is_constant = reading[i] == last[i] and reading[i] != 0.0
        row.constant[i] = row.constant[i] + elapsed if is_constant else 0.0
        longest = max(longest, row.constant[i])
    if longest == 0.0:
        fill(row.constant, ZERO)
    fill(last, reading)
    changed = 1.0 - n_constant / n_read if n_constant > 0 else 1.0
    span = min(_REMEMBERED, row.watched)
    row.watched += elapsed
    if row.lively != changed:
        row.lively += elapsed / (span + elapsed) * (changed - row.lively)
    is_same = n_same == 6 and t.memory.has_wrench != 0
    return is_same, longest if row.lively > _LEAST_LIVELY else 0.0
