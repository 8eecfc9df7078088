"""How a tick ended that the law did not compute as commanded: its cause, and what limits cost."""

from __future__ import annotations

from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import TickRecords
from osc_contact.control.status import LimitLoss
from osc_contact.control.torque_limits import MotorLimits, relieve, scale_torques
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Reference


class TickEnd:
    """The end of the last tick that did not end OK.

    Attributes:
        inputs: measurement and reference of that tick; None before the first such tick.
        failure: error raised outside the law in that tick, or None.
    """

    inputs: tuple[Measurement, Reference] | None = None
    failure: Exception | None = None
    _loss: LimitLoss | None = None
    _limits: MotorLimits | None = None

    def note(
        self, measurement: Measurement, reference: Reference, failure: Exception | None
    ) -> None:
        """Keep the inputs of a tick, and the error raised in it.

        Args:
            measurement: readings of the tick.
            reference: desired motion and forces of the tick.
            failure: error raised by the user's code; None: none.
        """
        self.inputs = (measurement, reference)
        self.failure = failure
        self._loss = None

    def limit_torques(
        self, records: TickRecords, settings: Settings, custom_structure: bool
    ) -> None:
        """Bring the torques of a saturated tick within the motors' limits.

        Args:
            records: records of the tick; its torques are replaced.
            settings: settings of the controller.
            custom_structure: whether a custom control structure made the torques. Of it nothing is
                known, so all torques are scaled by one factor; else the quadratic program is
                solved that loses least.

        Raises:
            SolverError: no torques within the limits were found.
        """
        if custom_structure:
            self._loss = scale_torques(records, settings.chain)
            return
        if self._limits is None:
            self._limits = MotorLimits(settings, records.model)
        relieve(self._limits.program, records)

    def limit_loss(self, records: TickRecords) -> LimitLoss | None:
        """Cost of the motor limits in the last saturated tick, or None.

        Args:
            records: records of that tick.
        """
        if self._loss is None and self._limits is not None:
            self._loss = self._limits.given_up(records)
        return self._loss

    def forget_limits(self) -> None:
        """Drop the quadratic program of the limits, whose size is that of older records."""
        self._limits = None

    def lasting(self, loss: LimitLoss | None) -> TickEnd:
        """A copy that can be pickled: errors as their sentences, the loss in place of its program.

        Args:
            loss: cost of the motor limits in the last tick.
        """
        other = TickEnd()
        other.inputs = self.inputs
        other.failure = None if self.failure is None else OscContactError(str(self.failure))
        other._loss = loss
        return other
