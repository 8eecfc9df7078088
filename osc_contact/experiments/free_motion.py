"""The part of a motion error that could be removed: what arms can make and contacts permit."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.outboard import columns_at
from osc_contact.spatial import Array

__all__ = ["free_part"]


def free_part(chain: ClosedChain, q: Array, X_WO: pin.SE3, N: Array, x: Array) -> Array:
    """The part of a small displacement x (6,) at O in range(S) ∩ T, cut in the object's metric.

    For d = 6 this is Ω_m(Λ_o⁻¹) x. For fewer motions that projection would answer the yielding of
    a contact, a displacement along N, with turns that the arms cannot make. Computed in coordinates
    in which the object's inertia is the identity.

    Args:
        chain: of the arms. q: (n,) joint positions. X_WO: pose of the object.
        N: (6, r) lines of force in contact.
    """
    L = np.linalg.cholesky(chain.reference_inertia(X_WO))
    pin.computeJointJacobians(chain.model, chain.data, q)
    J = L.T @ columns_at(chain.data.J, X_WO.translation)
    locked = np.hstack([_outside(J[:, arm]) for arm in chain.slices])
    S = _outside(locked) if locked.shape[1] else np.eye(6)
    e, N_S = S.T @ (L.T @ x), S.T @ np.linalg.solve(L, N)
    e = e - N_S @ np.linalg.lstsq(N_S, e, rcond=None)[0]
    return np.asarray(np.linalg.solve(L.T, S @ e))


def _outside(columns: Array) -> Array:
    """Orthonormal complement of the range of (6, k)."""
    U, s, _ = np.linalg.svd(columns)
    return U[:, int(np.count_nonzero(s > 1e-6 * s[0])) :]
