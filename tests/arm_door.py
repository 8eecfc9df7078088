"""The law's terms of one arm for any J, M, h, g, γ and object inertia, by a call of its own."""

from __future__ import annotations

import numpy as np
from numba import njit

from osc_contact.dynamics.chain_state import ArmTerms
from osc_contact.law.jit import PLAIN_PYTHON
from osc_contact.law.operational import arm_terms
from osc_contact.law.records import Rows, new_model, row_of, views


def compiled(function):
    return function if PLAIN_PYTHON else njit(error_model="numpy")(function)


@compiled
def call(raw, n):
    t = row_of(raw, 0, 0)
    return arm_terms(t, 0, n, 6, True, t.work.arms[0], 0)


def terms_of(J, gamma, M, h, g, Lambda_o, tolerance):
    """`ArmTerms` of a rigid grasp: J (6, n), γ (6,), M (n, n), h, g (n,), Λ_o (6, 6)."""
    n, L = len(M), np.linalg.cholesky(Lambda_o)  # motions x̃ = Lᵀx, wrenches f̃ = L⁻¹f
    rows = Rows(new_model(1, n, 0))
    model, _, work, _ = views(rows)
    model.tolerance, joints, locked = tolerance, work.joints, work.locked_rows
    joints["J"], joints["M"][:, :n] = (L.T @ J).T, M
    count = call(rows.raw, n)
    own = work.arms[0]
    J_bar, Lambda = joints["J_bar"] @ L.T, L @ own["Lambda"] @ L.T
    assert count == own["n_locked"] == 6 - own["n_kept"]
    return ArmTerms(
        J, gamma, M, J @ np.linalg.solve(M, J.T), Lambda, J_bar, J_bar.T @ (h - g) - Lambda @ gamma,
        J_bar.T @ g, L @ locked[:count, :6].T, np.eye(6), int(own["n_kept"]),
    )  # fmt: skip
