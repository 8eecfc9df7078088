"""Laws put in place of the controller's own, as what `osc_contact.run` installs: see `laws`."""

from __future__ import annotations

from collections.abc import Callable

from osc_contact.control.controller import Controller
from osc_contact.control.laws import ForceCommand, MotionCommand

__all__ = ["Law", "force_law", "motion_law"]

Law = ForceCommand


def force_law(make: Callable[[], ForceCommand]) -> Callable[[Controller], Controller]:
    """Put α_u = law(α_d, α_meas) in the place of the force law of fig. 5.

    Args:
        make: called once for every controller, so that laws with a memory do not share it: a class,
            or a function without arguments. What it returns is called in every tick, see
            `Laws.force`. If it returns anything else the controller holds its last torques, and
            `Controller.reason` says why.

    Returns:
        What `osc_contact.run` takes as ``install``; or call it with a controller.
    """
    return lambda controller: controller.with_laws(force=make())


def motion_law(make: Callable[[], MotionCommand]) -> Callable[[Controller], Controller]:
    """Put p̈_u = law(reference, X_WO, V_O) in the place of the motion law; see `force_law`."""
    return lambda controller: controller.with_laws(motion=make())
