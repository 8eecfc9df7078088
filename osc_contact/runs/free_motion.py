"""The part of a motion error that could be removed: what arms can make and contacts permit."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.spatial import Array, Poses, cross

_SAME = 1e-6  #: of directions of unit length, what counts as none


def free_parts(chain: ClosedChain, q: Array, J: Array, X_WO: Poses, N: Array, x: Array) -> Array:
    """The part in range(S) ∩ T of small displacements x at O, cut in the object's metric: (6, k).

    For d = 6 this is Ω_m(Λ_o⁻¹) x. For fewer motions that projection would answer the yielding of
    a contact, a displacement along N, with turns that the arms cannot make. Computed in coordinates
    in which the object's inertia is the identity.

    Args:
        chain: of the arms. q: (k, n) joint positions. J: (6, n, k) the joints' columns there, at
            the world's origin. X_WO: k poses. N: (6, r, k) lines of force in contact.
        x: (6, k) displacements at O (m, rad).
    """
    L = np.linalg.cholesky(chain.reference_inertia(pin.SE3.Identity()))  # in the object's axes

    def in_object(columns: Array) -> Array:
        return np.concatenate((X_WO.rotate_back(columns[:3]), X_WO.rotate_back(columns[3:])))

    def whitened(motions: Array) -> Array:
        return np.tensordot(L.T, in_object(motions), 1)

    J = np.concatenate((J[:3] + cross(J[3:], X_WO.p[:, None]), J[3:]))
    outside = [np.zeros((6, 0, len(q)))]  # of what each arm can make
    for i, (arm, grasp) in enumerate(zip(chain.slices, chain.grasps, strict=True)):
        motions = J[:, arm]
        if not grasp.is_rigid:
            slips = []
            for k, joints in enumerate(q):
                pin.forwardKinematics(chain.model, chain.data, joints)
                slips.append(grasp.motions_at(chain.tip_poses()[i], X_WO.p[:, k]))
            motions = np.concatenate((motions, np.stack(slips, axis=2)), axis=1)
        B = _orthonormal(whitened(motions))
        outside.append(_orthonormal(np.eye(6)[:, :, None] - np.einsum("imk,jmk->ijk", B, B)))
    locked = np.concatenate(outside, axis=1)
    if locked.any():  # several arms may lock the same, but for their loops' openings
        U, s, _ = np.linalg.svd(locked.transpose(2, 0, 1), full_matrices=False)
        locked = (U * (s > _SAME * s[:, :1])[:, None]).transpose(1, 2, 0)
    lines = np.tensordot(np.linalg.inv(L), in_object(N), 1)
    basis = _orthonormal(np.concatenate((locked, lines), axis=1))
    own = np.tensordot(np.linalg.inv(L.T), _left(whitened(x), basis), 1)
    return np.concatenate((X_WO.rotate(own[:3]), X_WO.rotate(own[3:])))


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis (6, m, k) of columns (6, n, k), by Gram and Schmidt.

    A column of which nothing is left beside those before it is a zero.
    """
    basis = np.zeros((6, 0, columns.shape[2]))
    for column in columns.transpose(1, 0, 2):
        left = column / np.maximum(_length(column), 1.0)
        for _ in range(2):  # once more for what rounding left
            left = _left(left, basis)
        size = _length(left)
        unit = np.where(size > _SAME, left / np.maximum(size, _SAME), 0.0)
        if unit.any():
            basis = np.concatenate((basis, unit[:, None]), axis=1)
    return basis


def _left(x: Array, basis: Array) -> Array:
    """What is left of x (6, k) beside an orthonormal basis (6, m, k)."""
    left: Array = x - np.einsum("imk,mk->ik", basis, np.einsum("imk,ik->mk", basis, x))
    return left


def _length(x: Array) -> Array:
    return np.asarray(np.sqrt((x * x).sum(axis=0)))
