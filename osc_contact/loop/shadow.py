"""Shadow mode: the robot moves by hand under its own weight alone, and its model is judged.

The controller computes every tick, and nothing of it is sent. What the joints do under the torques
that were sent and the wrench that the wrist reads is compared with the model, joint by joint:

    τ − κ Jᵀf − (M q̈ + h) = c sign(q̇) + d q̇ + o + ΔI q̈

f is the wrench that the arm exerts at the wrist sensor, and M, h are of what is inboard of it:
whatever hangs on the wrist, and whoever pushes there, needs no model.
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

REST_S = 0.2  #: from the beginning, in which nobody touches the arm
HALF = 10  #: ticks to either side over which accelerations and means are taken
EVERY = 5  #: ticks from one sample to the next
FASTEST = 0.05  #: rad/s (m/s) that a joint must have reached to be judged
STILL = 0.01  #: rad/s (m/s) below which friction has no sign
FELT = 0.002  #: of the motors' limits, the least rms of torques by pushes that judge the wrench
UNEXPLAINED = 0.01  #: of a motor's limit, rms
KAPPA = 0.7, 1.3  #: between which the wrench counts as right
TOO_LARGE = 0.05  #: of a motor's limit; as `SafetySettings.wrist_error`
BIAS = 2.0, 0.4  #: N, N m; as `SafetySettings.load_error`


@dataclass(frozen=True)
class JointFinding:
    """What one joint does beside its model.

    Attributes:
        name: of the joint. moved: whether it was fast enough to be judged.
        coulomb: dry friction (N m; N). viscous: friction that grows with speed (N m s/rad).
        offset: constant torque (N m). inertia: kg m² that the model lacks, such as of the rotor.
        rms: N m, left unexplained.
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
    """What shadow mode found.

    Attributes:
        joints: one finding each.
        wrench_bias: (6,) of the wrist at rest, less what hangs on it, in world axes at the object
            (N, N m).
        wrench_scale: κ, how much of the wrench that the wrist reads the joints feel: 1 where sign,
            scale and frame are right, −1 where the sign is reversed; NaN: nobody pushed.
        findings: sentences on what is wrong. forces: whether forces may be commanded: none is.
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
        """The report, for people."""
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
    """One run in shadow mode."""

    def __init__(self, controller: Any) -> None:
        """Begin.

        Raises:
            InvalidInputError: not one arm with a wrist sensor, all of whose joints have motors.
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
        """(n,) what is sent: the weight of the model; the tick is noted."""
        q = np.asarray(measurement.q, dtype=float)
        sent = np.array(pin.computeGeneralizedGravity(self.chain.model, self.data, q))
        sent = np.clip(np.nan_to_num(sent), -self.chain.tau_max, self.chain.tau_max)
        self.rows.append(np.concatenate((q, measurement.v, sent, measurement.wrenches[0])))
        return sent

    def report(self) -> ShadowReport:
        """Judge what was noted.

        Raises:
            InvalidInputError: less than a second was.
        """
        n = self.chain.nq
        rows = np.reshape(self.rows, (-1, 3 * n + 6))
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) * self.dt < 1.0:
            raise InvalidInputError(
                f"shadow mode noted {len(rows) * self.dt:.3g} s; let it run for ten seconds, and "
                "move every joint by hand"
            )
        rest = rows[: round(REST_S / self.dt) : EVERY]
        bias = np.mean([self._outside(r[:n], r[3 * n :]) for r in rest], axis=0)
        around = range(HALF, len(rows) - HALF, EVERY)
        samples = [self._sample(rows[k - HALF : k + HALF + 1]) for k in around]
        v, acceleration, left, felt = (np.array(x) for x in zip(*samples, strict=True))
        kappa = self._scale(v, acceleration, left, felt)
        used = 1.0 if np.isnan(kappa) else kappa
        joints = tuple(
            self._joint(j, v[:, j], acceleration[:, j], left[:, j] - used * felt[:, j])
            for j in range(n)
        )
        return ShadowReport(joints, bias, kappa, list(self._judge(joints, bias, kappa)))

    def _outside(self, q: Array, wrench: Array) -> Array:
        """(6,) reading less the load, at the object in world axes."""
        state = self.chain.state(q)
        origin = pin.SE3(np.eye(3), state.X_WO.translation)
        sensor = state.sensors[0]
        assert sensor is not None
        return origin.actInv(sensor.act(pin.Force(wrench))).vector - state.bias_out

    def _sample(self, rows: Array) -> tuple[Array, ...]:
        """Speed, acceleration, τ − (M q̈ + h) and Jᵀf, means over a few ticks."""
        n = self.chain.nq
        q, v, sent, wrench = np.split(rows.mean(axis=0), [n, 2 * n, 3 * n])
        acceleration = (rows[-1, n : 2 * n] - rows[0, n : 2 * n]) / (2 * HALF * self.dt)
        needed = np.array(pin.rnea(self.inboard, self.data, q, v, acceleration))
        J = columns_of(pin.computeFrameJacobian(self.inboard, self.data, q, self.chain.sensors[0]))
        return v, acceleration, sent - needed, J.T @ wrench

    def _scale(self, v: Array, acceleration: Array, left: Array, felt: Array) -> float:
        """κ, from all joints together; each has its own friction and rotor."""
        over = under = 0.0
        for j, most in enumerate(self.chain.tau_max):
            own = _columns(v[:, j], acceleration[:, j])
            both = np.column_stack((left[:, j], felt[:, j]))
            torque, push = (both - own @ np.linalg.lstsq(own, both)[0]).T / most
            over += torque @ push
            under += push @ push
        return over / under if under > FELT**2 * felt.size else float("nan")

    def _joint(self, j: int, v: Array, a: Array, torque: Array) -> JointFinding:
        moved = bool(np.abs(v).max() > FASTEST)
        columns = _columns(v, a)
        found = np.linalg.lstsq(columns, torque)[0]
        rms = float(np.sqrt(np.mean((torque - columns @ found) ** 2)))
        coulomb, viscous, offset, inertia = found.tolist()
        name = self.chain.joint_names[j]
        return JointFinding(name, moved, coulomb, viscous, offset, inertia, rms)

    def _judge(self, joints: tuple[JointFinding, ...], bias: Array, kappa: float) -> Iterator[str]:
        for joint, most in zip(joints, TOO_LARGE * self.chain.tau_max, strict=True):
            if not joint.moved:
                yield f"joint '{joint.name}' was not moved; push the tool so that it turns"
                continue
            for what, value in (("friction", joint.coulomb), ("a torque offset", joint.offset)):
                if abs(value) > most:
                    yield (
                        f"joint '{joint.name}' has {what} of {value:.2g} N m, more than {most:.2g} "
                        "N m, which the model does not explain: give the arm its friction, or "
                        "correct its masses"
                    )
            if joint.rms > UNEXPLAINED / TOO_LARGE * most:
                yield (
                    f"joint '{joint.name}' leaves {joint.rms:.2g} N m unexplained: is it, or a "
                    "joint near it, reversed or out of order, or the wrench of another frame?"
                )
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


def _columns(v: Array, a: Array) -> Array:
    """Of friction, offset and inertia: what the model's torques lack."""
    sign = np.tanh(v / STILL)
    return np.column_stack((sign, v, np.ones(len(v)), a))
