"""Shadow mode: the arm is moved by hand under gravity compensation, and its model is checked.

The controller computes every tick, but its torques are not sent. The motion of the joints under the
torques that are sent (gravity compensation) and the measured wrench is compared with the model,
joint by joint:

    τ − κ Jᵀf − (M q̈ + h) = c sign(q̇) + d q̇ + o + ΔI q̈

f is the wrench that the arm exerts at the wrist sensor; M and h are those of the bodies inboard of
the sensor, so that no model of the tool or of the hand that pushes it is needed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement
from osc_contact.spatial import Array, columns_of, norm

REST_S = 0.2  #: s at the beginning during which the arm is not touched
HALF = 10  #: ticks to either side over which accelerations and means are taken
EVERY = 5  #: ticks between samples
FASTEST = 0.05  #: rad/s (m/s), speed that a joint must reach to be checked
STILL = 0.01  #: rad/s (m/s), speed below which the sign of friction is regularised
FELT = 0.002  #: least rms torque by pushes with which κ is determined, as a share of motor limits
UNEXPLAINED = 0.01  #: largest rms of unexplained torques, as a share of a motor's limit
KAPPA = 0.7, 1.3  #: accepted range of κ
TOO_LARGE = 0.05  #: largest friction or offset, as a share of a motor's limit
BIAS = 2.0, 0.4  #: largest bias of the wrist (N, N m)


@dataclass(frozen=True)
class JointFinding:
    """Deviation of one joint from its model.

    Attributes:
        name: name of the joint.
        moved: True if it was fast enough to be checked.
        coulomb: dry friction (N m; N).
        viscous: viscous friction (N m s/rad; N s/m).
        offset: constant torque (N m; N).
        inertia: inertia that the model lacks, for example of a rotor (kg m²; kg).
        rms: rms of the unexplained torque (N m; N).
    """

    name: str
    moved: bool
    coulomb: float
    viscous: float
    offset: float
    inertia: float
    rms: float


@dataclass(frozen=True)
class ShadowReport:
    """Result of a run in shadow mode.

    Attributes:
        joints: one finding for each joint.
        wrench_bias: (6,) reading of the wrist at rest less the modelled load, in world axes at the
            object's origin (N, N m).
        wrench_scale: κ, the measured wrench's share that the joints confirm: 1 if sign, scale and
            frame are right, −1 if the sign is reversed; NaN if the arm was not pushed.
        findings: sentences on errors that were found.
        forces: True if there are none, so that forces may be commanded.
    """

    joints: tuple[JointFinding, ...]
    wrench_bias: Array
    wrench_scale: float
    findings: list[str] = field(default_factory=list)

    @property
    def forces(self) -> bool:
        """Whether forces may be commanded."""
        return not self.findings

    def lines(self) -> Iterator[str]:
        """Yield the lines of the report, to be printed.

        For each joint that was moved friction, offset (N m), missing inertia (kg m²) and the rms of
        the torque that these leave unexplained (N m); then bias and scale κ of the wrist's wrench;
        then the findings, because of which forces may not be commanded.
        """
        for joint in self.joints:
            if not joint.moved:
                yield f"{joint.name}: not moved"
                continue
            yield (
                f"{joint.name}: friction {joint.coulomb:.2f} N m + {joint.viscous:.2f} N m s/rad, "
                f"offset {joint.offset:.2f} N m, inertia {joint.inertia:+.3f} kg m², "
                f"unexplained {joint.rms:.2f} N m"
            )
        force = np.round(self.wrench_bias[:3], 2)
        moment = np.round(self.wrench_bias[3:], 3)
        yield f"wrist: bias {force.tolist()} N, {moment.tolist()} N m; κ = {self.wrench_scale:.2f}"
        yield from self.findings or ["forces may be commanded"]


class Shadow:
    """Run in shadow mode: torques of gravity compensation, and measurements to judge the model."""

    def __init__(self, controller: Any) -> None:
        """Prepare a run.

        Args:
            controller: `Controller` of a single arm with a wrist sensor and a motor in every joint.

        Raises:
            InvalidInputError: the controller is of another kind.
        """
        chain: ClosedChain | None = getattr(controller, "chain", None)
        if chain is None or len(chain.arms) != 1 or chain.n_a != chain.nq or None in chain.sensors:
            raise InvalidInputError(
                "shadow mode judges one arm with a wrist sensor, all of whose joints have motors; "
                "run arms that hold one object each by itself"
            )
        self.chain = chain
        self.dt = controller.dt
        self.data = chain.model.createData()
        self.inboard = chain.model.copy()
        for link in chain.outboard[0]:
            self.inboard.inertias[link.joint] -= link.inertia
        self.rows: list[Array] = []

    def torques(self, measurement: Measurement) -> Array:
        """Torques (n,) that compensate the weight of the model (N m, N); stores the measurement."""
        q = np.asarray(measurement.q, dtype=float)
        tau = np.array(pin.computeGeneralizedGravity(self.chain.model, self.data, q))
        tau = np.clip(np.nan_to_num(tau), -self.chain.tau_max, self.chain.tau_max)
        self.rows.append(np.concatenate((q, measurement.v, tau, measurement.wrenches[0])))
        return tau

    def report(self) -> ShadowReport:
        """Compare the stored measurements with the model.

        The bias of the wrist is the mean of its readings at rest, less the load. From windows of
        measurements follow speed, acceleration, the torques that the model leaves unexplained, and
        those of pushes by hand; κ is the scale of the wrist's reading that explains them best.
        Friction, offset and inertia of each joint are fitted to the rest.

        Raises:
            InvalidInputError: less than a second of measurements.
        """
        n = self.chain.nq
        rows = np.reshape(self.rows, (-1, 3 * n + 6))
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) * self.dt < 1.0:
            raise InvalidInputError(
                f"shadow mode noted {len(rows) * self.dt:.3g} s; let it run for ten seconds, and "
                "move every joint by hand"
            )
        rows_at_rest = rows[: round(REST_S / self.dt) : EVERY]
        bias = np.mean(
            [self._unmodelled_wrench(row[:n], row[3 * n :]) for row in rows_at_rest], axis=0
        )
        centres = range(HALF, len(rows) - HALF, EVERY)
        samples = [self._mean_sample(rows[k - HALF : k + HALF + 1]) for k in centres]
        v, acceleration, remainder, push = (np.array(x) for x in zip(*samples, strict=True))
        kappa = self._confirmed_share(v, acceleration, remainder, push)
        scale = 1.0 if np.isnan(kappa) else kappa
        torques = remainder - scale * push
        joints = tuple(
            self._fit_joint(j, v[:, j], acceleration[:, j], torques[:, j]) for j in range(n)
        )
        return ShadowReport(joints, bias, kappa, list(self._unsafe_errors(joints, bias, kappa)))

    def _unmodelled_wrench(self, q: Array, wrench: Array) -> Array:
        """Wrist reading less the modelled load (6,), at the object's origin in world axes (N, N m).

        Args:
            q: (n,) joint positions (m, rad).
            wrench: (6,) reading of the wrist, in the sensor's frame (N, N m).
        """
        state = self.chain.state(q)
        origin = pin.SE3(np.eye(3), state.X_WO.translation)
        sensor = state.sensors[0]
        assert sensor is not None
        return origin.actInv(sensor.act(pin.Force(wrench))).vector - state.bias_out

    def _mean_sample(self, rows: Array) -> tuple[Array, ...]:
        """Means over a few ticks: the motion of the joints, and torques beyond the model's.

        Args:
            rows: (2 HALF + 1, 3n + 6) q, v, sent torques and wrench of consecutive ticks.

        Returns:
            Speeds v, accelerations q̈, remainder τ − (M q̈ + h) of the sent torques, and torques
            Jᵀf of the measured wrench; (n,) each.
        """
        n = self.chain.nq
        q, v, tau, wrench = np.split(rows.mean(axis=0), [n, 2 * n, 3 * n])
        acceleration = (rows[-1, n : 2 * n] - rows[0, n : 2 * n]) / (2 * HALF * self.dt)
        modelled = np.array(pin.rnea(self.inboard, self.data, q, v, acceleration))
        J = columns_of(pin.computeFrameJacobian(self.inboard, self.data, q, self.chain.sensors[0]))
        return v, acceleration, tau - modelled, J.T @ wrench

    def _confirmed_share(
        self, v: Array, acceleration: Array, remainder: Array, push: Array
    ) -> float:
        """Estimate by least squares the share κ of the measured wrench that the joints confirm.

        The parts of both torques that friction, offset and inertia of a joint explain are removed
        before remainder = κ push is solved for all joints together, each over its motor's limit.

        Args:
            v, acceleration: (k, n) motion of the joints (rad/s, rad/s²; m/s, m/s²).
            remainder: (k, n) torques that the model does not explain (N m, N).
            push: (k, n) torques Jᵀf of the measured wrench (N m, N).

        Returns:
            κ, 1 for a perfect wrist sensor; NaN if the pushes were too small.
        """
        numerator = 0.0
        denominator = 0.0
        for j, tau_max in enumerate(self.chain.tau_max):
            regressors = _regressors(v[:, j], acceleration[:, j])
            signals = np.column_stack((remainder[:, j], push[:, j]))
            explained_torque = regressors @ np.linalg.lstsq(regressors, signals)[0]
            joint_remainder, joint_push = (signals - explained_torque).T / tau_max
            numerator += joint_remainder @ joint_push
            denominator += joint_push @ joint_push
        if not denominator > FELT**2 * push.size:
            return float("nan")
        return numerator / denominator

    def _fit_joint(self, j: int, v: Array, a: Array, torque: Array) -> JointFinding:
        """Fit friction, offset and inertia of a joint to the torque beyond the model.

        Args:
            j: index of the joint.
            v, a: (k,) speeds and accelerations of the joint (rad/s, rad/s²; m/s, m/s²).
            torque: (k,) torque beyond the model's (N m, N).
        """
        has_moved = bool(np.abs(v).max() > FASTEST)
        regressors = _regressors(v, a)
        parameters = np.linalg.lstsq(regressors, torque)[0]
        rms = float(np.sqrt(np.mean((torque - regressors @ parameters) ** 2)))
        coulomb, viscous, offset, inertia = parameters.tolist()
        name = self.chain.joint_names[j]
        return JointFinding(name, has_moved, coulomb, viscous, offset, inertia, rms)

    def _unsafe_errors(
        self, joints: tuple[JointFinding, ...], bias: Array, kappa: float
    ) -> Iterator[str]:
        """Yield a sentence on each error of model or sensor, because of which forces are unsafe.

        Args:
            joints: fitted deviations of the joints.
            bias: (6,) reading of the wrist at rest less the modelled load (N, N m).
            kappa: share of the measured wrench that the joints confirm; NaN: unknown.
        """
        yield from self._judge_joints(joints)
        yield from self._judge_wrench(bias, kappa)

    def _judge_joints(self, joints: tuple[JointFinding, ...]) -> Iterator[str]:
        """Yield a sentence on each joint that was not moved or deviates from its model.

        Args:
            joints: fitted deviations, one of each joint of the chain.
        """
        for joint, limit in zip(joints, TOO_LARGE * self.chain.tau_max, strict=True):
            if not joint.moved:
                yield f"joint '{joint.name}' was not moved; push the tool so that it turns"
                continue
            for cause, value in (("friction", joint.coulomb), ("a torque offset", joint.offset)):
                if abs(value) > limit:
                    yield (
                        f"joint '{joint.name}' has {cause} of {value:.2g} N m, more than "
                        f"{limit:.2g} N m, which the model does not explain: give the arm its "
                        "friction, or correct its masses"
                    )
            if joint.rms > UNEXPLAINED / TOO_LARGE * limit:
                yield (
                    f"joint '{joint.name}' leaves {joint.rms:.2g} N m unexplained: is it, or a "
                    "joint near it, reversed or out of order, or the wrench of another frame?"
                )

    def _judge_wrench(self, bias: Array, kappa: float) -> Iterator[str]:
        """Yield a sentence on bias, sign and scale of the wrist sensor if one of them is wrong.

        Args:
            bias: (6,) reading of the wrist at rest less the modelled load (N, N m).
            kappa: share of the measured wrench that the joints confirm; NaN: unknown.
        """
        if norm(bias[:3]) > BIAS[0] or norm(bias[3:]) > BIAS[1]:
            yield (
                f"the wrist reads {np.round(bias, 2).tolist()} N, N m more at rest than hangs on "
                "it: tare it (Controller.f_tare), or correct the payload"
            )
        if np.isnan(kappa):
            yield "the tool was hardly pushed; the sign of the wrench is not known"
        elif kappa < -0.4:
            yield f"the wrench is reversed (κ = {kappa:.2f}): give what the arm exerts on its tool"
        elif not KAPPA[0] < kappa < KAPPA[1]:
            yield (
                f"the joints feel {kappa:.2f} of the wrench that the wrist reads: its scale or the "
                "axes of its frame are wrong, or the arm was not pushed at the tool"
            )


def _regressors(v: Array, a: Array) -> Array:
    """Regressors (k, 4) of a joint's torque: dry and viscous friction, offset and inertia.

    The sign of the speed, for dry friction, is smoothed by tanh at speeds below `STILL`.

    Args:
        v, a: (k,) speeds and accelerations of one joint (rad/s, rad/s²; m/s, m/s²).
    """
    sign = np.tanh(v / STILL)
    return np.column_stack((sign, v, np.ones(len(v)), a))
