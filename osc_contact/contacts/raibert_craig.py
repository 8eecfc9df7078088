"""Constraint frame and compliance selection of a contact, if they exist (paper, section 2).

Raibert and Craig describe a contact by one frame: along or about each of its axes either a force
or a motion is controlled. A space N has such a frame if and only if, with the space C of the pure
couples in N, the space F ⊆ R³ of the directions of the forces in N and the moments m(u) of a force
u,

    (i)  the orthogonal projectors on C and F commute (C and F share a triad of axes), and
    (ii) there is a point p with m(u) ≡ p × u (mod C) for every u in F.

The skew lines of fig. 1 violate (ii), the cone in the groove of fig. 2 violates (i).

The *distance* of N from the nearest frame is an angle between two spaces of wrenches, which depends
on a length and a point: those of the held object (`size`, `centre`). The point is necessary: about
a distant point the moments of two skew lines of force are nearly those of two pure couples, so a
continuous measure without a point would be zero for them. The existence of a frame depends on
neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
import numpy.typing as npt
from pinocchio import SE3

from osc_contact.errors import InvalidInputError
from osc_contact.projections import require_independent
from osc_contact.spatial import Array, as_array, carry_wrench, cross, norm, skew

_LEAST_REPORTED = 1e-6  #: least sine of an angle, or share of the object's size, that is reported
_EYE = np.eye(3)
#: 48 permutations of the axes with all combinations of signs
_SIGNED = [_EYE[:, p] * s for p in permutations(range(3)) for s in product((1.0, -1.0), repeat=3)]
#: (24, 3, 3) permutations and reversals of axes that keep a triad right-handed
_RIGHT_HANDED_RELABELLINGS = np.array([P for P in _SIGNED if np.linalg.det(P) > 0.0])

Triple = tuple[bool, bool, bool]  #: flags of the three axes of a frame


@dataclass(frozen=True)
class RaibertCraig:
    """Constraint frame and selection that describe a space N of forces, or the nearest ones.

    As a condition it is true if they describe N.

    Attributes:
        frame: pose of the constraint frame, world axes, translation from O (m).
        forces: flags of the axes along which forces are selected.
        couples: flags of the axes about which couples are selected.
        residual: sine (0 … 1) of the largest principal angle between N and the space of the frame,
            with moments about the object's centre divided by its size.
        reason: sentence on the violated condition; empty if N has a constraint frame.

    Example:
        >>> press_and_hold = osc.Contact(np.eye(6)[:, [2, 3]])  # force along z, couple about x
        >>> frame = press_and_hold.as_raibert_craig()
        >>> print(bool(frame), sum(frame.forces), sum(frame.couples))
        True 1 1
    """

    frame: SE3
    forces: Triple
    couples: Triple
    residual: float
    reason: str

    def __bool__(self) -> bool:
        """True if the frame and the selection describe N."""
        return not self.reason


def selection_columns(frame: SE3, forces: Sequence[bool], couples: Sequence[bool]) -> Array:
    """Compute N (6, r) of a selection: [e_i; p × e_i] for each force, [0; e_i] for each couple.

    Args:
        frame: pose of the frame, world axes, translation p from O (m).
        forces: three flags of forces along the frame's axes through its origin.
        couples: three flags of couples about the frame's axes.

    Raises:
        InvalidInputError: not three flags.
    """
    flags = np.concatenate((_checked_flags("forces", forces), _checked_flags("couples", couples)))
    return frame.toDualActionMatrix()[:, flags]


def as_raibert_craig(
    N: npt.ArrayLike,
    size: float,
    tolerance: float = 1e-9,
    centre: npt.ArrayLike | None = None,
) -> RaibertCraig:
    """Find the constraint frame and compliance selection of N, or the nearest ones and the reason.

    For every split of r into k forces and r − k couples an explicit frame is computed from the k
    strongest force directions; if none describes N, Gauss–Newton steps on the sum of the squared
    sines improve all of them, and the one with the smallest largest sine is returned. (That sine
    is an upper bound of the least one; for r = 2 … 4 another frame may be some 20 % closer.)

    Args:
        N: (6, r) any basis of the contact normal space, at O, world axes.
        size: length of the held object by which moments are divided (m).
        tolerance: largest residual of a frame that describes N.
        centre: (3,) point of the object about which the residual takes moments, from O (m); None:
            O. For a fixed point of the object the result is independent of O.

    Raises:
        InvalidInputError: wrong shape, non-finite numbers, size or tolerance out of range.
        ContactError: dependent or zero columns.
    """
    columns = as_array("N", N, (6, None))
    if not (np.isfinite(size) and size > 0.0):
        raise InvalidInputError(f"size = {size}; give the object's length > 0 m")
    if not 0.0 < tolerance < 1.0:
        raise InvalidInputError(f"tolerance = {tolerance}; give a sine between 0 and 1")
    middle = np.zeros(3) if centre is None else as_array("centre", centre, (3,))
    Q, complement = _orthonormal_bases(columns, middle, size)

    triads, points, flags = explicit(Q)
    sine = sines(triads, points, flags, complement)
    if sine.min() > tolerance:
        refined_triads, refined_points = refined(triads, points, flags, complement)
        triads = np.concatenate((triads, refined_triads))
        points = np.concatenate((points, refined_points))
        flags = np.concatenate((flags, flags))
        sine = sines(triads, points, flags, complement)
    i_best = sine.argmin()

    # order and signs of the axes: the largest trace of E P, nearest to the world's axes
    P = _RIGHT_HANDED_RELABELLINGS[
        np.einsum("ij,pji->p", triads[i_best], _RIGHT_HANDED_RELABELLINGS).argmax()
    ]
    axis_flags = (flags[i_best].reshape(2, 3) @ np.abs(P)) > 0.5
    forces, couples = ((bool(x), bool(y), bool(z)) for x, y, z in axis_flags)
    is_described = sine[i_best] <= tolerance
    reason = "" if is_described else _violation_in_words(Q, size, tolerance, sum(forces))
    frame = SE3(triads[i_best] @ P, middle + size * points[i_best])
    return RaibertCraig(frame, forces, couples, float(sine[i_best]), reason)


def _checked_flags(name: str, flags: Sequence[bool]) -> Array:
    """Check three flags; return them as an array (3,).

    Args:
        name: name of the argument, for the message.
        flags: three times True or False.

    Raises:
        InvalidInputError: not three flags.
    """
    array = np.asarray(flags)
    if array.shape != (3,) or not all(flag in (0, 1) for flag in array.tolist()):
        raise InvalidInputError(f"{name} = {flags!r}; give three times True or False")
    return array.astype(bool)


def _orthonormal_bases(columns: Array, centre: Array, size: float) -> tuple[Array, ...]:
    """Compute orthonormal bases (6, r) of N and (6, 6−r) of its complement.

    Orthonormal refers to wrenches with moments about the object's centre, divided by its size.

    Args:
        columns: (6, r) basis of N at O.
        centre: (3,) point about which moments are taken, from O (m).
        size: length of the object by which moments are divided (m).

    Raises:
        ContactError: dependent or zero columns.
    """
    wrenches = carry_wrench(columns, np.zeros(3), centre)
    wrenches[3:] /= size
    require_independent(wrenches, "N")
    U = np.linalg.svd(wrenches / np.linalg.norm(wrenches, axis=0))[0]
    return tuple(np.split(U, [columns.shape[1]], axis=1))


# Reasons why no frame describes a space -----------------------------------------------------------


def _violation_in_words(Q: Array, size: float, tolerance: float, forces: int) -> str:
    """Sentence on the conditions that N violates so that no constraint frame describes it.

    F is the space of the directions of the forces in N, k its dimension; C is the space of the pure
    couples in N; m(u) is the moment of a force u. A frame describes N if and only if

        (i)  F and C share a triad of axes, and
        (ii) there is a point p with m(u) − p × u in C for every u in F.

    Args:
        Q: (6, r) orthonormal basis of N, moments about the centre divided by the object's size.
        size: length of the object by which moments are divided (m).
        tolerance: largest residual of a frame that describes N.
        forces: number of forces that the nearest frame selects.

    Returns:
        Sentence with the amount of each violation; a condition violated by rounding errors only is
        left out unless it is the larger violation.
    """
    # Singular values of the force part are the strengths of the forces. The k combinations of
    # columns with a force span F, the others have only couples and span C.
    r = Q.shape[1]
    U, sigma, Vh = np.linalg.svd(Q[:3])
    k = int((sigma > tolerance).sum())
    F = U[:, :k]
    moments = (Q @ Vh[:k].T / sigma[:k])[3:]  # (3, k) m(u) of the unit forces u in F
    U_C = np.linalg.svd(Q[3:] @ Vh[k:].T)[0]  # the first r − k columns span C

    # (i) holds if the axes of F and C are parallel or perpendicular, so that sin(2 angle) = 0
    a = axis_of(U, k)
    b = axis_of(U_C, r - k)
    angle = 0.0 if a is None or b is None else float(np.arctan2(norm(cross(a, b)), a @ b))
    tilt = abs(np.sin(2.0 * angle))
    miss = _couple_about_best_point(F, moments, U_C[:, r - k :])

    reasons = []
    if tilt > _LEAST_REPORTED or tilt > miss:
        reasons.append(_tilt_in_words(k, r - k, angle))
    if miss > _LEAST_REPORTED or miss >= tilt:
        reasons.append(_miss_in_words(F, moments, r - k, miss, size))
    if forces != k:
        reasons.append(f"the nearest frame has forces on {forces}, couples on {r - forces} axes")
    return "; ".join(reasons)


def _couple_about_best_point(F: Array, moments: Array, complement_of_C: Array) -> float:
    """Largest couple that remains of a unit force if forces are taken through the best point p.

    If all forces act through one point p, the moment m(u) of a force u in F is p × u and a couple
    in the space C. Otherwise a part of m(u) − p × u outside C remains; the best p makes its sum of
    squares over orthonormal u least.

    Args:
        F: (3, k) orthonormal directions of the forces.
        moments: (3, k) moments m(u) of these about the centre, divided by the object's size.
        complement_of_C: (3, 3 − c) orthonormal basis of the complement of C, with c its dimension.

    Returns:
        Couple, divided by the object's size; 0 without forces.
    """
    projector = complement_of_C @ complement_of_C.T
    # equations projector (p × u) = projector m(u) for each u, with p × u = −[u]× p
    system = np.concatenate([-projector @ skew(u) for u in F.T] or [np.zeros((0, 3))])
    right_side = projector @ moments
    p = np.linalg.pinv(system, rcond=POINT) @ right_side.T.ravel()
    if F.shape[1] == 0:
        return 0.0
    return float(np.linalg.norm(right_side - projector @ skew(p) @ F, 2))


def _tilt_in_words(forces: int, couples: int, angle: float) -> str:
    """Sentence on a violation of condition (i): no triad of axes is common to forces and couples.

    Args:
        forces: dimension of the space F of the directions of forces, 1 (a line) or 2 (a plane).
        couples: dimension of the space C of pure couples, 1 or 2.
        angle: angle between the axes of F and C, each along the line or normal to the plane,
            0 … π (rad).
    """
    angle = min(angle, np.pi - angle)
    line = "the line of the"
    plane = "the normal of the plane of the"
    return (
        "(i) the couples and the forces have no common triad of axes: "
        f"{line if forces == 1 else plane} forces and {line if couples == 1 else plane} couples "
        f"are {np.rad2deg(angle):.4g}° apart, neither parallel nor perpendicular"
    )


def _miss_in_words(F: Array, moments: Array, couples: int, miss: float, size: float) -> str:
    """Sentence on a violation of condition (ii): the forces do not act through one point.

    It states the distance of the two lines of force if there are two, else the remaining couple.

    Args:
        F: (3, k) orthonormal directions of the forces.
        moments: (3, k) moments of these forces about the centre, divided by the object's size.
        couples: dimension of the space C of couples.
        miss: couple of a unit force about the best point, divided by the object's size.
        size: length of the object (m).
    """
    if F.shape[1] == 2 and couples == 0:
        # the principal pitches low < 0 < high of the two-system of screws; the lines without pitch
        # are 2 √(−low·high) apart
        moments_along = F.T @ moments
        low, high = np.linalg.eigvalsh(0.5 * (moments_along + moments_along.T))
        offset = 2.0 * float(np.sqrt(max(0.0, -low * high)))
        if offset > _LEAST_REPORTED:
            return (
                f"(ii) the lines of force pass {1e3 * size * offset:.4g} mm apart; "
                "no one point lies on both"
            )
    return (
        "(ii) the forces do not act through one point: taken through the best one, a unit force "
        f"still carries a couple of {1e3 * size * miss:.4g} mm"
    )


# Explicit constraint frames that describe a space of wrenches approximately, and their refinement.
#
# Arrays have B frames, each a triad of axes E, an origin p and a selection; moments are about the
# object's centre, lengths are divided by the object's size.


#: Least singular value, relative to the largest, in the rank of the equations of p.
POINT = 1e-8
_REFINEMENTS = 12  #: number of Gauss–Newton steps
_SKEW = np.array([skew(axis) for axis in _EYE])  #: (3, 3, 3) [e_i]×
#: (6, 6, 6) rates of wrenches that are fixed to bodies with unit twists (3 linear, 3 angular).
_GENERATORS = np.zeros((6, 6, 6))
_GENERATORS[:3, 3:, :3] = _GENERATORS[3:, :3, :3] = _GENERATORS[3:, 3:, 3:] = _SKEW


def explicit(Q: Array) -> tuple[Array, Array, Array]:
    """Compute a frame for each split into forces and couples, and each relation of F and C.

    F of dimension k = 1 or 2 has an axis a (its line, or its normal), and C an axis b. They share
    a triad if a ∥ b or a ⊥ b. The nearest such pair of axes spans the triad, and p solves (ii) in
    that triad, with each force weighted by its share of a unit wrench.

    Args:
        Q: (6, r) orthonormal basis of N, moments about the centre divided by the object's size.

    Returns:
        Triads (B, 3, 3), origins (B, 3) divided by the object's size, and selections (B, 6) of
        forces, then couples.
    """
    r = Q.shape[1]
    U, _, Vh = np.linalg.svd(Q[:3])
    frames = []
    for k in range(max(0, r - 3), min(3, r) + 1):
        a = axis_of(U, k)
        b = axis_of(np.linalg.svd(Q[3:] @ Vh[k:].T)[0], r - k)
        wrenches = np.zeros((6, 3))  # the k strongest forces, padded with zeros
        wrenches[:, :k] = Q @ Vh[:k].T
        perpendicular = (False,) if a is None or b is None else (False, True)
        for upright in perpendicular:
            selection = _selection_of(k, 0) + _selection_of(r - k, int(upright))
            frames.append((_nearest_triad(a, b, upright), selection, wrenches))
    E, chosen, W = map(np.array, zip(*frames, strict=True))

    # equations p × f = m in the axes of each triad, for its selected forces, without the moments
    # about axes with a selected couple
    E_T = E.transpose(0, 2, 1)
    force = np.where(chosen[:, :3, None], E_T @ W[:, :3], 0.0)
    moment = E_T @ W[:, 3:]
    system = -np.einsum("lij,blk->bkij", _SKEW, force)  # p × f = −[f]× p
    system = np.where(chosen[:, None, 3:, None], 0.0, system).reshape(-1, 9, 3)
    right_side = moment.transpose(0, 2, 1).reshape(-1, 9, 1)
    # the limit is absolute, since a force that is a rounding error does not determine p
    reach = np.maximum(np.linalg.norm(system, axis=(1, 2)), POINT)
    p = E @ np.linalg.pinv(system, rcond=POINT / reach) @ right_side
    return (E, p[:, :, 0], chosen)


def axis_of(U: Array, dimension: int) -> Array | None:
    """Axis (3,) of the space that the first `dimension` columns of an orthogonal U (3, 3) span.

    It is the direction of a line (dimension 1), the normal of a plane (dimension 2), or None for
    the dimensions 0 and 3.
    """
    if dimension == 1:
        return U[:, 0]
    if dimension == 2:
        return U[:, 2]
    return None


def _selection_of(dimension: int, axis: int) -> list[bool]:
    """Selection (3 flags) of the axes of a triad that span a space of directions.

    Args:
        dimension: dimension of the space, 0 … 3.
        axis: index of the triad's axis along a line, or normal to a plane.
    """
    if dimension == 1:
        return [i == axis for i in range(3)]
    if dimension == 2:
        return [i != axis for i in range(3)]
    return [dimension == 3] * 3


def _nearest_triad(a: Array | None, b: Array | None, upright: bool) -> Array:
    """Compute the right-handed triad (3, 3) nearest to the axes of forces and couples.

    Args:
        a, b: (3,) unit vectors along the axes of F and C; None: F or C has no axis.
        upright: True: x is near a and y near b; False: x is near both.
    """
    if upright and a is not None and b is not None:
        # polar decomposition: the nearest pair of perpendicular unit vectors
        U, _, Vh = np.linalg.svd(np.column_stack((a, b)), full_matrices=False)
        x, y = (U @ Vh).T
    elif a is None and b is None:
        x, y, _ = _EYE
    else:
        x = np.zeros(3) if a is None else a
        if b is not None:
            x = x + (b if x @ b >= 0.0 else -b)
        x = x / norm(x)
        y = cross(x, _EYE[np.abs(x).argmin()])
        y = y / norm(y)
    return np.column_stack((x, y, cross(x, y)))


def _force_spaces(E: Array, p: Array, chosen: Array) -> Array:
    """Compute orthonormal bases (B, 6, r) of the force spaces of B Raibert–Craig frames.

    Args:
        E: (B, 3, 3) axes of the frames.
        p: (B, 3) origins of the frames from the centre, divided by the object's size.
        chosen: (B, 6) selected forces, then selected couples; r in each row.
    """
    # columns [e_i; p × e_i] of unit forces, then [0; e_i] of unit couples
    full = np.zeros((len(E), 6, 6))
    full[:, :3, :3] = full[:, 3:, 3:] = E
    full[:, 3:, :3] = np.einsum("bl,lij,bjk->bik", p, _SKEW, E)
    # each frame selects r columns, whose indices nonzero lists frame by frame
    r = int(chosen[0].sum())
    columns = np.nonzero(chosen)[1].reshape(len(E), 1, r)
    return np.linalg.qr(np.take_along_axis(full, columns, axis=2))[0]


def sines(E: Array, p: Array, chosen: Array, complement: Array) -> Array:
    """Compute the sine (B,) of the largest principal angle between N and each frame's force space.

    Args:
        E: (B, 3, 3) triads.
        p: (B, 3) origins from the centre, divided by the object's size.
        chosen: (B, 6) selected forces, then selected couples.
        complement: (6, 6−r) orthonormal basis of the complement of N.
    """
    residual = complement.T @ _force_spaces(E, p, chosen)
    return np.linalg.svd(residual, compute_uv=False).max(axis=1, initial=0.0)


def refined(E: Array, p: Array, chosen: Array, complement: Array) -> tuple[Array, Array]:
    """Improve frames by damped Gauss–Newton steps on ‖restᵀ S‖², S an orthonormal basis (6, r).

    A step is a twist with the generator G, by which S changes as dS = G S. Only the part orthogonal
    to S changes the space, so the sines change by restᵀ(1 − SSᵀ)GS.

    Args:
        E: (B, 3, 3) triads.
        p: (B, 3) origins from the centre, divided by the object's size.
        chosen: (B, 6) selected forces, then selected couples, whose wrenches span S.
        complement: (6, 6−r) orthonormal basis of the complement of N, which S is to approximate.

    Returns:
        Triads (B, 3, 3) and origins (B, 3) after the steps.
    """
    damping = np.full(len(E), 1e-3)
    E = E.copy()
    p = p.copy()
    S = _force_spaces(E, p, chosen)
    residual = complement.T @ S  # (B, 6−r, r) residual, zero if S is N
    for _ in range(_REFINEMENTS):
        # Jacobian (B, 6, (6−r) r): change of the residual by each unit twist
        GS = _GENERATORS @ S[:, None]
        rates = complement.T @ GS - residual[:, None] @ (S.transpose(0, 2, 1)[:, None] @ GS)
        J = rates.reshape(len(E), 6, -1)
        gradient = J @ residual.reshape(len(E), -1, 1)
        normal = J @ J.transpose(0, 2, 1) + damping[:, None, None] * np.eye(6)
        step = -np.linalg.solve(normal, gradient)[:, :, 0]
        half = 0.5 * np.einsum("bl,lij->bij", step[:, 3:], _SKEW)
        turn = np.linalg.solve(_EYE - half, _EYE + half)  # rotation matrix by Cayley's formula
        # accept steps of those frames that become better
        new_E = turn @ E
        new_p = (turn @ p[:, :, None])[:, :, 0] + step[:, :3]
        new_S = _force_spaces(new_E, new_p, chosen)
        new_across = complement.T @ new_S
        is_better = (new_across**2).sum(axis=(1, 2)) < (residual**2).sum(axis=(1, 2))
        E[is_better] = new_E[is_better]
        p[is_better] = new_p[is_better]
        S[is_better] = new_S[is_better]
        residual[is_better] = new_across[is_better]
        damping = np.where(is_better, 0.2 * damping, 10.0 * damping)
    return (E, p)
