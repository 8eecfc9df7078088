"""The same task with a law of the Jacobian's transpose and a selection matrix.

    τ = Jᵀ(Ω(K e + D ė) + n(α_d + k_I∫(α_d − α) − d n·ṗ)) + g(q) + τ_0,   Ω = diag(1 − nnᵀ, 1)

n is the normal of both edges, which stays during a pass: a selection frame that fits. α is the
wrist's reading less the weights beyond it. The law knows no inertia; it is told the true pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.polishing.task import INTO
from osc_contact.control.safety import SafetyState
from osc_contact.spatial import Array
from osc_contact.sweeps.vector_env import ContactVectorEnv

__all__ = ["SOFT", "STIFF", "SelectionRows", "SpringGains"]


@dataclass(frozen=True)
class SpringGains:
    """Gains of the law.

    Attributes:
        stiffness, damping: K, D along (N/m, N s/m) and about (N m, N m s) the axes.
        integral: k_I (1/s). contact: d (N s/m). posture: stiffness and damping of τ_0 (N m, N m s).
    """

    stiffness: tuple[float, float] = (2000.0, 50.0)
    damping: tuple[float, float] = (80.0, 2.0)
    integral: float = 10.0
    contact: float = 100.0
    posture: tuple[float, float] = (10.0, 3.0)


SOFT = SpringGains()  #: about as stiff as ours, which is 900 /s² times the mass that the bar feels
#: the best of 42 sets (stiffness, damping, integral, contact), found under friction up to 0.1
STIFF = SpringGains((16000.0, 320.0), (250.0, 5.4), 30.0, 600.0)


class SelectionRows:
    """Takes the place of the controllers of a vector environment."""

    def __init__(self, env: ContactVectorEnv, gains: SpringGains) -> None:
        """Rows of an environment, whose `fleet.control` it becomes."""
        self._env, self._gains, B = env, gains, env.num_envs
        self._K, self._D = np.repeat(gains.stiffness, 3), np.repeat(gains.damping, 3)
        self._chains = [one.chain for one in env.fleet.control._settings]
        self._rest = env.fleet.measure()[0]
        self._sum, self._dt = np.zeros(B), env.fleet.dt
        self.alpha_meas, self.normal_speed = np.zeros((2, B, 1))
        self.state = np.full(B, int(SafetyState.RUN))
        env.fleet.control = self  # type: ignore[assignment]

    def replace(self, row: int, controller: Any) -> None:
        """A row begins anew, with the model of this controller."""
        self._chains[row], self._sum[row] = controller.settings.chain, 0.0

    def tick(
        self, q: Array, v: Array, wrenches: Array, X_WD: Array, V_D: Array, A_D: Array,
        alpha_d: Array, squeeze_d: Array,
    ) -> Array:  # fmt: skip
        """Torques (B, n_a); arguments as of `BatchController.tick`."""
        k, B = self._gains, len(q)
        p, R = self._env.fleet.objects()
        J, tau = np.empty((B, 6, q.shape[1])), np.empty(q.shape)
        alpha = np.empty(B)
        e = np.concatenate((X_WD[:, :3, 3] - p, np.empty((B, 3))), axis=1)
        for i in range(B):
            J[i], tau[i], alpha[i] = self._look(i, q[i], p[i], R[i], wrenches[i, 0])
            e[i, 3:] = pin.log3(X_WD[i, :3, :3] @ R[i].T)
        V = np.einsum("bij,bj->bi", J, v)
        force = self._K * e + self._D * (V_D - V)
        force[:, :3] -= (force[:, :3] @ INTO)[:, None] * INTO
        speed = V[:, :3] @ INTO
        self._sum += self._dt * (alpha_d[:, 0] - alpha)
        push = alpha_d[:, 0] + k.integral * self._sum - k.contact * speed
        force[:, :3] += push[:, None] * INTO
        idle = k.posture[0] * (self._rest - q) - k.posture[1] * v
        seen = np.linalg.solve(
            J @ J.transpose(0, 2, 1), np.einsum("bij,bj->bi", J, idle)[..., None]
        )
        force -= seen[..., 0]  # τ_0 = (1 − JᵀJᵀ⁺) idle
        self.alpha_meas[:, 0], self.normal_speed[:, 0] = alpha, speed
        return np.asarray(tau + np.einsum("bij,bi->bj", J, force) + idle)

    def _look(
        self, row: int, q: Array, p: Array, R: Array, wrench: Array
    ) -> tuple[Array, Array, float]:
        """J at the operational point, torques that carry arm and bar, the force that is read."""
        chain = self._chains[row]
        model, data, tip = chain.model, chain.data, chain.tips[0]
        weight = np.array(pin.computeGeneralizedGravity(model, data, q))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = pin.getFrameJacobian(model, data, tip, pin.LOCAL_WORLD_ALIGNED)
        J[:3] -= pin.skew(p - data.oMf[tip].translation) @ J[3:]
        bar, g = chain.payload.inertia, model.gravity.linear
        lift = np.concatenate((-bar.mass * g, np.cross(R @ bar.lever, -bar.mass * g)))
        beyond = bar.mass + sum(link.inertia.mass for link in chain.outboard[0])
        read = data.oMf[chain.sensors[0]].rotation @ wrench[:3] + beyond * g
        return J, weight + J.T @ lift, float(INTO @ read)
