"""Can one constraint frame with a compliance selection describe a contact? (paper, section 2)

Raibert and Craig describe a contact by one frame: along or about each of its axes either a force
or a motion is controlled. A space N has such a frame exactly if, with C = {couples: pure couples
in N}, F = {directions of the forces in N} ⊆ R³ and m(u) the moments that go with a force u,

    (i)  the orthogonal projectors on C and F commute (C and F share a triad of axes), and
    (ii) there is a point p with m(u) ≡ p × u (mod C) for every u in F.

The skew lines of fig. 1 violate (ii), the cone in the groove of fig. 2 violates (i).

How *far* N is from the nearest frame is an angle between two spaces of wrenches, so it needs a
length and a point: those of the held object (`size`, `centre`). It cannot do without the point:
seen from far enough away two skew lines of force look like two pure couples, so a continuous
measure that knew no point would be zero for them. The verdict itself needs neither.
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

_VISIBLE = 1e-6
_EYE = np.eye(3)
_SIGNED = [_EYE[:, p] * s for p in permutations(range(3)) for s in product((1.0, -1.0), repeat=3)]
#: (24, 3, 3) the relabellings of a right-handed triad.
_RELABEL = np.array([P for P in _SIGNED if np.linalg.det(P) > 0.0])

Triple = tuple[bool, bool, bool]


@dataclass(frozen=True)
class RaibertCraig:
    """The constraint frame that describes N, or the nearest one; true if it describes N.

    Attributes:
        frame: pose of the constraint frame, world axes, translation from O (m).
        forces: along which of its axes forces are selected.
        couples: about which of its axes couples are selected.
        residual: sine of the largest principal angle between N and the space of the frame, moments
            taken about the object's centre and divided by its size. 0 … 1.
        reason: why N has no constraint frame, in plain words; empty if it has one.

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
        return not self.reason


def selection_columns(frame: SE3, forces: Sequence[bool], couples: Sequence[bool]) -> Array:
    """N (6, r) of a frame: [e_i; p × e_i] where forces[i], then [0; e_i] where couples[i].

    Args:
        frame: its pose in coordinates with origin O and world axes (p = its translation, m).
        forces: three flags, forces along the frame's axes through its origin.
        couples: three flags, couples about the frame's axes.

    Raises:
        InvalidInputError: not three flags.
    """
    chosen = np.concatenate((_flags("forces", forces), _flags("couples", couples)))
    return frame.toDualActionMatrix()[:, chosen]


