"""The active set: which of the known contacts take part in a tick, and what passes to the next set.

A controller is made for all contacts that may occur. The reference of a tick may name those that
are active:

| | a pair that pushes | a pair that holds |
|---|---|---|
| not active | OPEN | OPEN |
| active, with phases | APPROACHING, then CLOSED, whatever force is desired | CLOSED |
| active, without phases | CLOSED | CLOSED |

Where none are named, a pair that pushes is active while a force is desired of it (with phases; else
always), and a pair that holds always is.

What a tick leaves for the next one stands in the rows of columns: low-passed forces, steps of
desired forces, learned normals, tangential forces. So it passes with its column from set to set.
Force integrals are those of the independent columns of N, as long as these are the same ones; where
they are others, N w = Σ N_j w_j over all columns that stay, w_j the integral of each as the last
tick left it.
"""

from __future__ import annotations

from osc_contact.law.jit import inner
from osc_contact.law.phases import APPROACHING, CLOSED, OPEN, advance_phases, set_goals
from osc_contact.law.records import contact_of


@inner
def update_contacts(t):
    """Fill the phases of a tick, from what the last one measured and what is active and desired.

    Where other contacts are in N than before, the motion law hands over (`hand_over`), and
    integrals are taken by column (`by_column`).
    """
    model = t.model
    memory = t.memory
    changed = False
    if model.phased and memory.fresh != 0:  # what a tick measured is judged once
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
    """Open contacts that are not active, take in those that are; whether N has other ones now."""
    model = t.model
    changed = False
    for c in range(model.n_contacts):
        contact = t.memory.contacts[c]
        phase = contact.phase
        approached = model.phased and model.bodies[c].pushes
        if t.input.chosen_set and t.input.active[c] == 0.0:
            phase = OPEN
        elif phase == OPEN:
            phase = APPROACHING if approached else CLOSED
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
def _begin_columns(t, c, phase):
    """Forget what was observed of the columns of a contact that comes or goes."""
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
    """Have force integrals taken by column where others are in N than before.

    Those of columns that do not stay begin at 0. `here`: which columns were in N and stay, their
    phase not below the last one.
    """
    same = True
    for j in range(t.model.n_columns):
        contact = contact_of(t, j)
        was = contact.active != 0
        stays = was and t.work.here[j] != 0.0
        same = same and was == (contact.phase != OPEN) and (stays or not was)
        if not stays:
            t.memory.columns[j].integral = 0.0
    if not same:
        t.memory.by_column = 1


@inner
def keep_integrals(t):
    """Note whose the force integrals are, `force_sum` of this tick."""
    work = t.work
    memory = t.memory
    memory.force_rank = work.rank
    memory.by_column = 0
    for j in range(t.model.n_columns):
        memory.columns[j].integral = 0.0
    for a in range(work.rank):
        memory.columns[work.kept[a]].integral = memory.force_sum[a]
