"""The part of a motion error that could be removed: what arms can make and contacts permit."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.chain_model import columns_at
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.spatial import Array, Poses, cross

__all__ = ["free_part", "free_parts"]

_SURE = 1e-4  #: ranks are plain where columns this long are left of their like, relative
_SAME = 1e-6  #: singular values below this, relative, count as zero


def free_part(chain: ClosedChain, q: Array, X_WO: pin.SE3, N: Array, x: Array) -> Array:
    """The part of a small displacement x (6,) at O in range(S) ∩ T, cut in the object's metric.

    For d = 6 this is Ω_m(Λ_o⁻¹) x. For fewer motions that projection would answer the yielding of
    a contact, a displacement along N, with turns that the arms cannot make. Computed in coordinates
    in which the object's inertia is the identity.

    Args:
        chain: of the arms. q: (n,) joint positions. X_WO: pose of the object.
        N: (6, r) lines of force in contact. x: (6,) displacement at O (m, rad).
    """
    L = np.linalg.cholesky(chain.reference_inertia(X_WO))
    pin.computeJointJacobians(chain.model, chain.data, q)
    J = L.T @ columns_at(chain.data.J, X_WO.translation)
    slips = [
        L.T @ grasp.motions_at(X_WT, X_WO.translation)
        for grasp, X_WT in zip(chain.grasps, chain.tip_poses(), strict=True)
    ]
    locked = np.hstack(
        [_outside(np.hstack((J[:, arm], T))) for arm, T in zip(chain.slices, slips, strict=True)]
    )
    S = _outside(locked) if locked.shape[1] else np.eye(6)
    e, N_S = S.T @ (L.T @ x), S.T @ np.linalg.solve(L, N)
    e = e - N_S @ np.linalg.lstsq(N_S, e, rcond=None)[0]
    return np.asarray(np.linalg.solve(L.T, S @ e))


def _outside(columns: Array) -> Array:
    """Orthonormal complement of the range of (6, k)."""
    U, s, _ = np.linalg.svd(columns)
    return U[:, int(np.count_nonzero(s > _SAME * s[0])) :]


def free_parts(chain: ClosedChain, q: Array, J: Array, X_WO: Poses, N: Array, x: Array) -> Array:
    """`free_part` (6, k) at k instants, worked out together where the ranks are plain.

    Args:
        chain: of the arms. q: (k, n). J: (6, n, k) the joints' columns there, at the world's
            origin. X_WO: k poses. N: (6, r, k). x: (6, k).
    """
    L = np.linalg.cholesky(chain.reference_inertia(pin.SE3.Identity()))  # in the object's axes

    def whiten(motions: Array) -> Array:
        own = np.concatenate((X_WO.rotate_back(motions[:3]), X_WO.rotate_back(motions[3:])))
        return np.tensordot(L.T, own, 1)

    J = whiten(np.concatenate((J[:3] + cross(J[3:], X_WO.p[:, None]), J[3:])))
    locked, plain = _locked([J[:, arm] for arm in chain.slices])
    plain &= all(grasp.is_rigid for grasp in chain.grasps)
    e, lines = whiten(x), np.concatenate((X_WO.rotate_back(N[:3]), X_WO.rotate_back(N[3:])))
    basis = list(locked)
    for line in np.tensordot(np.linalg.inv(L), lines, 1).transpose(1, 0, 2):
        left, whole = line, _length(line)
        for _ in range(2):  # once more for what rounding left
            for b in basis:
                left = left - b * (b * left).sum(axis=0)
        plain &= _length(left) > _SURE * whole
        basis.append(left / np.where(plain, _length(left), 1.0))
    for b in basis:
        e = e - b * (b * e).sum(axis=0)
    own = np.tensordot(np.linalg.inv(L.T), e, 1)
    parts = np.concatenate((X_WO.rotate(own[:3]), X_WO.rotate(own[3:])))
    for i in np.flatnonzero(~plain).tolist():
        parts[:, i] = free_part(chain, q[i], X_WO[i], N[:, :, i], x[:, i])
    return parts


def _locked(arms: list[Array]) -> tuple[Array, Array]:
    """(m, 6, k) orthonormal directions that some arm locks, or zeros; (k,) whether that is plain.

    Args:
        arms: (6, n_i, k) the columns of each, whitened.
    """
    k = arms[0].shape[2]
    plain = np.ones(k, dtype=bool)
    locked = []
    for columns in arms:
        if columns.shape[1] > 5:  # whether these span all motions takes singular values
            return np.zeros((0, 6, k)), ~plain
        directions, clear = _complement(columns)
        locked.append(directions)
        plain &= clear
    if len(locked) == 1:
        return locked[0], plain
    if [len(directions) for directions in locked] != [1, 1]:
        return np.zeros((0, 6, k)), plain & False
    a, b = locked[0][0], locked[1][0]  # the same direction up to sign, or two
    b = b * np.where((a * b).sum(axis=0) < 0.0, -1.0, 1.0)
    mean, apart = a + b, a - b
    ratio = _length(apart) / _length(mean)
    plain &= (ratio < 0.5 * _SAME) | (ratio > 2.0 * _SAME)
    scale = np.where(ratio > _SAME, 1.0 / np.maximum(_length(apart), 1e-300), 0.0)
    return np.stack((mean / _length(mean), apart * scale)), plain


def _complement(columns: Array) -> tuple[Array, Array]:
    """(6 − n, 6, k) orthonormal complement of columns (6, n, k), n ≤ 5, by reflections.

    And (k,) whether the columns are independent without doubt.
    """
    n, k = columns.shape[1:]
    rest = list(columns.transpose(1, 0, 2))
    mirrors: list[tuple[Array, Array]] = []
    sizes = np.empty((n, k))
    for j in range(n):
        v = rest[j].copy()
        v[:j] = 0.0
        sizes[j] = _length(v)
        v[j] += np.copysign(sizes[j], v[j])
        mirrors.append((v, 2.0 / np.maximum((v * v).sum(axis=0), 1e-300)))
        rest = rest[: j + 1] + [_mirrored(*mirrors[j], x) for x in rest[j + 1 :]]
    out = np.zeros((6 - n, 6, k))
    for i, direction in enumerate(out):
        direction[n + i] = 1.0
        for mirror in reversed(mirrors):
            direction[:] = _mirrored(*mirror, direction)
    return out, sizes.min(axis=0) > _SURE * sizes.max(axis=0)


def _mirrored(v: Array, factor: Array, x: Array) -> Array:
    return x - v * (factor * (v * x).sum(axis=0))


def _length(x: Array) -> Array:
    return np.asarray(np.sqrt((x * x).sum(axis=0)))
