"""Contact forces by least squares, as one weighted system in all that is unknown.

`osc_contact.law.least_squares` works with the covariance of what the magnitudes do not explain;
here magnitudes, tangential forces and departures of the acceleration stand side by side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.pair import Bodies, velocity
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.interface import Touched
from osc_contact.spatial import Array

__all__ = ["explained", "slides"]

ALONG, ACROSS, DEPARTURE, LEAST_FORCE, NOISE = 0.3, 0.1, 0.1, 1.0, 0.01


def slides(
    pairs: Sequence[ContactPair], X_WO: pin.SE3, V_O: Array, touched: Touched | None, slip: float
) -> list[tuple[Array, Array, Array]]:
    """Point from O, normal and s = v_t / √(v_t² + v_0²) of every magnitude."""
    out = []
    for i, pair in enumerate(pairs):
        X_WE = None if touched is None else pin.SE3(touched.X_WE[i])
        V_E = None if touched is None else touched.V_E[i]
        V_rel = Bodies.at_O(X_WO, V_O, X_WE, V_E).V_rel
        normals = pair.contact(X_WO, V_O, X_WE, V_E).N[:3]
        points = pair.points_of_contact(X_WO, X_WE) - X_WO.translation[:, None]
        for p, n in zip(points.T, normals.T, strict=True):
            v = velocity(V_rel, p)
            v = v - (v @ n) * n
            out.append((p, n, v / np.sqrt(v @ v + slip**2)))
    return out


def explained(
    f_meas: Array,
    state: ChainState,
    contact: Contact,
    environment: Environment,
    friction_wrenches: Array,
    A_D: Array,
    wanted: Array,
    where: Sequence[tuple[Array, Array, Array]],
) -> tuple[Array, float, Array]:
    """Magnitudes α (r,), the rate of the coefficient of friction per unit of `learning`, and D⁻¹.

    D⁻¹ (r, r) is what normal accelerations of an object in flight add to the magnitudes.

    Args:
        f_meas: (6,) at O. A_D: (6,) classical, wanted. wanted: (n,) forces of all columns.
        where: from `slides`, of all columns.
    """
    N, metric, out = contact.N, state.metric, state.Lambda_out
    mass, V, r = metric[0, 0], state.V_O, contact.N.shape[1]
    a = A_D - np.concatenate((np.cross(V[3:], V[:3]), np.zeros(3)))
    pull = np.linalg.solve(metric, N)
    pull = pull @ np.linalg.inv(N.T @ pull)  # least motion for given normal accelerations
    a = a + pull @ (contact.n_gamma + N.T @ environment.b_e - N.T @ a)
    f = f_meas - state.bias_out - out @ a
    H = N + friction_wrenches + out @ pull @ environment.yielding(N, friction_wrenches)
    tangents, weights, along = [], [], []
    for (p, n, s), force in zip(where, wanted, strict=True):
        w = max(abs(force), LEAST_FORCE)
        basis = np.linalg.svd(n[None])[2][1:].T
        C = ACROSS**2 * np.eye(2) + (ALONG**2 - ACROSS**2) * np.outer(basis.T @ s, basis.T @ s)
        wrench = np.vstack((np.eye(3), pin.skew(p))) @ basis @ np.linalg.cholesky(C) * w
        tangents.append(wrench + out @ pull @ (N.T @ environment.Phi_e @ wrench))
        along.append((w, np.linalg.cholesky(C).T @ basis.T @ s))
        weights.append(w)
    T = np.hstack(tangents)
    L = np.linalg.cholesky(metric)
    free = np.linalg.svd(np.linalg.solve(L, N).T)[2][r:].T  # orthonormal, energy coordinates
    free = DEPARTURE * np.sqrt(mass) * np.linalg.solve(L.T, free)
    sharp = np.sqrt(mass) / NOISE * np.linalg.inv(L)
    t, d = T.shape[1], free.shape[1]
    rows = np.vstack((
        sharp @ np.hstack((H, T, out @ free)),
        np.hstack((np.zeros((t + d, r)), np.eye(t + d))),
    ))  # fmt: skip
    known = np.column_stack((sharp @ f, sharp @ out @ pull))
    answers = np.linalg.lstsq(rows, np.vstack((known, np.zeros((t + d, r + 1)))), rcond=None)[0]
    x, inertia = answers[:, 0], answers[:r, 1:]
    found = sum(w * w * share @ x[r + 2 * j : r + 2 * j + 2] for j, (w, share) in enumerate(along))
    return x[:r], found / sum(w * w for w in weights), inertia
