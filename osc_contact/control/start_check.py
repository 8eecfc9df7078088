"""Checks of a controller at its start: joint positions in their limits, wrist readings of the load.

`Measurement.wrenches` includes the weight of the bodies outboard of the sensor. Before any contact
is made, a reading that differs from this weight is not a contact force: its gravity convention,
sign, axes or the payload is wrong, or a tare is missing.
"""

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.control.controller_settings import Settings
from osc_contact.control.controller_state import ControllerState
from osc_contact.control.records import TickRecords
from osc_contact.dynamics.assembly import require_in_range
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement
from osc_contact.robots.model import position_limits
from osc_contact.spatial import Array, norm

RANGE = 0.05  #: permitted start position beyond a joint's limits, as a share of its range
CLEAR = 1e-3  #: gap above which a contact is open (m, rad)
WINDOW_S = 0.05  #: duration of the readings whose median is compared (s)
FEWEST = 5  #: least number of readings
LEVER = 0.2  #: least lever arm of `load_error` in the limit of the torque (m)
NOTHING = 1e-9  #: share of the weight below which readings (N, N m) count as exact zeros
LIKE = 0.25  #: share of the weight within which readings match a likely cause


class StartCheck:
    """Checks during the first ticks of one controller.

    Attributes:
        done: True once all checks are completed.
        refused: sentence on a failed check, because of which the controller does not run; else
            empty.
        readings: (6,) wrist readings less `bias_out` and less the inertial force of the desired
            acceleration, at O (N, N m), one for each tick.
        expected: (6,) `bias_out` of the last tick (N, N m).
    """

    def __init__(self) -> None:
        """Begin before the first tick: no check is done, no readings of wrists are collected."""
        self.done = False
        self.refused = ""
        self.inside = False
        self.readings: list[Array] = []
        self.expected = np.zeros(6)

    def look(self, controller: ControllerState, measurement: Measurement) -> bool:
        """Check the joints of a measurement, and the wrists of the last computed tick.

        Args:
            controller: controller with the records of the last tick.
            measurement: measurement of the present tick.

        Returns:
            True once all checks are completed.

        Raises:
            InvalidInputError: joints outside their limits, or a wrist reading that differs from its
                load.
        """
        if self.refused:
            raise InvalidInputError(self.refused)
        settings = controller.settings
        rows = controller.records
        if not self.inside:
            require_start(settings.chain, measurement.q)
            self.inside = True
        if settings.contacts and settings.safety.load_error < np.inf:
            if not rows.memory.ticked or rows.work.reason:
                return False
            if is_clear(settings, rows):
                inertial = np.zeros(6)
                inertial[:3] = settings.chain.outboard_mass * rows.work.A_D[:3]
                self.readings.append(controller.residual_wrench() - inertial)
                self.expected = controller.result().bias_out.copy()
                if len(self.readings) < max(FEWEST, WINDOW_S / settings.dt):
                    return False
            elif len(self.readings) < FEWEST:
                self.readings = []
            if controller.engaged:  # otherwise `Controller.engage` calls `judge`
                self.judge(controller)
            if self.refused:
                raise InvalidInputError(self.refused)
        self.done = True
        return True

    def judge(self, controller: ControllerState) -> None:
        """Compare the median of the readings with the limit, and set `refused` if it is exceeded.

        With a tare nothing is compared, because the tare was measured at another time.

        Args:
            controller: controller before its first torques.
        """
        if self.readings and not controller.f_tare.any():
            error = np.median(self.readings, axis=0)
            settings = controller.settings
            self.refused = judge_load(
                settings.chain, settings.safety.load_error, error, self.expected
            )
            self.done = self.done and not self.refused


