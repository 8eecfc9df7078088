"""References towards goals that arrive more rarely than control periods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import force_owners
from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.set_point import PoseSetPoint, SetPoint
from osc_contact.errors import InvalidInputError, did_you_mean
from osc_contact.interface import Reference
from osc_contact.jerk_limits import JerkLimits
from osc_contact.spatial import Array, as_array

#: Limits of a goal follower where none are given; along the diagonal of three axes its speed stays
#: below the default `speed_ceiling` of `SafetySettings`.
LINEAR = JerkLimits(velocity=0.25, acceleration=2.0, jerk=40.0)  # m/s, m/s², m/s³
ANGULAR = JerkLimits(velocity=1.0, acceleration=8.0, jerk=150.0)  # rad/s, rad/s², rad/s³
FORCE = JerkLimits(velocity=200.0, acceleration=4e3, jerk=2e5)  # N/s, N/s², N/s³


class GoalFollower:
    """Smooth references towards goals of pose and force, one for each control period.

    A policy, a planner or an operator gives goals at 10 to 50 Hz; the controller needs references
    at its own rate, without jumps. Needs the extra `sim` (ruckig).

    Args:
        contacts: pairs of the controller, in its order.
        start: pose of the object where it rests at first.
        dt: control period (s).
        linear: limits along each world axis (m/s, m/s², m/s³).
        angular: limits about each world axis (rad/s, rad/s², rad/s³).
        force: limits of each contact's force (N/s, N/s², N/s³).

    Raises:
        InvalidInputError: arguments out of range or of the wrong kind.

    Example:
        >>> table = osc.VertexOnFace([0, 0, 0], point=[0.4, 0, 0.1], normal=[0, 0, 1], name="table")
        >>> goals = osc.GoalFollower([table], pin.SE3.Identity(), dt=1e-3)
        >>> goals.aim(pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0])), {"table": 5.0})
        >>> way = [goals.step() for tick in range(2000)]
        >>> print(way[-1].X_WD.translation.round(3), way[-1].alpha_d.round(3))
        [0.1 0.  0. ] [5.]
    """

    def __init__(
        self,
        contacts: Sequence[ContactPair],
        start: pin.SE3,
        dt: float,
        *,
        linear: JerkLimits = LINEAR,
        angular: JerkLimits = ANGULAR,
        force: JerkLimits = FORCE,
    ) -> None:
        """Begin at rest at `start` without forces.

        Args:
            contacts: pairs of the controller, in its order.
            start: pose of the object.
            dt: control period (s).
            linear, angular, force: limits (m/s …, rad/s …, N/s …).

        Raises:
            InvalidInputError: arguments out of range or of the wrong kind.
        """
        self._owners = force_owners(contacts)  #: (r,) index of the contact of each column of N
        self._names = [pair.name for pair in contacts]  #: names of the contacts
        #: generator of poses on the way to the goal
        self._pose = PoseSetPoint(start, linear, angular, dt)
        self._goal = start  #: desired pose at the end of the way
        #: (r,) desired forces at the end of the way (N)
        self._alpha_d = np.zeros(len(self._owners))
        #: generator of forces on the way; None without contacts
        self._force = SetPoint(self._alpha_d, force, dt) if len(self._owners) else None

    def aim(self, goal: pin.SE3 | None = None, forces: Mapping[str, float] | None = None) -> None:
        """Set new goals; the way to them begins at the present reference.

        Args:
            goal: pose of the object; None: as before.
            forces: force by name of a contact (N), distributed evenly over its columns of N;
                contacts that are not named keep their goals. None: as before.

        Raises:
            InvalidInputError: a pose that is not finite, or a contact that does not exist; the
                former goals are kept.
        """
        alpha_d = self._alpha_d.copy()
        for name, force in (forces or {}).items():
            if name not in self._names:
                raise InvalidInputError(
                    f"there is no contact {name!r}; {did_you_mean(name, self._names)}"
                )
            columns = self._owners == self._names.index(name)
            alpha_d[columns] = float(as_array(f"force of {name}", force, ())) / columns.sum()
        if goal is not None:
            if not isinstance(goal, pin.SE3) or not np.isfinite(goal.homogeneous).all():
                raise InvalidInputError(f"the goal is {goal}; give a finite pin.SE3")
            self._goal = goal
        self._alpha_d = alpha_d

    def step(self) -> Reference:
        """Return the reference one control period later."""
        forces: Array = np.zeros(0)
        if self._force is not None:
            forces = self._force.step(self._alpha_d).value
        return self._pose.step(self._goal, forces)

    def reset(self, X: pin.SE3) -> None:
        """Rest at the pose X of the object without forces from now on, for example after a stop."""
        self._pose.reset(X)
        self._goal = X
        self._alpha_d = np.zeros(len(self._owners))
        if self._force is not None:
            self._force.reset(self._alpha_d)
