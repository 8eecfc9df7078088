"""End of a tick that is not OK: cause of the status, and losses by the motor limits."""

from __future__ import annotations

from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import TickRecords
from osc_contact.control.status import LimitLoss
from osc_contact.control.torque_limits import MotorLimits, apply_least_loss, scale_torques
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Reference


class TickEnd:
    """Inputs, error and losses of the last tick whose status was not OK.

    Attributes:
        inputs: measurement and reference of that tick; None before the first such tick.
        failure: error raised outside the compiled law in that tick, or None.
    """

    inputs: tuple[Measurement, Reference] | None = None
    failure: Exception | None = None
    #: loss of the last saturated tick; None: it follows from the program, or there is none
    _known_loss: LimitLoss | None = None
    #: program for torques at the motors' limits; None until it is needed
    _limit_program: MotorLimits | None = None

    def note(
        self, measurement: Measurement, reference: Reference, failure: Exception | None
    ) -> None:
        """Keep the inputs of a tick, and the error raised in it.

        Args:
            measurement: readings of the tick.
            reference: desired motion and forces of the tick.
            failure: error raised outside the compiled law, or None.
        """
        self.inputs = (measurement, reference)
        self.failure = failure
        self._known_loss = None

    def limit_torques(
        self, records: TickRecords, settings: Settings, custom_structure: bool
    ) -> None:
        """Bring the torques of a saturated tick within the motors' limits.

        Args:
            records: records of the tick; its torques are replaced.
            settings: settings of the controller.
            custom_structure: True if a custom control structure commands the object. The quadratic
                program of least losses does not apply to it, so all torques are scaled by one
                factor.

        Raises:
            SolverError: no torques within the limits were found.
        """
        if custom_structure:
            self._known_loss = scale_torques(records, settings.chain)
            return
        if self._limit_program is None:
            self._limit_program = MotorLimits(settings, records.model)
        apply_least_loss(self._limit_program.program, records)

    def limit_loss(self, records: TickRecords) -> LimitLoss | None:
        """Cost of the motor limits in the last saturated tick, or None.

        Args:
            records: records of that tick.
        """
        if self._known_loss is None and self._limit_program is not None:
            self._known_loss = self._limit_program.given_up(records)
        return self._known_loss

    def forget_limits(self) -> None:
        """Drop the quadratic program of the limits, whose size is that of older records."""
        self._limit_program = None

    def lasting(self, loss: LimitLoss | None) -> TickEnd:
        """Copy without references to records or to exceptions of the user, for `pickle`.

        The error is replaced by an `OscContactError` with the same sentence, and the quadratic
        program, from which the loss is computed, by the loss.

        Args:
            loss: cost of the motor limits in the last tick, or None.
        """
        other = TickEnd()
        other.inputs = self.inputs
        other.failure = None if self.failure is None else OscContactError(str(self.failure))
        other._known_loss = loss
        return other
