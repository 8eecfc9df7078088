"""Joint torque loop: it makes a torque source of a flexible joint with an imperfect motor.

Section 6 of the paper and its reference [11]: sensors behind the springs read the torque τ that
reaches the link. With the motor's inertia J_m and the spring K,

    τ̈ = K((u − τ)/J_m − q̈),    u = τ_d + k_p(τ_d − τ) − k_d τ̇

moves the resonance from ω = √(K/J_m) to ω√(1 + k_p) and reduces the effects of motor inertia, bias,
ripple and friction by the factor 1 + k_p. There is no integral: the remaining errors are small, and
it would wind up in every contact loss. The loop runs at a higher rate than the controller.
"""

from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.sensing.velocity_estimate import VelocityEstimate
from osc_contact.settings.control import JointTorqueSpec
from osc_contact.spatial import Array, as_array

#: Bandwidth of the estimate of τ̇, as a multiple of the loop's bandwidth.
RATE_BANDWIDTH = 6.0


@dataclass
class JointTorqueLoop:
    """Torque control of each joint separately, from its torque sensor.

    Attributes:
        stiffness: (n_a,) K of the springs (N m/rad; N/m).
        motor_inertia: (n_a,) J_m (kg m²; kg).
        tau_max: (n_a,) torque limits of the motors (N m; N).
        settings: rate (Hz), gain k_p and damping ratio of the closed loop.
        dt: period of the loop (s).
        gain: k_p.
        rate_gain: (n_a,) k_d (s).
        bandwidth: (n_a,) ω√(1 + k_p) (rad/s).
        torque_rate: estimate of τ̇ from the torque readings.

    Raises:
        InvalidInputError: impossible numbers, or the sampled loop would be unstable.
    """

    stiffness: Array
    motor_inertia: Array
    tau_max: Array
    settings: JointTorqueSpec

    def __post_init__(self) -> None:
        """Compute gains and bandwidth of the loop from stiffness and motor inertia of each joint.

        With the stiffness K (N m/rad) of the joint's spring, the inertia J (kg m²) of its motor and
        the gain k of the loop, the bandwidth is ω = √(K(1 + k)/J) (rad/s), and the gain of the
        torque's rate 2ζ(1 + k)/ω (s) gives the damping ratio ζ. The rate is that of an estimate
        from torque readings.

        Raises:
            InvalidInputError: a stiffness or inertia is not positive, or the sampled loop is
                unstable.
        """
        n = len(self.tau_max)
        K = as_array("stiffness", self.stiffness, (n,))
        J = as_array("motor_inertia", self.motor_inertia, (n,))
        if min(K.min(), J.min()) <= 0.0:
            raise InvalidInputError(
                f"joint torque loop: stiffness and motor inertia must be > 0; got {K}, {J}"
            )
        self.dt = 1.0 / self.settings.rate
        self.gain = self.settings.gain
        self.bandwidth = np.sqrt(K * (1.0 + self.gain) / J)
        self.rate_gain = 2.0 * self.settings.damping_ratio * (1.0 + self.gain) / self.bandwidth
        self.torque_rate = VelocityEstimate.with_bandwidth(RATE_BANDWIDTH * self.bandwidth, self.dt)
        radius = float(self.spectral_radius().max())
        if radius >= 1.0:
            raise InvalidInputError(
                f"joint torque loop: at a gain of {self.gain:g} and a period of {self.dt * 1e3:g} "
                f"ms the sampled loop is unstable (spectral radius {radius:.3f}, bandwidth "
                f"{self.bandwidth.max() / (2 * np.pi):.0f} Hz). Raise control.joint_torque.rate or "
                "lower control.joint_torque.gain"
            )

    def command(self, tau_d: Array, tau: Array, fresh: bool = True) -> Array:
        """Compute the motor torques u (n_a,) for one period, within the limits (N m; N).

        Args:
            tau_d: (n_a,) desired joint torques (N m; N).
            tau: (n_a,) measured joint torques.
            fresh: True if the sensors have sampled since the last call.
        """
        _, rate = self.torque_rate.update(tau, fresh=fresh)
        u = tau_d + self.gain * (tau_d - tau) - self.rate_gain * rate
        return np.minimum(np.maximum(u, -self.tau_max), self.tau_max)  # faster than np.clip

    def spectral_radius(self) -> Array:
        """Compute the spectral radius (n_a,) of each sampled loop with the link fixed.

        The states are τ and τ̇ of the joint (integrated exactly over one period of constant u) and
        the two states τ̂, τ̂̇ of the estimate. The loop is stable below 1.
        """
        joints = zip(
            self.stiffness,
            self.motor_inertia,
            self.rate_gain,
            self.torque_rate.alpha,
            self.torque_rate.beta,
            strict=True,
        )
        return np.array([self._spectral_radius(*joint) for joint in joints])

    def _spectral_radius(self, K: float, J_m: float, k_d: float, a: float, b: float) -> float:
        """Compute the largest eigenvalue magnitude of the sampled loop of one joint.

        Args:
            K, J_m: stiffness and motor inertia (N m/rad, kg m²; N/m, kg).
            k_d: gain of τ̇ (s).
            a, b: gains of the estimate, of τ and of τ̇ dt.
        """
        dt = self.dt
        w = float(np.sqrt(K / J_m))
        c = np.cos(w * dt)
        s = np.sin(w * dt)
        push = np.array([1.0 - c, w * s])  # response of τ, τ̇ to a unit of u over one period
        A = np.zeros((4, 4))
        A[:2, :2] = [[c, s / w], [-w * s, c]]
        # estimate: x̂⁻ = (τ̂ + τ̂̇ dt, τ̂̇), x̂ = x̂⁻ + (a, b/dt)(τ − τ̂⁻)
        A[2:] = [[a, 0.0, 1 - a, (1 - a) * dt], [b / dt, 0.0, -b / dt, 1 - b]]
        # u = −k_p τ − k_d τ̂̇, with the estimate updated by τ
        A[:2] -= np.outer(push, k_d * A[3] + [self.gain, 0.0, 0.0, 0.0])
        return float(np.abs(np.linalg.eigvals(A)).max())
