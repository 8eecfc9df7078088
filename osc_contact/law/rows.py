"""Rows of the tables: the law over the inputs of one controller, or of many in a batch.

`rows` runs any number of controllers, one for each row of the tables: one row for a single
controller, many for a batch, whose rows are divided among threads.
"""

from __future__ import annotations

from math import nan

from osc_contact.law.jit import entry, inner, leaf, prefetch
from osc_contact.law.records import HAND_OVER, JOB, LOOK, MEMORY, MODEL, OK, SATURATED, row_of
from osc_contact.law.tick import MISFIT, MOVING, NO_FORCES, run_parts
from osc_contact.law.vectors import copy_rows

_job, _model, _memory = (kind.at for kind in (JOB, MODEL, MEMORY))
_PRIORS = MODEL.start("priors")
_FRICTION, _COLUMNS = (MEMORY.start(name) for name in ("friction", "columns"))


@leaf
def _copy(x, start, fits, out):
    """Copy elements of x to `out`, or fill it with NaN if x has a wrong size.

    Args:
        x: (rows · len(out),) numbers of all rows in sequence.
        start: index of the first element.
        fits: False if x has a wrong size.
        out: array of numbers, filled.
    """
    for i in range(len(out)):
        out[i] = x[start + i] if fits else nan


@inner
def _sizes_fit(head, arrays, count, flags):
    """Determine whether the input arrays have the sizes of the model, except for alpha_d.

    Args:
        head: MODEL of any row.
        arrays: the nine input arrays of `rows`, in its order.
        count: number of rows.
        flags: with MOVING, the array of the touched bodies is checked, too.
    """
    q, v, wrenches, X_WD, V_D, A_D, _, touched, active = arrays
    fits = q.size == count * head.n_joints and v.size == count * head.n_joints
    fits = fits and wrenches.shape == (count * head.n_arms, 6) and X_WD.shape == (4 * count, 4)
    fits = fits and V_D.size == 6 * count and A_D.size == 6 * count
    if flags & MOVING != 0:
        fits = fits and touched.shape == (count * head.n_contacts, 28)
    if active.size > 0:
        fits = fits and active.size == count * head.n_contacts
    return fits


@inner
def _load_input(t, arrays, count, i, flags):
    """Copy the values of one row from the input arrays to INPUT.

    Positions, speeds and wrenches of a wrong size are replaced by NaN; the other arrays are not
    read if a size is wrong (MISFIT). Missing wrenches (`wrench_missing`) are those of the last
    tick. Fills `moving` (motions of touched bodies are given) and `chosen_set` (active contacts are
    named), too.

    Args:
        t: Tick.
        arrays: the nine input arrays of `rows`, in its order.
        count: number of rows.
        i: index of the row.
        flags: MOVING, MISFIT and NO_FORCES are read.
    """
    q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched, active = arrays
    row = t.input
    n = t.model.n_joints
    k = t.model.n_arms
    c = t.model.n_contacts
    row.moving = flags & MOVING != 0
    row.chosen_set = active.size > 0
    _copy(q, i * n, q.size == count * n, row.q)
    _copy(v, i * n, v.size == count * n, row.v)
    if t.memory.wrench_missing:
        copy_rows(t.memory.wrenches, row.wrenches)
    elif wrenches.shape == (count * k, 6):
        copy_rows(wrenches[i * k :], row.wrenches)
    else:
        row.wrenches[:] = nan
    # the reference, and motions of touched bodies
    if flags & MISFIT == 0:
        copy_rows(X_WD[4 * i :], row.X_WD)
        _copy(V_D, 6 * i, True, row.V_D)
        _copy(A_D, 6 * i, True, row.A_D)
        if flags & NO_FORCES == 0:
            _copy(alpha_d, i * t.model.n_columns, True, row.alpha_d)
        if row.moving:
            copy_rows(touched[i * c :], row.touched)
        _copy(active, i * c, row.chosen_set != 0, row.active)


@entry
def rows(raw, at, arrays):
    """Run controllers `first` to `last` − 1 of a job, each from part `begin` until part `stop`.

    Stops after a tick that ends SATURATED, because the quadratic program of the motor limits needs
    its WORK. Torques and status of each controller are written to its MEMORY.

    Args:
        raw: bytes of `records.Rows`.
        at: offset of the JOB, of which `first`, `last`, `begin`, `stop` and `switches` (MOVING,
            COMMANDED, OWN_FORCE, OWN_MOTION, PARTIAL) are read.
        arrays: q, v, wrenches (rows · arms, 6), X_WD (rows · 4, 4), V_D, A_D, alpha_d, touched
            (rows · contacts, 28; read with MOVING), active (rows · contacts; empty unless the user
            names active contacts, see `active_set`). Each array has the values of all rows in
            sequence.

    Returns:
        Twice the number of the next row (`last` if all are done), plus 1 if some row did not end
        OK.
    """
    job = _job(raw, at)
    count = job.count
    head = _model(raw, job.model)
    size = head.memory_bytes
    n_bytes = head.layout[_PRIORS] if job.model_step else 0  # bytes of a row that are usually read
    layout = _memory(raw, job.memory).layout
    unused = layout[_FRICTION]
    columns = layout[_COLUMNS]
    alpha_d = arrays[6]
    flags = job.switches
    if not _sizes_fit(head, arrays, count, flags):
        flags |= MISFIT
    elif alpha_d.size != count * head.n_columns:
        flags |= NO_FORCES
    violated = 0
    for i in range(job.first, job.last):
        if i + 1 < job.last:
            prefetch(raw, job.model + (i + 1) * job.model_step, n_bytes)
            following = job.memory + (i + 1) * size
            prefetch(raw, following, unused)
            prefetch(raw, following + columns, size - columns)
        t = row_of(raw, at, i)
        if job.begin == LOOK:
            _load_input(t, arrays, count, i, flags)
        status = run_parts(t, flags, job.begin, job.stop)
        if job.begin != HAND_OVER:
            t.memory.status = status
        violated |= status != OK
        if status == SATURATED:
            return 2 * (i + 1) + 1
    return 2 * job.last + violated
