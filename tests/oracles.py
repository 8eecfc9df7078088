"""Oracles: full systems of equations that share no formula with the code under test.

The KKT oracle gives every joint and the free object their own accelerations, and every loop
closure and contact its own multiplier, and solves the lot by least squares (theory of eqs. 13–20
the long way round). Drift terms come from Pinocchio's acceleration pass, not from the package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin


@dataclass
class KKTSolution:
    qdd: np.ndarray
    a_object: np.ndarray  # spatial, at O
    alpha: np.ndarray
    loops: np.ndarray  # (arms, 6) wrench of each arm on the object, at O; split not unique
    residual: float


def to_point(X: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Carry a world-origin motion (6,) or motion columns (6, k) to point p."""
    out = np.array(X)
    out[:3] += np.cross(X[3:].T, p).T
    return out


def kkt(chain, q, v, tau, N=None, n_gamma=None) -> KKTSolution:
    """Joints + object + loop closures + contacts on a fixed environment, by least squares."""
    model, data = chain.model, chain.model.createData()
    n, k = model.nv, len(chain.arms)
    N = np.zeros((6, 0)) if N is None else N
    n_gamma = np.zeros(N.shape[1]) if n_gamma is None else n_gamma
    r = N.shape[1]
    M = pin.crba(model, data, q)
    M = np.triu(M) + np.triu(M, 1).T
    h = pin.nonLinearEffects(model, data, q, v) + model.damping * v
    pin.computeJointJacobians(model, data, q)
    pin.forwardKinematics(model, data, q, v, np.zeros(n))
    pin.updateFramePlacements(model, data)
    frames = [model.getFrameId(f"{a.name}/{a.tip}") for a in chain.arms]
    X_WO = data.oMf[frames[0]] * chain.grasps[0].X_TO
    O = X_WO.translation  # noqa: E741
    J, gamma = [], []
    for f in frames:
        J.append(to_point(pin.getFrameJacobian(model, data, f, pin.WORLD), O))
        gamma.append(to_point(pin.getFrameAcceleration(model, data, f, pin.WORLD).vector, O))
    V = J[0] @ v
    # object: inertia at O, world axes, from its own mass, lever and rotational inertia
    body = chain.payload.inertia
    R = X_WO.rotation
    c = R @ body.lever
    cx = pin.skew(c)
    m = body.mass
    I_O = R @ body.inertia @ R.T - m * cx @ cx
    I = np.block([[m * np.eye(3), -m * cx], [m * cx, I_O]])  # noqa: E741
    momentum = I @ V
    bias = np.concatenate(
        (
            np.cross(V[3:], momentum[:3]),
            np.cross(V[3:], momentum[3:]) + np.cross(V[:3], momentum[:3]),
        )
    )
    g = model.gravity.linear
    bias -= np.concatenate((m * g, m * np.cross(c, g)))
    # unknowns: qdd (n), a (6), λ_i on the object (6k), α (r)
    size = n + 6 + 6 * k + r
    K, y = np.zeros((size, size)), np.zeros(size)
    K[:n, :n] = M
    y[:n] = -h
    y[:n][chain.actuated] += tau
    K[n : n + 6, n : n + 6] = I
    y[n : n + 6] = -bias
    for i in range(k):
        cols = slice(n + 6 + 6 * i, n + 12 + 6 * i)
        K[:n, cols] = J[i].T
        K[n : n + 6, cols] = -np.eye(6)
        K[cols, :n] = J[i]
        K[cols, n : n + 6] = -np.eye(6)
        y[cols] = -gamma[i]
    K[n : n + 6, size - r :] = N
    K[size - r :, n : n + 6] = N.T
    y[size - r :] = n_gamma
    # rows and columns to unit size: the loop of two SCARAs is redundant by one row
    scale = 1.0 / np.sqrt(np.abs(K).max(axis=1))
    Ks = K * np.outer(scale, scale)
    x = scale * np.linalg.lstsq(Ks, scale * y, rcond=1e-13)[0]
    for _ in range(2):  # iterative refinement
        x += scale * np.linalg.lstsq(Ks, scale * (y - K @ x), rcond=1e-13)[0]
    residual = float(np.abs(scale * (K @ x - y)).max())
    return KKTSolution(
        x[:n], x[n : n + 6], x[size - r :], x[n + 6 : n + 6 + 6 * k].reshape(k, 6), residual
    )


class constrained_pinocchio:
    """Pinocchio's own closed loop: arms + a free-flying object + one 6D weld for each arm."""

    def __init__(self, chain):
        self.chain = chain
        model = chain.model.copy()
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
        model.appendBodyToJoint(joint, chain.payload.inertia, pin.SE3.Identity())
        self.model, self.joint = model, joint
        self.data = model.createData()
        self.welds = []
        for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
            frame = chain.model.frames[chain.model.getFrameId(f"{arm.name}/{arm.tip}")]
            self.welds.append(
                pin.RigidConstraintModel(
                    pin.ContactType.CONTACT_6D,
                    model,
                    frame.parentJoint,
                    frame.placement * grasp.X_TO,
                    joint,
                    pin.SE3.Identity(),
                    pin.LOCAL,
                )
            )
        self.weld_data = [weld.createData() for weld in self.welds]
        pin.initConstraintDynamics(model, self.data, self.welds, self.weld_data)
        self.settings = pin.ProximalSettings(1e-12, 1e-10, 30)

    def acceleration(self, q, v, X_WO, tau, wrench=None) -> np.ndarray:
        """Spatial acceleration (6,) of the object at its origin, world axes."""
        n = self.chain.nq
        full_q = np.concatenate((q, pin.SE3ToXYZQUAT(X_WO)))
        pin.computeJointJacobians(self.chain.model, self.chain.data, q)
        frame = self.chain.model.getFrameId(f"{self.chain.arms[0].name}/{self.chain.arms[0].tip}")
        V = pin.getFrameJacobian(self.chain.model, self.chain.data, frame, pin.WORLD) @ v
        V_O = to_point(V, X_WO.translation)
        R = X_WO.rotation
        full_v = np.concatenate((v, R.T @ V_O[:3], R.T @ V_O[3:]))
        full_tau = np.zeros(n + 6)
        full_tau[self.chain.actuated] = tau
        if wrench is not None:  # at O, world axes → the free-flyer's own axes
            full_tau[n : n + 3], full_tau[n + 3 :] = R.T @ wrench[:3], R.T @ wrench[3:]
        a = pin.constraintDynamics(
            self.model, self.data, full_q, full_v, full_tau, self.welds, self.weld_data,
            self.settings,
        )  # fmt: skip
        return np.concatenate((R @ a[n : n + 3], R @ a[n + 3 :]))
