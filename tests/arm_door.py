"""The law's terms of one arm for any J, M, h, g, γ and object inertia, by a call of its own."""

from __future__ import annotations

import numpy as np
from numba import njit

from osc_contact.dynamics.chain_state import ArmTerms
from osc_contact.law import tables as at
from osc_contact.law.arm_terms import arm_terms
from osc_contact.law.jit import PLAIN_PYTHON


def compiled(function):
    return function if PLAIN_PYTHON else njit(error_model="numpy")(function)


@compiled
def call(n, tolerance, raw_joints, raw_arm, raw_work, locked):
    joints, arm = at.read_joint_work(raw_joints, 0, n), at.read_arm_work(raw_arm, 0, 1)[0]
    return arm_terms(0, n, 6, True, tolerance, joints, arm, at.read_work(raw_work, 0, 1)[0],
                     locked, 0)  # fmt: skip


def terms_of(J, gamma, M, h, g, Lambda_o, tolerance):
    """`ArmTerms` of a rigid grasp: J (6, n), γ (6,), M (n, n), h, g (n,), Λ_o (6, 6)."""
    n, L = len(M), np.linalg.cholesky(Lambda_o)  # motions x̃ = Lᵀx, wrenches f̃ = L⁻¹f
    raw = [np.zeros(size, np.uint8)
           for size in (n * at.JOINT_WORK_BYTES, at.ARM_WORK_BYTES, at.WORK_BYTES)]  # fmt: skip
    joints, locked = raw[0].view(at.JOINT_WORK), np.zeros((6, 7))
    joints["J"], joints["M"][:, :n] = (L.T @ J).T, M
    count = call(n, tolerance, *raw, locked)
    own = raw[1].view(at.ARM_WORK)[0]
    J_bar, Lambda = joints["J_bar"] @ L.T, L @ own["Lambda"] @ L.T
    assert count == own["n_locked"] == 6 - own["n_kept"]
    return ArmTerms(
        J, gamma, M, J @ np.linalg.solve(M, J.T), Lambda, J_bar, J_bar.T @ (h - g) - Lambda @ gamma,
        J_bar.T @ g, L @ locked[:count, :6].T, np.eye(6), int(own["n_kept"]),
    )  # fmt: skip
