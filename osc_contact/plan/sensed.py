"""Signals of a tick on which motions and conditions of a plan depend."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import force_owners
from osc_contact.control.status import Phase
from osc_contact.errors import InvalidInputError, did_you_mean
from osc_contact.recognition.recogniser import Recogniser
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from osc_contact.control.controller import Controller

SMOOTHING = 5e-3  #: s, time constant of the low-pass of measured forces


@dataclass
class Sensed:
    """Signals of a plan after a tick; everything at O, the object's origin, in world axes.

    Attributes:
        t: time since the stage began, without pauses (s).
        X: pose of the object.
        V: (6,) its twist (m/s, rad/s).
        aim: pose that the plan commands.
        V_D: (6,) twist that it commanded in the last tick.
        wrench: (6,) wrist readings less tare and less `bias_out`, low-passed with 5 ms (N, N m):
            the wrench of the object on what it touches, and the inertial force Λ_out a of all
            bodies beyond the wrist sensors.
        forces: measured force of each contact of the controller by name, the sum over its columns
            of N, low-passed with 5 ms (N); 0 where it is not active.
        phases: phase of each contact by name.
        start: pose at which the stage began.
        passed: pose at which each former stage ended last.
        finished: whether the motion of the stage has reached its end.
        N: (6, r) independent directions of force of the active contacts.
        recogniser: recogniser of the contact state of the plan, if it has one.
        unexpected: name of the recognised state if it has contacts that the stage does not assume.
    """

    X: pin.SE3
    V: Array
    aim: pin.SE3
    wrench: Array
    forces: dict[str, float]
    phases: dict[str, Phase]
    start: pin.SE3
    N: Array
    passed: dict[str, pin.SE3] = field(default_factory=dict)
    t: float = 0.0
    finished: bool = False
    V_D: Array = field(default_factory=lambda: np.zeros(6))
    recogniser: Recogniser | None = None
    unexpected: str = ""

    def where_ended(self, stage: str | None) -> pin.SE3:
        """Pose at which a stage ended last; None: at which the present stage began.

        Raises:
            InvalidInputError: the stage has not been passed.
        """
        if stage is None:
            return self.start
        if stage not in self.passed:
            raise InvalidInputError(
                f"stage {stage!r} has not been passed; {did_you_mean(stage, self.passed)}"
            )
        return self.passed[stage]


#: Condition for the end of a stage without a memory of its own.
Test = Callable[[Sensed], bool]


class Senses:
    """Reader of the signals of a controller, tick by tick.

    Args:
        controller: controller whose contacts and results are read.
        X: pose of the object where the plan begins.

    Attributes:
        signals: signals after the last call of `read`.
    """

    def __init__(self, controller: Controller, X: pin.SE3) -> None:
        """Begin with an object at rest, without forces and contacts.

        Args:
            controller: controller whose results are read in every tick.
            X: pose of the object in the world at the beginning.
        """
        self._controller = controller  #: controller of the run
        #: names of the contacts
        self._names = [pair.name for pair in controller.settings.contacts]
        #: (r,) index of the contact of each column of N
        self._owners = force_owners(controller.settings.contacts)
        #: share of a tick in the low-pass of the wrench
        self._share = controller.dt / (SMOOTHING + controller.dt)
        self._alpha = np.zeros(len(self._owners))  #: (r,) measured contact forces (N)
        self.signals = Sensed(
            X=X,
            V=np.zeros(6),
            aim=X,
            wrench=np.zeros(6),
            forces=dict.fromkeys(self._names, 0.0),
            phases=dict.fromkeys(self._names, Phase.OPEN),
            start=X,
            N=np.zeros((6, 0)),
        )

    def read(self) -> Sensed:
        """Update the signals from the controller's last tick, and return them.

        Updated are X, V, `wrench`, `forces`, `phases` and N; the other signals belong to the plan,
        which sets them. The wrench is f_meas − bias_out, at O in world axes (N, N m): readings less
        those without contact at zero acceleration of the object, so that inertial forces remain. It
        and the forces (N) are low-passed: a signal moves by `_share` of its distance to the new
        value. Nothing is updated if no tick has been computed yet.
        """
        controller = self._controller
        if not controller.records.memory.ticked:
            return self.signals
        signals = self.signals
        result = controller.result()
        active = controller.active
        signals.X = pin.SE3(result.X_WO)
        signals.V = np.array(result.V_O)
        signals.wrench = signals.wrench + self._share * (
            result.f_meas - result.bias_out - signals.wrench
        )
        # forces of the columns (N), zero where a contact is not active, and their sums by contact
        alpha = np.array(controller.records.memory.columns.alpha)
        alpha[~active[self._owners]] = 0.0
        self._alpha += self._share * (alpha - self._alpha)
        self._alpha[~active[self._owners]] = 0.0
        sums = np.bincount(self._owners, self._alpha, len(self._names))
        phases = controller.phases()
        for k, name in enumerate(self._names):
            signals.forces[name] = float(sums[k])
            signals.phases[name] = Phase(int(phases[k]))
        signals.N = result.columns.N[controller.records.kept()].T.copy()
        return signals

    def force_error(self, alpha_d: Array) -> float:
        """Sum over the closed contacts of the squared errors of their forces (N²).

        Args:
            alpha_d: (r,) desired forces (N).
        """
        closed = self._controller.phases()[self._owners] == Phase.CLOSED
        measured = np.array(self._controller.records.memory.columns.alpha)
        return float(np.sum((measured - alpha_d)[closed] ** 2))


def forces_of(
    forces: Mapping[str, float | Sequence[float]], names: Sequence[str], owners: Array
) -> tuple[Array, Array]:
    """Desired forces (r,) of all columns, and mask (contacts,) of the active contacts.

    Args:
        forces: force of each active contact by its name (N), distributed evenly over its columns of
            N, or a force for each of them.
        names: names of all contacts of the controller.
        owners: (r,) index of the contact of each column.

    Raises:
        InvalidInputError: a contact that does not exist, or other numbers of forces.
    """
    alpha_d = np.zeros(len(owners))
    active = np.zeros(len(names))
    for name, force in forces.items():
        if name not in names:
            raise InvalidInputError(f"there is no contact {name!r}; {did_you_mean(name, names)}")
        columns = owners == names.index(name)
        values = np.atleast_1d(np.asarray(force, dtype=np.float64))
        if values.shape == (1,) and np.ndim(force) == 0:
            values = np.full(columns.sum(), values[0] / columns.sum())
        if values.shape != (columns.sum(),) or not np.isfinite(values).all():
            raise InvalidInputError(
                f"contact {name!r} has {columns.sum()} columns of N, and its forces are {force!r}; "
                "give a number, or a number for each column (N)"
            )
        alpha_d[columns] = values
        active[names.index(name)] = 1.0
    return alpha_d, active
