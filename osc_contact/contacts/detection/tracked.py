"""A contact pair read off the geometry again and again while the bodies move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.detection.detect import detect
from osc_contact.contacts.detection.shapes import CollisionShape
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.spatial import Array

__all__ = ["TrackedContact"]


class TrackedContact:
    """Whatever touches between the held object and one body, as a `ContactPair`.

    What touches what is looked up by `detect` when the bodies have moved by more than `travel` or
    `turn` relative to one another since the last time. In between, N and n_γ come from the pairs
    found, at the poses and twists of each call. Where nothing is within the margin any more, the
    contacts found last stay in force: geometry does not detect a lost contact.

    Attributes:
        name: used in messages and recordings.
        pairs: in force now; empty before the first call.
        lookups: number of detections.
    """

    def __init__(
        self,
        object_geometry: Sequence[CollisionShape],
        environment_geometry: Sequence[CollisionShape],
        name: str = "detected",
        *,
        margin: float = 2e-3,
        travel: float = 2e-3,
        turn: float = 5e-3,
    ) -> None:
        """Take the collision shapes of both bodies, in the frames O and E.

        Args:
            object_geometry, environment_geometry: see `collision_shapes`.
            name: of the contact.
            margin: see `detect` (m).
            travel: distance (m), turn: angle (rad) after which to look again.

        Raises:
            InvalidInputError: travel or turn is negative.
        """
        if not (travel >= 0.0 and turn >= 0.0):
            raise InvalidInputError(f"travel = {travel} m, turn = {turn} rad; give numbers ≥ 0")
        self.name = name
        self.pairs: tuple[ContactPair, ...] = ()
        self.lookups = 0
        self._shapes = tuple(object_geometry), tuple(environment_geometry)
        self._margin, self._travel, self._turn = margin, travel, turn
        self._X_EO = pin.SE3.Identity()

    def contact(
        self,
        X_WO: pin.SE3,
        V_O: Array,
        X_WE: pin.SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r) and n_γ (r,) of all that touches (see `ContactPair.contact`).

        Args:
            X_WO, V_O, X_WE, V_E: as of `ContactPair.contact`.

        Raises:
            ContactError: nothing touches, and nothing ever has.
        """
        pairs = self._touching(X_WO, X_WE)
        parts = [pair.contact(X_WO, V_O, X_WE, V_E) for pair in pairs]
        return parts[0] if len(parts) == 1 else Contact.stack(parts)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """Gaps of the pairs found, one below the other (m, rad)."""
        return np.concatenate([pair.gaps(X_WO, X_WE) for pair in self._touching(X_WO, X_WE)])

    def _touching(self, X_WO: pin.SE3, X_WE: pin.SE3 | None) -> tuple[ContactPair, ...]:
        X_EO = X_WO if X_WE is None else X_WE.actInv(X_WO)
        moved = self._X_EO.actInv(X_EO)
        near = (
            np.linalg.norm(moved.translation) <= self._travel
            and np.linalg.norm(pin.log3(moved.rotation)) <= self._turn
        )
        if self.pairs and near:
            return self.pairs
        shapes, bodies = self._shapes
        detected = detect(shapes, X_WO, bodies, X_WE, margin=self._margin)
        self.lookups += 1
        if detected:
            self.pairs = tuple(contact.pair() for contact in detected)
        self._X_EO = X_EO.copy()
        if not self.pairs:
            raise ContactError(
                f"{self.name}: nothing touches within {self._margin * 1e3:g} mm at the pose of the "
                f"object {np.round(X_WO.translation, 4)} m; bring it nearer before engaging"
            )
        return self.pairs
