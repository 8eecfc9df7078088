"""Active set: the contacts that take part in a tick, and the transfer of states between sets.

A controller is made for all contacts that may occur. The reference of a tick may name those that
are active:

| | a pair that pushes | a pair that holds |
|---|---|---|
| not active | OPEN | OPEN |
| active, with phases | APPROACHING, then CLOSED, for any desired force | CLOSED |
| active, without phases | CLOSED | CLOSED |

A closed contact that is no longer named is unloaded first: it stays in N, CLOSED, while its desired
force goes to zero as every step of a desired force does, within `step_time` (`commands`). Removed
at once, it would press on for as long as the torques take, and its force would be read as that of
the others, which are then pressed less. It leaves at once where another contact becomes active,
since that one may take its place: their columns would depend on each other.

If no active contacts are named, a pair that pushes is active while a force is desired of it (with
phases; otherwise always), and a pair that holds is always active.

States of contacts (low-passed forces, steps of desired forces, estimated normals, tangential
forces) are stored by column of N, so they are retained when the active set changes. Force integrals
are stored for the independent columns as long as these are the same. When they change, the
integrals w of the new ones follow from N w = Σ N_j w_j over all columns that remain active, w_j
being the integral of each after the last tick.
"""

from __future__ import annotations

from osc_contact.law.jit import inner
from osc_contact.law.phases import APPROACHING, CLOSED, OPEN, advance_phases, set_goals
from osc_contact.law.records import contact_of
from osc_contact.law.vectors import dot3, linear

_LONGEST_UNLOADING = 2.0  #: longest duration of unloading, as a multiple of the rise time of a step


@inner
def update_contacts(t):
    """Update phases and active set of a tick, from measured and desired forces and named contacts.

    Contacts are active (in N) unless their phase is OPEN. Phases follow from measured forces
    (`advance_phases`, with contact phases) and from the contacts that the user names active
    (`_take_set`). If the set of contacts in N changes, `hand_over` of MEMORY is set to 1, so that
    the motion integral is converted to a wrench, and `by_column`, so that force integrals are taken
    by column.

    Reads `chosen_set` (1: active contacts are named) of INPUT. Fills `here` of the columns (1: it
    remains in N), `active` of the contacts, `chosen_set` of MEMORY (that of this tick) and, with
    contact phases, `fresh` (0: the measured forces have been evaluated), and the fields that
    `advance_phases`, `_take_set`, `separate_integrals` and `set_goals` name.

    Args:
        t: Tick.
    """
    model = t.model
    memory = t.memory
    changed = False
    if model.phased and memory.fresh != 0:  # measured forces are evaluated once
        memory.fresh = 0
        changed = advance_phases(t)
    else:
        for j in range(model.n_columns):
            t.work.here[j] = contact_of(t, j).active
    if t.input.chosen_set or not model.phased:
        changed = _take_set(t) or changed
    if changed:
        memory.hand_over = 1
    separate_integrals(t)
    if model.phased:
        set_goals(t)
    else:
        for c in range(model.n_contacts):
            contact = memory.contacts[c]
            contact.active = contact.phase != OPEN
    memory.chosen_set = t.input.chosen_set


@inner
def _take_set(t):
    """Open contacts that are not named active once they are unloaded; close those that are named.

    A named contact that was open is APPROACHING with contact phases if it can only push, else
    CLOSED. A contact that is not named any more is unloaded first, unless another one becomes
    active in this tick. Without named contacts (`chosen_set` = 0) all count as named.

    Reads `chosen_set` and `active` of INPUT, and `dt` (s). Updates of the contacts in MEMORY
    `phase`, `since` (s in this phase), `held` (1 once a steady force was measured in it) and
    `unloading` (s), `goal` (N) of the columns, 0 for those that are unloaded, and the fields of
    `_begin_columns`.

    Args:
        t: Tick.

    Returns:
        True if the set of contacts in N changes.
    """
    model = t.model
    changed = False
    comes = False  # whether a contact becomes active
    for c in range(model.n_contacts):
        is_open = t.memory.contacts[c].phase == OPEN
        comes = comes or (is_open and (t.input.chosen_set == 0 or t.input.active[c] != 0.0))
    for c in range(model.n_contacts):
        contact = t.memory.contacts[c]
        phase = contact.phase
        is_approached = model.phased and model.bodies[c].pushes
        leaves = t.input.chosen_set != 0 and t.input.active[c] == 0.0
        unloads = leaves and not comes and _unload(t, c)
        contact.unloading = contact.unloading + t.work.dt if unloads else 0.0
        if leaves:
            phase = phase if unloads else OPEN
        elif phase == OPEN:
            phase = APPROACHING if is_approached else CLOSED
        if model.phased == 0:
            contact.since += t.work.dt
        if phase != contact.phase:
            contact.phase = phase
            contact.since = 0.0
            contact.held = 0
            _begin_columns(t, c, phase)
        changed = changed or (phase != OPEN) != (contact.active != 0)
    return changed


