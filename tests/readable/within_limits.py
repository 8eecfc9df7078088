"""The readable path's torques within the motor limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

from osc_contact.control.reports import Status
from osc_contact.spatial import Array
from readable.effort_limits import relieve
from readable.validation import limited

if TYPE_CHECKING:
    from readable.controller import ReadableController as Controller
    from readable.signals import Signals

__all__ = ["within_limits"]


def within_limits(controller: Controller, s: Signals, motion: Array, force: Array) -> Array:
    """The torques of a tick, or those within the limits that lose least; nobody integrates these.

    Args:
        controller: whose status is set. s: with `tau`.
        motion, force: the integrals before this tick.
    """
    if controller.limits.kept(s.tau):
        return s.tau
    controller.status, controller.motion_law.integral = Status.SATURATED, motion
    if controller.restaged:
        controller.force_law.integral = force
        tau, controller._reason = limited(s.tau, controller.chain)
        return tau
    wanted = controller.limits.response(s, controller._owners)
    relief = relieve(wanted)
    gain, *_ = controller.terms.of_columns(controller._owners, s.contact.r)
    controller.force_law.forgo(relief.force, gain)
    lost = s.state.S @ relief.motion
    controller.given_up = controller.limits.given_up(wanted, relief, s.contact.R, lost)
    return relief.tau
