"""Constraint frames that describe a space of wrenches, or nearly do: built, then improved.

Batches of B frames, each a triad of axes E, an origin p and a selection; moments about the object's
centre, lengths in object sizes.
"""

from __future__ import annotations

import numpy as np

from osc_contact.spatial import Array, cross, skew

__all__ = ["POINT", "axis_of", "explicit", "refined", "sines"]

#: A system for the point p has no more rank than what lies above this, relative to its size.
POINT = 1e-8
_REFINEMENTS = 12
_EYE = np.eye(3)
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
    triads = []
    selections = []
    wrenches = []
    for k in range(max(0, r - 3), min(3, r) + 1):
        a = axis_of(U, k)
        b = axis_of(np.linalg.svd(Q[3:] @ Vh[k:].T)[0], r - k)
        padded = np.zeros((6, 3))
        padded[:, :k] = Q @ Vh[:k].T
        for upright in (False, True) if a is not None and b is not None else (False,):
            triads.append(_triad(a, b, upright))
            selections.append(_pattern(k, 0) + _pattern(r - k, int(upright)))
            wrenches.append(padded)
    E = np.array(triads)
    chosen = np.array(selections)
    W = np.array(wrenches)

    E_T = E.transpose(0, 2, 1)
    force = np.where(chosen[:, :3, None], E_T @ W[:, :3], 0.0)
    moment = E_T @ W[:, 3:]
    system = -np.einsum("lij,blk->bkij", _SKEW, force)  # p × f = −[f]× p
    system = np.where(chosen[:, None, 3:, None], 0.0, system).reshape(-1, 9, 3)
    right = moment.transpose(0, 2, 1).reshape(-1, 9, 1)
    # an absolute limit: a wrench whose force is rounding does not determine p
    reach = np.maximum(np.linalg.norm(system, axis=(1, 2)), POINT)
    p = E @ np.linalg.pinv(system, rcond=POINT / reach) @ right
    return E, p[:, :, 0], chosen


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
        return np.column_stack((x, y, cross(x, y)))
    if a is None and b is None:
        return _EYE
    x = np.zeros(3) if a is None else a
    if b is not None:
        x = x + (b if x @ b >= 0.0 else -b)
    x = x / np.linalg.norm(x)
    y = cross(x, _EYE[int(np.abs(x).argmin())])
    y = y / np.linalg.norm(y)
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
    return np.asarray(np.linalg.svd(across, compute_uv=False).max(axis=1, initial=0.0))


def refined(E: Array, p: Array, chosen: Array, rest: Array) -> tuple[Array, Array]:
    """Damped Gauss–Newton steps of every frame (a twist each) on ‖restᵀ S‖², S orthonormal.

    A twist carries S by dS = G S; only the part across S turns the space, so the sines change by
    restᵀ(1 − SSᵀ)GS.

    Args:
        E, p, chosen, rest: as in `sines`.
    """
    damping = np.full(len(E), 1e-3)
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
        pick = better[:, None, None]
        E = np.where(pick, new_E, E)
        p = np.where(better[:, None], new_p, p)
        S = np.where(pick, new_S, S)
        across = np.where(pick, new_across, across)
        damping = np.where(better, 0.2 * damping, 10.0 * damping)
    return E, p
