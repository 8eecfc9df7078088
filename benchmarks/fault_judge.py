"""Parts that judges of faults share: changed readings, torques, limits of joints, rest, brakes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.faults import POST_SEEN_AFTER, Fault, Trial
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.spatial import Array

STOP_WITHIN = 0.3  #: time for which a joint may be beyond its limits without a stop (s)
REST_AFTER = 0.5  #: time after a stop after which the arms are at rest (s)
REST_SPEED = 0.1  #: largest speed of a joint at rest (rad/s, m/s)


class FaultySensors:
    """A robot whose readings a fault changes before velocities are estimated from them.

    Attributes:
        change: returns a measurement and a reference that are changed; None: no fault lasts.
        reference: the last one that was changed.
    """

    reference: Reference

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.command = robot.command
        self.stop = robot.stop
        self.change: Callable[[Measurement], tuple[Measurement, Reference]] | None = None

    def measure(self) -> Measurement:
        """Measurement of the robot, changed while a fault lasts."""
        measurement = self._robot.measure()
        if self.change is not None:
            measurement, self.reference = self.change(measurement)
        return measurement


def read(
    robot: Robot,
    sensors: FaultySensors | None,
    trial: Trial,
    reference: Reference,
    fault: Fault | None,
) -> tuple[Measurement, Reference]:
    """Measurement and reference of a tick, changed by a fault.

    Speeds are estimated from readings that the fault has changed already, unless it changes speeds
    alone.

    Args:
        robot: robot that completes the readings of its sensors.
        sensors: sensors inside this robot; None: it completes nothing.
        trial: run with the fault.
        reference: reference of the tick.
        fault: fault that lasts now; None: there is none.
    """
    if fault is None or fault.change is None:
        return robot.measure(), reference
    change = fault.change
    if sensors is None or fault.of_speeds:
        return change(trial, robot.measure(), reference)
    sensors.change = lambda measurement: change(trial, measurement, reference)
    measurement = robot.measure()
    sensors.change = None
    return measurement, sensors.reference


def disturb(fault: Fault | None, trial: Trial, tau: Array, plant: MujocoPlant) -> Array:
    """Torques (n_a,) that the motors give (N m, N); a fault of the world changes the plant.

    Args:
        fault: fault that lasts now; None: there is none.
        trial: run with the fault.
        tau: (n_a,) commanded torques (N m, N).
        plant: simulated robot.
    """
    sent = tau
    if fault is not None and fault.torque is not None:
        sent = fault.torque(trial, tau.copy())
    if fault is not None and fault.world is not None:
        fault.world(trial, plant)
    return sent


def is_beyond_limits(tau: Array, limit: Array) -> bool:
    """Test whether a torque is not finite or beyond its limit.

    Args:
        tau: (n_a,) commanded torques (N m, N).
        limit: (n_a,) limits of the torques (N m, N).
    """
    return not np.isfinite(tau).all() or bool((np.abs(tau) > limit * (1.0 + 1e-9)).any())


@dataclass
class JointWatch:
    """Time for which motor joints have been beyond their limits.

    Attributes:
        chain: arms with the limits of their joints.
        period: period of the looks (s).
        beyond: time for which a joint has been beyond its speed limit or outside its range (s).
    """

    chain: ClosedChain
    period: float
    beyond: float = 0.0

    def look(self, q: Array, speeds: Array) -> None:
        """Add a period to the time, or begin again.

        Args:
            q: (n_a,) true positions of the motor joints (rad, m).
            speeds: (n_a,) magnitudes of their true velocities (rad/s, m/s).
        """
        model, motors = self.chain.model, self.chain.actuated
        low, high = model.lowerPositionLimit[motors], model.upperPositionLimit[motors]
        is_legal = ((q >= low) & (q <= high) & (speeds <= model.velocityLimit[motors])).all()
        self.beyond = 0.0 if is_legal else self.beyond + self.period

    @property
    def needs_stop(self) -> bool:
        """Whether arms that are not stopped should have been."""
        return self.beyond > STOP_WITHIN + 1e-9


def obstacle_force(fault: Fault, trial: Trial) -> float:
    """Force (N) that an obstacle adds until it is seen.

    Args:
        fault: kind of the fault.
        trial: run with the fault, which has the speed at which the obstacle was met.
    """
    return fault.stiffness * float(trial.kept.get("speed", 0.0)) * POST_SEEN_AFTER


def may_brake(fault: Fault, estimated: bool) -> bool:
    """Test whether mechanical brakes may be requested: encoders and speeds are unsound, or a motor.

    Args:
        fault: kind of the fault.
        estimated: whether speeds are estimated from positions, and are as sound as these.
    """
    unsound = {*fault.unsound, *(["v"] if estimated else [])}
    return {"q", "v"} <= unsound or "tau" in unsound
