"""Parts that judges of faults share: changed readings, torques, limits of joints, rest, brakes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import osc_contact as osc
from benchmarks.faults import POST_SEEN_AFTER, Fault, Trial
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.loop.judge import Plant, Truths
from osc_contact.spatial import Array

STOP_WITHIN = 0.3  #: time for which a joint may be beyond its limits without a stop (s)
REST_AFTER = 0.5  #: time after a stop after which the arms are at rest (s)
#: N, least force of a contact: shares of contacts that do not touch are zero but for rounding
LEAST_FORCE = 1e-3
LIGHT = 1.0  #: N, least command of a contact whose loss is judged
LOOKS = 200  #: number of looks at contacts that are evaluated together, which is faster
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


class ContactWatch:
    """True contacts at many instants: forces, contacts that opened unnoticed, impacts.

    Attributes:
        force: largest magnitude of a contact force (N).
        forces: largest magnitude of a contact force at each look that was evaluated (N).
        open_s: longest time that a contact that was commanded and made was open, and the controller
            took it as closed (s).
        impacts: (r,) largest force of an impact with which each column was closed, or in which its
            force became negative: on a face behind (N).
    """

    def __init__(self, rig: osc.Rig, plant: Plant, period: float) -> None:
        """Look for the first time.

        Args:
            rig: rig with the contacts.
            plant: plant that knows the truth.
            period: period of the looks (s).
        """
        self._rig = rig
        self._period = period
        self._log = plant.log()
        self._owners = np.asarray(rig.owners)
        self._lines = rig.contact.N if rig.pairs else np.zeros((6, 0))
        self._masses = effective_masses(rig)
        self._commands: list[Array] = []  #: (r,) of each look (N)
        self._taken: list[Array] = []  #: (contacts,) of each look
        self._before = plant.truth()  #: truth of the last look that was evaluated
        self._made = np.array(self._before.closed, dtype=bool)
        self._open = np.zeros(len(rig.pairs))
        self.force = self.open_s = 0.0
        self.forces: list[float] = []
        self.impacts = np.zeros(len(self._masses))

    def look(self, commands: Array, taken: Array) -> None:
        """Note the present state.

        Args:
            commands: (r,) magnitudes of the desired forces (N).
            taken: (contacts,) whether the controller takes each contact as closed.
        """
        self._log.note()
        self._commands.append(commands)
        self._taken.append(taken)
        if len(self._taken) == LOOKS:
            self.evaluate()

    def evaluate(self) -> None:
        """Evaluate the looks since the last call."""
        if not self._taken:
            return
        truths = self._log.truths(self._log.noted())
        self.forces.extend(np.abs(truths.alpha).max(axis=1, initial=0.0).tolist())
        self.force = max(self.force, *self.forces[-len(self._taken) :])
        self._add_impacts(truths)
        wanted = np.array(self._commands) > LIGHT
        for i in range(len(self._open)):
            is_wanted: Array = np.any(wanted[:, self._owners == i], axis=1)
            for k in range(len(wanted)):
                is_closed = bool(truths.closed[k, i])
                self._made[i] |= is_closed
                unseen = is_wanted[k] and self._taken[k][i] and self._made[i] and not is_closed
                self._open[i] = self._open[i] + self._period if unseen else 0.0
                self.open_s = max(self.open_s, float(self._open[i]))
        self._before = truths[-1]
        self._log.clear()
        self._commands.clear()
        self._taken.clear()

    def _add_impacts(self, truths: Truths) -> None:
        """Add the impacts of contacts that have closed since the look before, and of faces behind.

        A contact of MuJoCo that is met by a mass m with a speed v presses with at most 2 m v / T,
        T the time constant of `solref`: its damper has 2/T, and it is not damped less than
        critically. An object with play may also meet the other side of the body that it is pressed
        against, such as the wall of a hole behind it: then the force along a column becomes
        negative.

        Args:
            truths: truths of the looks.
        """
        plant = self._rig.scenario.plant
        if plant.type != "mujoco" or not len(self.impacts):
            return
        before = self._before
        speeds = np.abs(np.vstack((before.V_O, truths.V_O[:-1])) @ self._lines)
        closed = np.vstack((before.closed, truths.closed)).astype(bool)
        pulls = np.vstack((before.alpha, truths.alpha)) < -LEAST_FORCE
        closes = (closed[1:] & ~closed[:-1])[:, self._owners]
        meets = closes | (pulls[1:] & ~pulls[:-1])
        forces = 2.0 * self._masses * speeds / plant.solref[0]
        self.impacts = np.maximum(self.impacts, np.where(meets, forces, 0.0).max(axis=0))


def growth_to(ceiling: float, forces: Sequence[float], looks: int) -> float:
    """Growth of a force in so many looks before it first exceeded a ceiling (N); 0: it did not.

    Args:
        ceiling: the ceiling (N).
        forces: the force at each look (N).
        looks: number of looks in the time that a force may be above the ceiling.
    """
    above = next((k for k, force in enumerate(forces) if force > ceiling), 0)
    return ceiling - min(forces[max(above - looks, 0)], ceiling) if above else 0.0


def effective_masses(rig: osc.Rig) -> Array:
    """(r,) masses (kg) of arms and object along the lines of the contact forces."""
    if not rig.pairs:
        return np.zeros(0)
    N = rig.contact.N
    return np.asarray(1.0 / np.einsum("ij,ik,kj->j", N, rig.state.Phi, N))


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
