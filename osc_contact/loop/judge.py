"""Judge of a run: the truth about object and contacts, and the protocol of plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Protocol, runtime_checkable

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.errors import InvalidInputError
from osc_contact.files import Json
from osc_contact.interface import Robot
from osc_contact.spatial import Array, Poses


@dataclass(frozen=True)
class Truth:
    """Values of the plant alone; for judging, never for the controller.

    Attributes:
        alpha: (r,) contact force magnitudes, contact after contact (N).
        closed: (contacts,) whether each contact touches; of several points, all of them.
        X_WO: pose of the object.
        V_O: (6,) its twist at its origin, world axes.
        X_WE: pose of the frame in which each contact's face is described; None: faces at rest.
    """

    alpha: Array
    closed: Array
    X_WO: pin.SE3
    V_O: Array
    X_WE: tuple[pin.SE3, ...] | None = None


@dataclass(frozen=True)
class Truths:
    """True states and contact forces at k instants, each as in `Truth`.

    Attributes:
        alpha: (k, r) contact force magnitudes (N).
        closed: (k, contacts) whether contacts touch.
        X_WO: k poses of the object.
        V_O: (k, 6) its twists at O, world axes (m/s, rad/s).
        X_WE: for each contact k poses of the frame of its face; None: the face is at rest.
        N: for each contact its lines of force (6, r_i, k) at O, world axes.
    """

    alpha: Array
    closed: Array
    X_WO: Poses
    V_O: Array
    X_WE: tuple[Poses | None, ...]
    N: tuple[Array, ...]

    def __getitem__(self, i: int) -> Truth:
        """Return the truth at one instant.

        Args:
            i: index of the instant, 0 … k − 1.

        Returns:
            Truth whose X_WE has a pose for each contact. A face at rest is described in the world's
            frame, so its pose is the identity; X_WE is None if all faces are at rest.
        """
        faces = None
        if any(X is not None for X in self.X_WE):
            faces = tuple(pin.SE3.Identity() if X is None else X[i] for X in self.X_WE)
        return Truth(self.alpha[i], self.closed[i], self.X_WO[i], self.V_O[i], faces)


class ReadsTruth(Protocol):
    """Computation of the true states and forces from the rows that a `TruthLog` recorded."""

    def truths(self, rows: Array) -> Truths:
        """True states and contact forces at k instants.

        Args:
            rows: (k, m) rows returned by `TruthLog.noted`.
        """


class TruthLog(ReadsTruth, Protocol):
    """Record of the states of a plant, from which true values at many instants are computed."""

    def note(self) -> None:
        """Append the present state."""

    def noted(self, start: int = 0) -> Array:
        """Recorded states (k, m), one row for each `note` since the last `clear`.

        Args:
            start: index of the first row returned.
        """

    def clear(self) -> None:
        """Delete the recorded states."""


class NotedTruths:
    """True states and forces, computed from the rows that `Watched` records."""

    def __init__(self, contacts: Sequence[ContactPair]) -> None:
        """Set the contacts, in the order of the controller's contacts."""
        self._contacts = contacts  #: contacts of the controller

    def truths(self, rows: Array) -> Truths:
        """True states and contact forces at k instants.

        Args:
            rows: (k, m) rows returned by `Watched.noted`: X_WO and each X_WE (3×4 by rows), V_O, 1
                if bodies move, then for each contact 1 if closed, then the magnitudes α.
        """
        contacts = len(self._contacts)
        ends = np.cumsum([12 * (1 + contacts), 6, 1, contacts])  # of the fields in a row
        poses, V_O, motion_flags, is_closed, alpha = np.split(rows, ends, axis=1)
        # (bodies, 3, 4, k): matrices [R p] of the object and of each face, the instants last
        matrices = poses.reshape(-1, 1 + contacts, 3, 4).transpose(1, 2, 3, 0).copy()
        X_WO, *faces = (Poses(matrix[:, :3], matrix[:, 3]) for matrix in matrices)
        X_WE = tuple(faces) if motion_flags.any() else (None,) * contacts
        N = tuple(normals_over(pair, X_WO, X) for pair, X in zip(self._contacts, X_WE, strict=True))
        return Truths(alpha, is_closed > 0.0, X_WO, V_O, X_WE, N)


class Watched(NotedTruths):
    """Record of the truth by calls of `Judge.truth`, for a judge whose `truth` is fast."""

    def __init__(self, judge: Judge, contacts: Sequence[ContactPair]) -> None:
        """Set the judge whose truth is recorded, and the contacts of the controller."""
        super().__init__(contacts)
        self._judge = judge  #: judge whose truth is recorded
        self._rows: list[Array] = []  #: rows of numbers, one for each instant

    def note(self) -> None:
        """Append the judge's present truth as a row of numbers.

        The row has X_WO and the X_WE of each contact (3×4 by rows; the identity if no body moves),
        V_O (6), 1 if bodies move else 0, `closed` (contacts,; 1 or 0) and α (r,; N).
        """
        truth = self._judge.truth()
        faces = truth.X_WE or (pin.SE3.Identity(),) * len(self._contacts)
        poses = [X.homogeneous[:3] for X in (truth.X_WO, *faces)]
        numbers = (truth.V_O, truth.X_WE is not None, truth.closed, truth.alpha)
        self._rows.append(np.concatenate((*poses, *numbers), axis=None))

    def noted(self, start: int = 0) -> Array:
        """Recorded rows (k, m), one for each `note` since the last `clear`.

        A row has X_WO and the X_WE of each contact (3×4 by rows), V_O (6), 1 if bodies move else 0,
        for each contact 1 if it is closed else 0, and the magnitudes α (N).

        Args:
            start: index of the first row returned.
        """
        return np.array(self._rows[start:])

    def clear(self) -> None:
        """Delete the recorded rows."""
        self._rows.clear()


class Judge(Protocol):
    """A source of the truth about object and contacts; the controller never gets it.

    Example:
        >>> judge: osc.Judge = osc.build_rig(osc.load_scenario("two_contact_rod")).plant()
        >>> print(judge.truth().alpha.shape)
        (2,)
    """

    def truth(self) -> Truth:
        """True state of object and contacts at the present instant."""

    def poses(self) -> Array:
        """True poses (1 + arms, 4, 4) in the world of the object, then of each arm's tip."""

    def log(self) -> TruthLog:
        """New, empty record of the truth."""


@runtime_checkable
class Pictured(Protocol):
    """A judge that can draw its bodies; a recording carries them, where no scenario does."""

    def picture(self) -> Json:
        """Bodies and their shapes as plain data, see `robots.pictures`."""


def require_duration(duration: float) -> None:
    """Refuse the duration of a simulation step (s) that is not positive and finite.

    Raises:
        InvalidInputError: the duration is zero, negative, infinite or NaN.
    """
    if not 0.0 < duration < inf:
        raise InvalidInputError(f"duration = {duration} s; a step takes a positive, finite time")


class Plant(Robot, Judge, Protocol):
    """A simulated robot that is its own judge, and starts at a given state."""

    time: float  #: s since the last reset

    def reset(self, q: Array) -> None:
        """Start again at rest at joint positions q (n,)."""

    def hold(self, tau: Array) -> None:
        """Apply torques (n_a,) from now on without letting time pass: sensors read under them.

        `command` lets time pass, and raises a `PlantError` where the simulation diverges.
        """
