"""Friction in wrist readings: at points of contact, and along permitted motions of other pairs.

A pair that pushes at known points rubs along its tangents there. In a hole, a groove or a hinge it
is not known where bodies touch: friction acts along the slides that the pair permits, and about its
turns with an assumed lever.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import forward
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.pair_geometry import permitted_motion
from osc_contact.law.records import SLIDE, body_of
from osc_contact.law.vectors import (
    ZERO_3,
    add3,
    add_square,
    axis3,
    combined,
    cross,
    divided3,
    dot3,
    dot6,
    join,
    linear,
    plus,
    rotated,
    scaled,
    set_identity,
    unpack_pose,
    wrench_to_energy,
)

_LEVER = 0.01  #: m, lever of friction about an axis


@leaf
def has_point(t, column):
    """Determine whether a column of N is a force at a known point of contact.

    Args:
        t: Tick.
        column: index of the column among all columns of the model.
    """
    return t.model.pairs[t.model.columns[column].contact].has_friction != 0


@inner
def across(N, k):
    """Compute column k of the projection 1 − nnᵀ on the tangential plane of a contact.

    It is the part of the world's axis k along the face.

    Args:
        N: (6,) column of N, whose linear part is along the normal n.
        k: axis of the world (0, 1, 2).

    Returns:
        Three numbers, dimensionless.
    """
    n = divided3(N, sqrt(dot3(N, N)))
    return add3(axis3(k), -n[k], n)


@inner
def reading_of_force(t, force, index):
    """Reading of the wrist sensors that a force at one contact causes.

    It is the wrench of the force at C and, if the touched body can move, the inertial force of the
    object that moves with it (`reading_of_wrench`).

    Args:
        t: Tick.
        force: (3,) force at the point of contact, in world axes (N).
        index: index of a column of N of the contact.

    Returns:
        Six numbers: the wrench at C in energy coordinates.
    """
    return reading_of_wrench(t, join(force, cross(t.work.columns[index].point, force)), index)


@inner
def reading_of_wrench(t, f, index):
    """Reading of the wrist sensors that a wrench on one touched body causes.

    It is the wrench f; if the body can move, the inertial force Λ_out N⁺ NᵀΦ_e f is added that the
    object exerts when it moves with the body: NᵀΦ_e f (r,; m/s²) is the acceleration of the body
    along the r kept columns N, Φ_e its inverse inertia, Λ_out the inertia beyond the sensors. Reads
    `moving`, `yields` (rows of NᵀΦ_e at O), and the fields that `add_yield` reads.

    Args:
        t: Tick.
        f: wrench (six numbers) at O, in world axes (N, N m).
        index: index of a column of N of a contact on the body.

    Returns:
        Six numbers: the wrench at C in energy coordinates.
    """
    work = t.work
    reading = wrench_to_energy(work, f)
    if not work.moving:
        return reading
    yield_acceleration = local(6)
    body = body_of(t, index).same
    for a in range(work.rank):  # NᵀΦ_e f
        on_body = body_of(t, work.kept[a]).same == body
        yield_acceleration[a] = dot6(work.yields[a], f) if on_body else 0.0
    return add_yield(work, reading, yield_acceleration)


@inner
def rub_along(t, size, k, c):
    """Reading of the wrist sensors that friction along one permitted motion of a contact causes.

    Friction along an axis (SLIDE) is a force on the point of the object that the pair declares;
    friction about an axis a couple, as of a force with the lever `_LEVER` (m).

    Args:
        t: Tick.
        size: magnitude of the friction force (N).
        k: index of the permitted motion, a column of T of the pair.
        c: index of the contact.

    Returns:
        Six numbers: the wrench at C in energy coordinates.
    """
    X_WE = local(4, 4)
    set_identity(X_WE)
    if t.work.moving:
        unpack_pose(t.input.touched[c], X_WE)
    pair = t.model.pairs[c]
    row = t.model.shapes[pair.shape_at + pair.count + k].row  # behind those of the columns of N
    motion = permitted_motion(row, t.work.X_WO, X_WE)
    if row[6] == SLIDE:
        force = linear(motion)
        f = join(force, cross(rotated(t.work.X_WO, row), force))
    else:
        f = scaled(_LEVER, join(ZERO_3, (motion[3], motion[4], motion[5])))
    return reading_of_wrench(t, scaled(size, f), pair.first)


@inner
def add_rubbing(t, index, size, R):
    """Add the likely friction of a pair without known points of contact to a covariance.

    A friction force of the same size is likely along each of the pair's freedoms, as if its normal
    force were known and its coefficient of friction typical.

    Args:
        t: Tick.
        index: index of a column of N of the pair.
        size: typical magnitude of the friction force (N).
        R: (6, 6) covariance of wrist readings in energy coordinates, changed.
    """
    c = t.model.columns[index].contact
    for k in range(t.model.pairs[c].freedoms):
        add_square(1.0, rub_along(t, size, k, c), R)


@inner
def outboard_times(work, x):
    """Multiply the inertia Λ_out beyond the wrist sensors with a motion, in energy coordinates.

    Args:
        work: WORK, of which `out_T` (Λ_out transposed) is read.
        x: (6,) motion.

    Returns:
        Wrench Λ_out x (six numbers).
    """
    return combined(x, work.out_T, 6)


@inner
def add_yield(work, f, acceleration):
    """Add to f the inertial force of an object that moves with a yielding body: f + Λ_out N⁺ s.

    N⁺s is the acceleration of least kinetic energy with Nᵀa = s, where N (6, r) are the columns of
    contact forces in energy coordinates; with their factors Nᵀ = L Q it is QᵀL⁻¹s. Λ_out (6, 6) is
    the inertia beyond the wrist sensors.

    Args:
        work: WORK, of which `N_factor` L (r, r), `N_basis` Q (r, 6) and `out_T` are read.
        f: wrench (six numbers, energy coordinates).
        acceleration: (r,) s, normal acceleration of the body (m/s²), overwritten.

    Returns:
        Wrench (six numbers, energy coordinates).
    """
    forward(work.N_factor, work.rank, acceleration)
    return plus(f, outboard_times(work, combined(acceleration, work.N_basis, work.rank)))
