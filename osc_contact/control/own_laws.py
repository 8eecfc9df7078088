"""Laws put in place of the controller's own; such a controller runs on the readable path."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from osc_contact.control.border import independent
from osc_contact.control.wires import block
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from osc_contact.control.controller import Controller, Signals

__all__ = ["force_law"]

Law: TypeAlias = Callable[[Array, Array], Array]


def force_law(make: Callable[[], Law]) -> Callable[[Controller], Controller]:
    """Put α_u = law(α_d, α_meas) in the place of the force law of fig. 5.

    Args:
        make: called once for every controller, so that laws with a memory do not share it: a class,
            or a function without arguments. What it returns is called in every tick with the
            desired and the measured magnitudes (r,) of the independent columns of N, and returns
            the commanded ones (r,). If it returns anything else the controller holds its last
            torques, and `Controller.reason` says why.

    Returns:
        What `osc_contact.run` takes as ``install``; or call it with a controller.
    """

    def install(controller: Controller) -> Controller:
        law = make()

        @block("own force law", "force", "")
        def own(self: Controller, s: Signals) -> None:
            desired = independent(s.alpha_d, s.contact) if self.engaged else np.zeros(0)
            alpha_u = np.asarray(law(desired, s.alpha_meas), dtype=float)
            if alpha_u.shape != s.alpha_meas.shape or not np.isfinite(alpha_u).all():
                raise InvalidInputError(
                    f"the force law returned {alpha_u}: return {len(s.alpha_meas)} finite numbers, "
                    "one for each column of N"
                )
            s.alpha_u = alpha_u

        theirs = type(controller)._force_law
        stages = controller.STAGES
        controller.STAGES = tuple(own if one is theirs else one for one in stages)
        return controller

    return install