def require_start(chain: ClosedChain, q: Array) -> None:
    """Refuse measured joint positions that are far outside the joints' limits.

    Args:
        chain: the arms, with the limits.
        q: (n,) measured positions (rad, m).

    Raises:
        InvalidInputError: a position is outside by more than 5 % of the joint's range.
    """
    lower, upper = position_limits(chain.model)
    require_in_range("measured q", chain, q, RANGE * upper - RANGE * lower)


def is_clear(settings: Settings, rows: TickRecords) -> bool:
    """True if all contacts of the controller are open, so that no contact force acts.

    A contact that only pushes is open if each gap exceeds `CLEAR`; an overlap is a contact, since a
    soft face yields by more than `CLEAR`. A contact that transmits forces of either sign (a hinge,
    a hole) is open if each error exceeds `CLEAR` in magnitude.

    Args:
        settings: settings with the contacts.
        rows: `TickRecords` of a computed tick.
    """
    X_WO = SE3(rows.work.X_WO)
    for pair, motion in zip(settings.contacts, rows.work.bodies.motion, strict=True):
        X_WE = SE3(motion[:16].reshape(4, 4)) if rows.work.moving else None
        gaps = pair.gaps(X_WO, X_WE)
        distances = gaps if pushes_only(pair) else np.abs(gaps)
        if not (distances > CLEAR).all():
            return False
    return True


def judge_load(
    chain: ClosedChain, limit: float, error: Array, expected: Array, stepped: bool = False
) -> str:
    """Sentence on wrist readings that differ from the load, with the likely cause; else empty.

    Args:
        chain: model of the arms.
        limit: largest permitted error of the force (N), `SafetySettings.load_error`.
        error: (6,) readings less the load, at O in world axes (N, N m).
        expected: (6,) load by the model, at O in world axes (N, N m).
        stepped: True if the robot was commanded before, so that exact zeros are readings.
    """
    # the limit of the force at the lever of the load is that of the torque
    levers = (norm(link.inertia.lever) for links in chain.outboard for link in links)
    lever = max([LEVER, *levers])
    force, torque = map(norm, np.split(error, 2))
    if force <= limit and torque <= limit * lever:
        return ""
    # likely causes, each recognised by the reading that it would give: reading = error + expected
    weight = norm(expected[:3])
    if not stepped and norm(error + expected) < NOTHING * weight:
        cause = (
            "The readings are exactly zero, as of a sensor that was not read yet, or of a "
            "simulation that was not stepped yet: step once under torques that hold the arm, and "
            "check again. If zeros remain, the sensor is not connected"
        )
    elif norm(error[:3] + expected[:3]) < LIKE * weight:
        cause = (
            "The readings seem to be without gravity, and Measurement.wrenches includes it: add "
            "the weight of what hangs on the sensor"
        )
    elif norm(error[:3] + 2.0 * expected[:3]) < LIKE * weight:
        cause = (
            "It seems that the sign is reversed: give the wrench that the arm exerts on the gripper"
        )
    else:
        cause = (
            "Likely causes: gravity is not included, the sign or the axes of the frame are "
            "others, the model lacks a payload, or there is no tare (Controller.f_tare)"
        )
    frames = ", ".join(f"frame '{arm.wrist_sensor}' of arm '{arm.name}'" for arm in chain.arms)
    reading = error + expected
    return (
        f"the wrist sensor ({frames}) reads another load than it carries, and no contact is made: "
        f"in world axes at the object's origin {_wrench_text(reading)}, expected "
        f"{_wrench_text(expected)} of {chain.outboard_mass:.3g} kg; the difference is {force:.3g} "
        f"N and {torque:.3g} N m, limit load_error = {limit:g} N ({limit * lever:.2g} N m). {cause}"
    )


def _wrench_text(wrench: Array) -> str:
    """Format a wrench (6,) with its units for a message; + 0.0 turns −0.0 into 0.0."""
    force = np.round(wrench[:3], 2) + 0.0
    torque = np.round(wrench[3:], 3) + 0.0
    return f"{force.tolist()} N, {torque.tolist()} N m"
