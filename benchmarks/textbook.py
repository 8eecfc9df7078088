"""The control law as textbooks write it: a matrix for every symbol, `numpy.linalg` for the rest.

Pinocchio computes M, h, Jacobians and spatial vectors. J, Λ, μ + p of each arm, the augmented
object, the contact and eqs. 21 to 25 of the paper are computed with NumPy, without the toolkit's
own mathematics. Wrist readings are not corrected by weight and inertia of the gripper parts beyond
the sensors.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.linalg import inv, lstsq, norm, pinv, svd

from benchmarks.cases import DT, TickCase
from osc_contact.spatial import Array

STIFFNESS = 25.0  #: 1/s², of the posture of redundant arms
DAMPING = 10.0  #: 1/s, of the same


class ArmTerms(NamedTuple):
    """Terms of an arm with n joints at O, in world axes.

    Attributes:
        s: its joints among those of all arms.
        J: (6, n) Jacobian.
        M: (n, n) joint-space inertia.
        h: (n,) torques of velocities and gravity (N m, N).
        gamma: (6,) drift γ of the tip, J̇ q̇.
        Lambda: (6, 6) operational-space inertia (J M⁻¹Jᵀ)⁺.
        J_bar: (n, 6) inertia-weighted inverse M⁻¹JᵀΛ.
    """

    s: slice
    J: Array
    M: Array
    h: Array
    gamma: Array
    Lambda: Array
    J_bar: Array


class TextbookLaw:
    """Law for vertices on faces at rest, and arms with full rank in the motions that they share.

    Attributes:
        case: rig at one instant, of which measurement and reference are those of each tick.
        model, data: Pinocchio's model of all arms, and its results.
        tips, wrists: frames of the tips and of the wrist sensors in the model.
        inertia: inertia of the object.
        selected: (n, n_a) matrix that maps motor torques to joint torques.
        limits: (n,) torque limits, 1 for joints without a motor (N m, N).
        motion_sum: (6,) integral of the permitted pose error (m s, rad s).
        force_sum: (r,) force integrals (N).
    """

    def __init__(self, case: TickCase) -> None:
        """Copy structure and limits from a case, with integrals of zero.

        Args:
            case: rig with an object, at one instant.
        """
        chain = case.chain
        assert chain.payload is not None
        self.case = case
        self.model = chain.model
        self.data = chain.model.createData()
        self.tips = chain.tips
        self.wrists = chain.sensors
        self.inertia = chain.payload.inertia
        self.selected = np.eye(chain.nq)[:, chain.actuated]  # B: motor torques to joint torques
        self.limits = np.ones(chain.nq)
        self.limits[chain.actuated] = chain.tau_max
        self.motion_sum = np.zeros(6)
        self.force_sum = np.zeros(len(case.pairs))

    def tick(self) -> Array:
        """Compute the motor torques (n_a,; N m, N) at the instant of the case; update integrals.

        Symbols are those of the glossary; the equations of the paper are named at each step.
        """
        case = self.case
        model = self.model
        data = self.data
        q = case.measurement.q
        v = case.measurement.v
        pin.computeAllTerms(model, data, q, v)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        X = data.oMf[self.tips[0]] * case.chain.grasps[0].X_TO
        O = X.translation  # noqa: E741 - the operational point
        R = X.rotation

        # each arm at O: Λ = (J M⁻¹Jᵀ)⁺, J̄ = M⁻¹JᵀΛ, μ + p = J̄ᵀh − Λγ
        arms = []
        for s, tip in zip(case.chain.slices, self.tips, strict=True):
            shift = np.eye(6)  # of twists from the tip to O
            shift[:3, 3:] = -pin.skew(O - data.oMf[tip].translation)
            J = shift @ pin.getFrameJacobian(model, data, tip, pin.LOCAL_WORLD_ALIGNED)[:, s]
            drift = pin.getFrameAcceleration(model, data, tip, pin.LOCAL_WORLD_ALIGNED)
            M = data.M[s, s]
            h = data.nle[s]
            gamma = shift @ drift.vector
            Minv = inv(M)
            Lambda = pinv(J @ Minv @ J.T, rcond=1e-9)
            arms.append(ArmTerms(s, J, M, h, gamma, Lambda, Minv @ J.T @ Lambda))
        V = arms[0].J @ v[arms[0].s]
        w = V[3:]

        # motions that all arms permit, a = S η̇ + σ
        left = [svd(arm.J)[0][:, arm.J.shape[1] :] for arm in arms]
        C = np.hstack(left)
        locked = np.hstack([U.T @ arm.gamma for U, arm in zip(left, arms, strict=True)])
        U, values, _ = svd(C)
        S = U[:, int(np.sum(values > 1e-4)) :]
        sigma = lstsq(C.T, locked, rcond=1e-4)[0]

        # the augmented object, eq. 13
        Lambda_o = pin.SE3(R, np.zeros(3)).act(self.inertia).matrix()
        momentum = pin.Force(Lambda_o @ V)
        bias_o = pin.Motion(V).cross(momentum).vector - Lambda_o[:, :3] @ model.gravity.linear
        Lambda_S = S.T @ (sum(arm.Lambda for arm in arms) + Lambda_o) @ S
        bias = bias_o + Lambda_o @ sigma
        G = np.zeros((S.shape[1], model.nv))
        for arm in arms:
            bias = bias + arm.J_bar.T @ arm.h - arm.Lambda @ (arm.gamma - sigma)
            G[:, arm.s] = S.T @ arm.J_bar.T
        G = G @ self.selected

        # contact: columns of N push into the faces; n_γ = −ṄᵀV
        N = np.zeros((6, len(case.pairs)))
        n_gamma = np.zeros(len(case.pairs))
        for i, pair in enumerate(case.pairs):
            n = -pair.normal
            p = R @ pair.vertex
            N[:, i] = np.r_[n, np.cross(p, n)]
            n_gamma[i] = -np.cross(V[:3] + np.cross(w, p), n) @ w

        # force loop, fig. 5, with Ω_f(Λ_o)
        f_meas = np.zeros(6)
        for wrist, reading in zip(self.wrists, case.measurement.wrenches, strict=True):
            X_OS = pin.SE3(data.oMf[wrist].rotation, data.oMf[wrist].translation - O)
            f_meas += X_OS.act(pin.Force(reading)).vector
        Phi_o = inv(Lambda_o)
        alpha = inv(N.T @ Phi_o @ N) @ (N.T @ Phi_o @ (f_meas - bias_o) - n_gamma)
        k = case.gains.force
        alpha_d = case.reference.alpha_d
        self.force_sum += k.integral * DT * (alpha_d - alpha)
        alpha_u = alpha_d + self.force_sum - k.damping * (N.T @ V)

        # motion loop
        g = case.gains.motion
        X_WD = case.reference.X_WD
        e = np.r_[X_WD.translation - O, pin.log3(X_WD.rotation @ R.T)]
        Omega_m = np.eye(6) - Phi_o @ N @ inv(N.T @ Phi_o @ N) @ N.T
        self.motion_sum += Omega_m @ e * DT
        a = case.reference.A_D + g.damping * (case.reference.V_D - V) + g.stiffness * e
        a = a + g.integral * self.motion_sum - np.r_[np.cross(w, V[:3]), np.zeros(3)]

        # filters and control structure, eqs. 21, 24, 25: η̇_u = P_T(a − σ), η̇_c = Ω_m η̇_u + …
        B = inv(S.T @ Lambda_o @ S)
        P_T = B @ S.T @ Lambda_o
        N_S = S.T @ N
        lift = B @ N_S @ inv(N_S.T @ B @ N_S)
        eta = P_T @ (a - sigma)
        eta -= lift @ (N_S.T @ eta - n_gamma + N.T @ sigma)
        f_S = Lambda_S @ eta + S.T @ bias + N_S @ alpha_u

        # viscous friction along permitted speeds; dry friction is left out
        speeds = P_T @ case.reference.V_D
        permitted = S @ (speeds - lift @ N_S.T @ speeds)
        friction = np.zeros(model.nv)
        for arm in arms:
            friction[arm.s] = model.damping[arm.s] * (arm.J_bar @ permitted)
        tau = self.allocated(arms, G, f_S, S @ eta + sigma, v)
        return tau + self.selected.T @ friction

    def allocated(
        self, arms: list[ArmTerms], G: Array, f_S: Array, acceleration: Array, v: Array
    ) -> Array:
        """Compute the motor torques (n_a,) of least effort Στ²/τ_max² for f_S and the squeeze.

        They are τ_0 + WAᵀ(AWAᵀ)⁻¹(b − Aτ_0), with W = diag(τ_max²), of a redundant arm W = Jᵀ(J
        diag(τ_max⁻²) Jᵀ)⁻¹J, whose torques do not move it in its null space, and τ_0 the torques of
        the posture task there. A τ = b states G τ = f_S and, of two arms, the desired squeeze: the
        mean of the forces by which they press towards each other along the line between their tips.

        Args:
            arms: terms of the arms.
            G: (d, n_a) generalised force on the object per motor torque.
            f_S: (d,) generalised force on the object.
            acceleration: (6,) commanded spatial acceleration of the object.
            v: (n,) joint velocities.
        """
        case = self.case
        B = self.selected
        weight = np.zeros((len(v), len(v)))
        rest = np.zeros(len(v))
        q = case.measurement.q
        for arm in arms:
            s = arm.s
            J = arm.J
            weight[s, s] = np.diag(self.limits[s] ** 2)
            if J.shape[1] > 6:
                R = np.diag(self.limits[s] ** -2.0)
                weight[s, s] = J.T @ inv(J @ R @ J.T) @ J
                desired = STIFFNESS * (case.posture[s] - q[s]) - DAMPING * v[s]
                rest[s] = (np.eye(J.shape[1]) - J.T @ arm.J_bar.T) @ (arm.h + arm.M @ desired)
        A = G
        b = f_S
        if len(arms) == 2:
            left, right = (self.data.oMf[tip].translation for tip in self.tips)
            e = np.r_[(right - left) / norm(right - left), np.zeros(3)]
            row = np.zeros(len(v))
            offset = 0.0
            for sign, arm in zip((0.5, -0.5), arms, strict=True):
                row[arm.s] = sign * arm.J_bar @ e
                force = arm.J_bar.T @ arm.h + arm.Lambda @ (acceleration - arm.gamma)
                offset += sign * e @ force
            A = np.vstack((G, row @ B))
            b = np.r_[f_S, float(case.reference.squeeze_d) + offset]
        W = B.T @ weight @ B
        tau_0 = B.T @ rest
        return tau_0 + W @ A.T @ inv(A @ W @ A.T) @ (b - A @ tau_0)
