"""Detection of wrist sensors whose readings, or one of whose numbers, repeat."""

from __future__ import annotations

from osc_contact.law.jit import inner, leaf
from osc_contact.law.plausibility import is_measurable
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import WRISTS

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
    """Detect wrist sensors whose readings repeat.

    One of its six numbers that repeats is evidence only if most numbers of that sensor change with
    each reading (`lively`): those of a sensor whose noise is smaller than its resolution repeat in
    sound operation, too. Numbers that are zero are left out, since a sensor may lack them; and a
    number is evidence only while it repeats in contact, since in the air it has no reason to
    change. Reads `wrenches` of INPUT; updates `same`, `constant`, `lively`, `watched` and `unread`
    of the arms and `wrenches` in MEMORY.

    Args:
        t: Tick.

    Returns:
        WRIST_FROZEN if the reading of an arm in contact has been constant for `frozen_time`,
        WRIST_SATURATED if one of its numbers has, else NO_REASON; the index of the arm, or −1; and
        True if the readings of all wrists equal those of the last tick.
    """
    model = t.model
    memory = t.memory
    last_wrenches = memory.wrenches
    wrenches = t.input.wrenches
    all_same = True
    reason = NO_REASON
    culprit = -1
    is_new = memory.repeated & WRISTS == 0 and memory.wrench_missing == 0
    for k in range(model.n_arms):
        arm_memory = memory.arms[k]
        # a reading beyond the sensor's range is new evidence that readings change
        if not (is_new and is_measurable(t, k)):
            arm_memory.unread += 1
            all_same = all_same and not (is_new and _exceeds(t, k))
            continue
        is_same = memory.has_wrench != 0
        pressed = model.arms[k].sensor_joint >= 0 and memory.engaged != 0 and memory.force_rank > 0
        elapsed = model.period * (1 + arm_memory.unread)
        longest = 0.0
        n_constant = 0
        n_read = 0
        for i in range(6):
            is_constant = last_wrenches[k, i] == wrenches[k, i]
            is_same = is_same and is_constant
            last_wrenches[k, i] = wrenches[k, i]
            n_read += 1 if wrenches[k, i] != 0.0 else 0
            if is_constant and wrenches[k, i] != 0.0:
                n_constant += 1
                arm_memory.constant[i] = arm_memory.constant[i] + elapsed if pressed else 0.0
                longest = max(longest, arm_memory.constant[i])
            else:
                arm_memory.constant[i] = 0.0
        changed = 1.0 - n_constant / max(n_read, 1)
        span = min(_REMEMBERED, arm_memory.watched)
        arm_memory.watched += elapsed
        arm_memory.lively += elapsed / (span + elapsed) * (changed - arm_memory.lively)
        longest = longest if arm_memory.lively > _LEAST_LIVELY else 0.0
        arm_memory.same = arm_memory.same + elapsed if is_same else 0.0
        arm_memory.unread = 0
        all_same = all_same and is_same
        if pressed and max(longest, arm_memory.same) > model.frozen_time:
            reason = WRIST_FROZEN if arm_memory.same > model.frozen_time else WRIST_SATURATED
            culprit = k
    return reason, culprit, all_same


@leaf
def _exceeds(t, k):
    """Determine whether the reading of a wrist is beyond the range of its sensor; false for NaN.

    Args:
        t: Tick, of which `wrenches` of INPUT are read.
        k: index of the arm.
    """
    exceeds = False
    for i in range(6):
        limit = t.model.force_range if i < 3 else t.model.torque_range
        exceeds = exceeds or abs(t.input.wrenches[k, i]) > limit
    return exceeds
