"""Laws of the user's own in place of the controller's; the rest of the tick stays compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, classical_to_spatial

if TYPE_CHECKING:
    from osc_contact.control.signals import Block, Signals

__all__ = ["ForceCommand", "Laws", "MotionCommand", "StructureCommand"]

ForceCommand = Callable[[Array, Array], Array]
MotionCommand = Callable[[Any, Any, Array], Array]
StructureCommand = Callable[["Signals"], tuple[Array, Array]]


@dataclass(frozen=True)
class Laws:
    """What is put in place of the controller's own laws; None: nothing.

    Attributes:
        force: α_u = force(α_d, α_meas), (r,) magnitudes of the independent columns of N (N).
        motion: p̈_u = motion(reference, X_WO, V_O), classical acceleration (6,) of the object at O
            in world axes (m/s², rad/s²), from the reference, the object's pose and twist.
        structure: (η̇_c, f_S) = structure(signals), (d,) each, in place of the motion filter and the
            control structure, eqs. 24 and 21; `signals` holds what comes before them.
    """

    force: ForceCommand | None = None
    motion: MotionCommand | None = None
    structure: StructureCommand | None = None

    def boxes(self, boxes: Sequence[Block]) -> list[Block]:
        """The boxes of fig. 4 with the names of these laws."""
        own = {"force law": self.force, "motion law": self.motion, "motion filter": self.structure,
               "dynamic control structure": self.structure}  # fmt: skip
        return [
            replace(box, name=f"own {box.name}", equation="") if own.get(box.name) else box
            for box in boxes
        ]

    def command_force(self, alpha_d: Array, alpha_meas: Array) -> Array:
        """What the own force law commands.

        Raises:
            InvalidInputError: it returned anything but r finite numbers.
        """
        assert self.force is not None
        alpha_u = np.asarray(self.force(alpha_d, alpha_meas), dtype=float)
        if alpha_u.shape != alpha_meas.shape or not np.isfinite(alpha_u).all():
            raise InvalidInputError(
                f"the force law returned {alpha_u}: return {len(alpha_meas)} finite numbers, one "
                "for each column of N"
            )
        return alpha_u

    def command_motion(self, reference: Any, X_WO: Any, V_O: Array) -> Array:
        """Spatial acceleration (6,) that the own motion law commands.

        Args:
            reference: of the tick. X_WO, V_O: pose and twist (6,) of the object.

        Raises:
            InvalidInputError: it returned anything but six finite numbers.
        """
        assert self.motion is not None
        a = np.asarray(self.motion(reference, X_WO, V_O), dtype=float)
        if a.shape != (6,) or not np.isfinite(a).all():
            raise InvalidInputError(f"the motion law returned {a}: return six finite numbers")
        return classical_to_spatial(a, V_O)

    def command_structure(self, signals: Signals) -> tuple[Array, Array]:
        """η̇_c and f_S (d,) that the own structure law commands.

        Raises:
            InvalidInputError: it returned anything but twice d finite numbers.
        """
        assert self.structure is not None
        d, returned = signals.state.d, self.structure(signals)
        try:
            eta, f_S = (np.asarray(x, dtype=float) for x in returned)
            fits = eta.shape == f_S.shape == (d,) and np.isfinite(eta + f_S).all()
        except (TypeError, ValueError):
            fits = False
        if not fits:
            raise InvalidInputError(
                f"the structure law returned {returned}: return η̇_c and f_S, {d} finite numbers "
                "each"
            )
        return eta, f_S