def as_raibert_craig(
    N: npt.ArrayLike,
    size: float,
    tolerance: float = 1e-9,
    centre: npt.ArrayLike | None = None,
) -> RaibertCraig:
    """Find the constraint frame and compliance selection of N, or the nearest one and why not.

    For every split of r into k forces and r − k couples an explicit frame is built from the k
    strongest force directions; if none describes N, Gauss–Newton steps on the sum of the squared
    sines improve all of them, and the one with the smallest largest sine is returned. (That sine
    bounds the least one from above; for r = 2 … 4 another frame may come some 20 % closer.)

    Args:
        N: (6, r) any basis of the contact normal space, at O, world axes.
        size: a length of the held object (m), which makes moments comparable with forces.
        tolerance: largest residual that still counts as a description.
        centre: (3,) the point of the object, from O (m), about which the residual takes moments;
            default O. With the same point of the object nothing depends on O.

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
    Q, rest = _orthonormal(columns, middle, size)

    triads, points, chosen = explicit(Q)
    sine = sines(triads, points, chosen, rest)
    if sine.min() > tolerance:
        better = refined(triads, points, chosen, rest)
        triads = np.concatenate((triads, better[0]))
        points = np.concatenate((points, better[1]))
        chosen = np.concatenate((chosen, chosen))
        sine = sines(triads, points, chosen, rest)
    best = sine.argmin()

    # axes named so that they are nearest to the world's
    P = _RELABEL[np.einsum("ij,pji->p", triads[best], _RELABEL).argmax()]
    selected = (chosen[best].reshape(2, 3) @ np.abs(P)) > 0.5
    forces, couples = ((bool(x), bool(y), bool(z)) for x, y, z in selected)
    reason = "" if sine[best] <= tolerance else _why(Q, size, tolerance, sum(forces))
    frame = SE3(triads[best] @ P, middle + size * points[best])
    return RaibertCraig(frame, forces, couples, float(sine[best]), reason)


def _flags(name: str, flags: Sequence[bool]) -> Array:
    array = np.asarray(flags)
    if array.shape != (3,) or not all(flag in (0, 1) for flag in array.tolist()):
        raise InvalidInputError(f"{name} = {flags!r}; give three times True or False")
    return array.astype(bool)


def _orthonormal(columns: Array, centre: Array, size: float) -> tuple[Array, ...]:
    """Bases (6, r) of N and (6, 6−r) of its complement, moments about `centre` over `size`."""
    scaled = carry_wrench(columns, np.zeros(3), centre)
    scaled[3:] /= size
    require_independent(scaled, "N")
    U = np.linalg.svd(scaled / np.linalg.norm(scaled, axis=0))[0]
    return tuple(np.split(U, [columns.shape[1]], axis=1))


# Why not ------------------------------------------------------------------------------------------


def _why(Q: Array, size: float, tolerance: float, forces: int) -> str:
    """Which of (i) and (ii) fails, and by how much; `forces` of the nearest frame."""
    r = Q.shape[1]
    U, sigma, Vh = np.linalg.svd(Q[:3])
    k = int((sigma > tolerance).sum())
    F = U[:, :k]
    wrenches = Q @ Vh[:k].T / sigma[:k]
    couples = np.linalg.svd(Q[3:] @ Vh[k:].T)[0]
    beyond_C = couples[:, r - k :] @ couples[:, r - k :].T
    a = axis_of(U, k)
    b = axis_of(couples, r - k)
    angle = 0.0 if a is None or b is None else float(np.arctan2(norm(cross(a, b)), a @ b))
    tilt = abs(np.sin(2.0 * angle))

    system = np.concatenate([-beyond_C @ skew(u) for u in F.T] or [np.zeros((0, 3))])
    moments = beyond_C @ wrenches[3:]
    p = np.linalg.pinv(system, rcond=POINT) @ moments.T.ravel()
    miss = float(np.linalg.norm(moments - beyond_C @ skew(p) @ F, 2)) if k else 0.0
    reasons = []
    if tilt > _VISIBLE or tilt > miss:
        reasons.append(_tilt_in_words(k, r - k, angle))
    if miss > _VISIBLE or miss >= tilt:
        reasons.append(_miss_in_words(F, wrenches[3:], r - k, miss, size))
    if forces != k:
        reasons.append(f"the nearest frame has forces on {forces}, couples on {r - forces} axes")
    return "; ".join(reasons)


def _tilt_in_words(forces: int, couples: int, angle: float) -> str:
    angle = min(angle, np.pi - angle)
    line = "the line of the"
    plane = "the normal of the plane of the"
    return (
        "(i) the couples and the forces have no common triad of axes: "
        f"{line if forces == 1 else plane} forces and {line if couples == 1 else plane} couples "
        f"are {np.rad2deg(angle):.4g}° apart, neither parallel nor perpendicular"
    )


def _miss_in_words(F: Array, moments: Array, couples: int, miss: float, size: float) -> str:
    """Two lines of force by their distance, anything else by the couple the best point leaves."""
    if F.shape[1] == 2 and couples == 0:
        along = F.T @ moments
        low, high = np.linalg.eigvalsh(0.5 * (along + along.T))  # the principal pitches
        apart = 2.0 * float(np.sqrt(max(0.0, -low * high)))
        if apart > _VISIBLE:
            return (
                f"(ii) the lines of force pass {1e3 * size * apart:.4g} mm apart; "
                "no one point lies on both"
            )
    return (
        "(ii) the forces do not act through one point: taken through the best one, a unit force "
        f"still carries a couple of {1e3 * size * miss:.4g} mm"
    )


# Constraint frames that describe a space of wrenches, or nearly do: built, then improved.
#
# Batches of B frames, each a triad of axes E, an origin p and a selection; moments about the
# object's centre, lengths in object sizes.


#: A system for the point p has no more rank than what lies above this, relative to its size.
POINT = 1e-8
_REFINEMENTS = 12
_SKEW = np.array([skew(axis) for axis in _EYE])
#: (6, 6, 6) rates of wrenches carried by the unit twists (3 linear, 3 angular).
_GENERATORS = np.zeros((6, 6, 6))
_GENERATORS[:3, 3:, :3] = _GENERATORS[3:, :3, :3] = _GENERATORS[3:, 3:, 3:] = _SKEW


def explicit(Q: Array) -> tuple[Array, Array, Array]:
    """One frame per split and mutual position of F and C: triads (B, 3, 3), points, selections.

    F of dimension k = 1 or 2 is known by its axis a (its line, its normal), C by its axis b. They
    share a triad in two ways only: a ∥ b or a ⊥ b. The nearest such pair of axes spans the triad,
    and p solves (ii) in that triad, each force weighted by its share in a unit wrench.
    """
    r = Q.shape[1]
    U, _, Vh = np.linalg.svd(Q[:3])
    frames = []
    for k in range(max(0, r - 3), min(3, r) + 1):
        a = axis_of(U, k)
        b = axis_of(np.linalg.svd(Q[3:] @ Vh[k:].T)[0], r - k)
        padded = np.zeros((6, 3))
        padded[:, :k] = Q @ Vh[:k].T
        for upright in (False, True) if a is not None and b is not None else (False,):
            selection = _pattern(k, 0) + _pattern(r - k, int(upright))
            frames.append((_triad(a, b, upright), selection, padded))
    E, chosen, W = map(np.array, zip(*frames, strict=True))

    E_T = E.transpose(0, 2, 1)
    force = np.where(chosen[:, :3, None], E_T @ W[:, :3], 0.0)
    moment = E_T @ W[:, 3:]
    system = -np.einsum("lij,blk->bkij", _SKEW, force)  # p × f = −[f]× p
    system = np.where(chosen[:, None, 3:, None], 0.0, system).reshape(-1, 9, 3)
    right = moment.transpose(0, 2, 1).reshape(-1, 9, 1)
    # an absolute limit: a wrench whose force is rounding does not determine p
    reach = np.maximum(np.linalg.norm(system, axis=(1, 2)), POINT)
    p = E @ np.linalg.pinv(system, rcond=POINT / reach) @ right
    return (E, p[:, :, 0], chosen)


def axis_of(U: Array, dimension: int) -> Array | None:
    """The line or the normal of the space of the first `dimension` columns of U (3, 3)."""
    return {1: U[:, 0], 2: U[:, 2]}.get(dimension)


def _pattern(dimension: int, axis: int) -> list[bool]:
    return [dimension == 3 or (dimension > 0 and (dimension == 1) == (i == axis)) for i in range(3)]


def _triad(a: Array | None, b: Array | None, upright: bool) -> Array:
    """Right-handed triad (3, 3): x near a and b, or (upright) x near a and y near b."""
    if upright and a is not None and b is not None:
        left, _, right = np.linalg.svd(np.column_stack((a, b)), full_matrices=False)
        x, y = (left @ right).T
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


def _space(E: Array, p: Array, chosen: Array) -> Array:
    """Orthonormal bases (B, 6, r) of what the frames describe."""
    full = np.zeros((len(E), 6, 6))
    full[:, :3, :3] = full[:, 3:, 3:] = E
    full[:, 3:, :3] = np.einsum("bl,lij,bjk->bik", p, _SKEW, E)
    r = int(chosen[0].sum())
    columns = np.nonzero(chosen)[1].reshape(len(E), 1, r)
    return np.linalg.qr(np.take_along_axis(full, columns, axis=2))[0]


def sines(E: Array, p: Array, chosen: Array, rest: Array) -> Array:
    """(B,) sines of the largest principal angles between N and the spaces of the frames.

    Args:
        E: (B, 3, 3) triads. p: (B, 3) their origins (m). chosen: (B, 6) selected axes.
        rest: (6, 6−r) orthonormal complement of N.
    """
    across = rest.T @ _space(E, p, chosen)
    return np.linalg.svd(across, compute_uv=False).max(axis=1, initial=0.0)


def refined(E: Array, p: Array, chosen: Array, rest: Array) -> tuple[Array, Array]:
    """Damped Gauss–Newton steps of every frame (a twist each) on ‖restᵀ S‖², S orthonormal.

    A twist carries S by dS = G S; only the part across S turns the space, so the sines change by
    restᵀ(1 − SSᵀ)GS.

    Args:
        E, p, chosen, rest: as in `sines`.
    """
    damping = np.full(len(E), 1e-3)
    E = E.copy()
    p = p.copy()
    S = _space(E, p, chosen)
    across = rest.T @ S
    for _ in range(_REFINEMENTS):
        moved = _GENERATORS @ S[:, None]
        turned = rest.T @ moved - across[:, None] @ (S.transpose(0, 2, 1)[:, None] @ moved)
        J = turned.reshape(len(E), 6, -1)
        gradient = J @ across.reshape(len(E), -1, 1)
        normal = J @ J.transpose(0, 2, 1) + damping[:, None, None] * np.eye(6)
        step = -np.linalg.solve(normal, gradient)[:, :, 0]
        half = 0.5 * np.einsum("bl,lij->bij", step[:, 3:], _SKEW)
        turn = np.linalg.solve(_EYE - half, _EYE + half)  # Cayley: a rotation
        new_E = turn @ E
        new_p = (turn @ p[:, :, None])[:, :, 0] + step[:, :3]
        new_S = _space(new_E, new_p, chosen)
        new_across = rest.T @ new_S
        better = (new_across**2).sum(axis=(1, 2)) < (across**2).sum(axis=(1, 2))
        E[better] = new_E[better]
        p[better] = new_p[better]
        S[better] = new_S[better]
        across[better] = new_across[better]
        damping = np.where(better, 0.2 * damping, 10.0 * damping)
    return (E, p)