@inner
def _unload(t, c):
    """Set the desired forces of a contact that leaves the active set to zero.

    It stays in N until the step of its desired force to zero has ended. Reads, of MEMORY, `phase`
    and `unloading` (s) of the contact, `has_desired` (1 if a force was desired in the last tick),
    `desired` (N) and `to_come` (N; remainder of a step) of its columns, and `step_left` (remaining
    share of the rise time). Sets `goal` (N) of its columns to 0.

    Args:
        t: Tick.
        c: index of the contact.

    Returns:
        Whether a force was commanded of it in the last tick, so that it stays in N: its desired
        force was not zero, or its step to zero lasts. False if steps are not shaped, or if
        unloading has lasted too long because steps of other contacts follow each other.
    """
    model = t.model
    contact = t.memory.contacts[c]
    may_last = contact.unloading <= _LONGEST_UNLOADING * model.step_time
    if contact.phase != CLOSED or model.step_time == 0.0 or not may_last:
        return False
    is_loaded = False
    for j in range(model.n_columns):
        if model.columns[j].contact != c:
            continue
        row = t.memory.columns[j]
        to_come = linear(row.to_come)
        steps = t.memory.step_left > 0.0 and dot3(to_come, to_come) > 0.0
        is_loaded = is_loaded or (row.has_desired != 0 and (row.desired != 0.0 or steps))
        t.work.goal[j] = 0.0
    return is_loaded


@inner
def _begin_columns(t, c, phase):
    """Reset the contact detection of a contact's columns when it becomes active or inactive.

    Sets of the columns in MEMORY `closed` (1 if the new phase is CLOSED) and, to zero, `collision`,
    the times of low and high force `low_for` and `high_for` (s), and those of too little and too
    much force `underforce` and `overforce` (s); `here` of WORK becomes 0: the column does not
    remain in N from the last tick.

    Args:
        t: Tick.
        c: index of the contact.
        phase: its new phase (OPEN, APPROACHING or CLOSED).
    """
    for j in range(t.model.n_columns):
        if t.model.columns[j].contact == c:
            row = t.memory.columns[j]
            row.closed = 1 if phase == CLOSED else 0
            row.collision = 0
            row.low_for = row.high_for = 0.0
            row.underforce = row.overforce = 0.0
            t.work.here[j] = 0.0


@inner
def separate_integrals(t):
    """Set `by_column` if the columns in N change; reset integrals of columns that do not remain.

    Reads `here` of WORK, which is 1 for columns that remain in N without returning to an earlier
    phase, and `phase` and `active` (whether it was in N in the last tick) of the contacts in
    MEMORY. Changes `by_column`, and `integral` (N) of the columns in MEMORY.

    Args:
        t: Tick.
    """
    unchanged = True
    for j in range(t.model.n_columns):
        contact = contact_of(t, j)
        was_active = contact.active != 0
        stays = was_active and t.work.here[j] != 0.0
        unchanged = (
            unchanged and was_active == (contact.phase != OPEN) and (stays or not was_active)
        )
        if not stays:
            t.memory.columns[j].integral = 0.0
    if not unchanged:
        t.memory.by_column = 1


@inner
def keep_integrals(t):
    """Store the force integrals of the independent columns under the numbers of all columns, too.

    From these values the integrals of another set of contacts are computed later. Reads `force_sum`
    (N), `rank` and `kept`; fills `force_rank`, `by_column` (0) and `integral` of the columns in
    MEMORY.

    Args:
        t: Tick.
    """
    work = t.work
    memory = t.memory
    memory.force_rank = work.rank
    memory.by_column = 0
    for j in range(t.model.n_columns):
        memory.columns[j].integral = 0.0
    for a in range(work.rank):
        memory.columns[work.kept[a]].integral = memory.force_sum[a]
