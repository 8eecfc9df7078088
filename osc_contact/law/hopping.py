"""Hopping contacts: forces that fall below a fifth of their commands again and again.

Limits of time (`contact_loss_time`, `overforce_time`) begin anew with each hop, and a low-passed
force may be right on average. The evidence is the share of time below a fifth of the command, and
the number of falls per second, both low-passed with 1 s. A fall counts once the force has been
above half of its command since the fall before, so that noise about a fifth is not counted.
"""

from __future__ import annotations

from osc_contact.law.jit import inner
from osc_contact.law.phases import APPROACHING
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import contact_of

HOPS = (
    "contact '{hopping}' hops: {hop_percent:.0f} % of the last second below a fifth of its command"
)
CONTACT_HOPS = declare_reason("CONTACT_HOPS", 63, HOPS)

_WINDOW = 1.0  #: s, time constant of share and rate
_LOW = 0.2  #: share of its command below which a force counts as gone
_FIRM = 0.5  #: share of its command above which a force counts as pressing again
_LIGHT = 1.0  #: N, command below which hops cannot be distinguished from noise

#: State of a column since its contact became active: no force yet, gone, pressing.
_NO_FORCE_YET, _FORCE_GONE, _PRESSING = range(3)


@inner
def watch_hops(t):
    """Update share and rate of the hops of all columns; return a reason if hops stop the arms.

    A contact hops if its force is too small for the share `hop_share` of the last second or more,
    and falls at least `hop_rate` times a second. A contact that phases have lost counts as gone
    until it presses again. Updates of the columns in MEMORY `pressing` (no force yet, gone or
    pressing), `hop_share` and `hop_rate` (1/s), and `hopping` of MEMORY: 1 plus the hopping column
    with the largest share, 0 if none hops. Fills `culprit` (index of this column) if a reason is
    returned.

    Args:
        t: Tick, with `alpha_meas` and `alpha_d` (N) of the kept columns in WORK.

    Returns:
        `CONTACT_HOPS` if a contact hops and `hop_stops` is 1, else `NO_REASON`.
    """
    model = t.model
    memory = t.memory
    work = t.work
    memory.hopping = 0
    for j in range(model.n_columns):
        if contact_of(t, j).active == 0:
            _forget_hops(memory.columns[j])
    largest_share = 0.0
    for a in range(work.rank):
        j = work.kept[a]
        row = memory.columns[j]
        is_approached = model.phased != 0 and contact_of(t, j).phase == APPROACHING
        _note_force(row, work.alpha_meas[a], work.alpha_d[a], is_approached, work.dt)
        hops = row.hop_share >= model.hop_share and row.hop_rate >= model.hop_rate
        if hops and row.hop_share > largest_share:
            largest_share = row.hop_share
            memory.hopping = 1 + j
    if memory.hopping > 0 and model.hop_stops:
        memory.culprit = memory.hopping - 1
        return CONTACT_HOPS
    return NO_REASON


@inner
def _forget_hops(row):
    """Begin anew with a column of a contact that is not active.

    Args:
        row: COLUMN_MEMORY, of which `pressing`, `hop_share` and `hop_rate` become zero.
    """
    row.pressing = _NO_FORCE_YET
    row.hop_share = 0.0
    row.hop_rate = 0.0


@inner
def _note_force(row, force, command, is_approached, dt):
    """Update the share and the rate of hops of a column by a measured force.

    A force below `_LOW` times its command is gone; one above `_FIRM` times it presses again. The
    share (0 … 1) of time in which a force that has pressed is gone, and the rate (1/s) of its
    falls, are low-passed with the time constant `_WINDOW`. Commands below `_LIGHT` are not judged.

    Args:
        row: COLUMN_MEMORY, of which `pressing`, `hop_share` and `hop_rate` are changed.
        force: α_meas (N).
        command: α_d (N).
        is_approached: whether the contact is being approached, at first or after a loss.
        dt: time since the last tick (s).
    """
    size = abs(command)
    pressing = force if command > 0.0 else -force
    is_judged = size > _LIGHT or is_approached
    is_gone = is_approached or pressing < _LOW * size
    is_low = is_judged and is_gone and row.pressing != _NO_FORCE_YET
    k = dt / (_WINDOW + dt)
    row.hop_share += k * ((1.0 if is_low else 0.0) - row.hop_share)
    row.hop_rate -= k * row.hop_rate
    if is_low and row.pressing == _PRESSING:
        row.pressing = _FORCE_GONE
        row.hop_rate += 1.0 / (_WINDOW + dt)
    elif is_judged and not is_gone and pressing > _FIRM * size:
        row.pressing = _PRESSING
