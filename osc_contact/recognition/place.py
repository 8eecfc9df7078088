"""Place of a touched body, learned from the contacts that were closed.

The gap of a closed contact is zero. A displacement δ of the body, at a point of it in world axes,
changes a gap by dg = Nᵀ δ_O, with δ carried to the object's origin O like a twist: the Jacobian of
the gaps is Nᵀ. An extended Kalman filter follows δ and its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.contacts.pairs.pair import AT_REST, ContactPair
from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.spatial import Array, as_array, carry_twist

PARAMETERS = ("x", "y", "z", "rx", "ry", "rz")  #: names of the components of a displacement
LEARNED = 0.5  #: share of its first standard deviation below which a parameter counts as learned
_GATE = 4.0  #: standard deviations beyond which a gap is assumed to be of another contact


class LearnedPlace:
    """Pose of a touched body, with the accuracy to which it is known.

    Args:
        at: (3,) point of the body at which displacements are stated, for example the middle of the
            mouth of a hole (m).
        position, angle: standard deviations of the believed pose, along and about each axis (m,
            rad).
        gap: standard deviation of the gap of a closed contact, by errors of the object's pose and
            of the geometry (m).
        lasting: number of instants for which these errors last.

    Attributes:
        X_WE: pose of the body relative to that in which its pairs are given, the identity at first.
        covariance: (6, 6) of the displacement at `at`, world axes (m, rad).

    Raises:
        InvalidInputError: a number that is not positive.

    Example:
        >>> table = osc.VertexOnFace([0, 0, 0], [0, 0, 0], [0, 0, 1])
        >>> place = osc.LearnedPlace([0, 0, 0], position=2e-3, angle=0.02, gap=1e-4)
        >>> lower = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1e-3]))  # the tip touches 1 mm lower
        >>> place.update([table], lower)
        1
        >>> print({name: round(sigma, 5) for name, sigma in place.learned().items()})
        {'z': 0.0001}
        >>> print(round(place.X_WE.translation[2], 4))
        -0.001
    """

    def __init__(
        self, at: ArrayLike, *, position: float, angle: float, gap: float, lasting: float = 1.0
    ) -> None:
        """Begin with the believed pose and its uncertainty; see the class for the arguments.

        Raises:
            InvalidInputError: a number that is not finite and > 0.
        """
        numbers = {"position": position, "angle": angle, "gap": gap, "lasting": lasting}
        for name, value in numbers.items():
            if not (value > 0.0 and np.isfinite(value)):
                raise InvalidInputError(f"{name} = {value!r}; give a number > 0 in SI units")
        #: (3,) point of the body at which displacements are stated (m)
        self._at = as_array("at", at, (3,))
        #: (6,) standard deviations of the displacement at first (m, rad)
        self._first = np.repeat([position, angle], 3)
        self._noise = lasting * gap**2  #: variance of the gap of a closed contact (m²)
        self.X_WE = pin.SE3.Identity()
        self.covariance: Array = np.diag(self._first**2)

    def update(self, closed: Sequence[ContactPair], X_WO: pin.SE3) -> int:
        """Correct the pose by the gaps of closed contacts, one after the other.

        A contact is left out if its gap is unlikely, or if it does not exist in this pose.

        Args:
            closed: pairs that are closed.
            X_WO: pose of the object.

        Returns:
            Number of gaps that were used.
        """
        used = 0
        for pair in closed:
            try:
                gaps = pair.gaps(X_WO, self.X_WE)
                N = pair.contact(X_WO, AT_REST, self.X_WE).N
            except ContactError:  # edges are parallel
                continue
            for gap, H in zip(gaps, self._jacobian(N, X_WO), strict=True):
                used += self._correct(float(gap), H)
        return used

    def _jacobian(self, N: Array, X_WO: pin.SE3) -> Array:
        """Derivatives (r, 6) of the gaps by the displacement of the body at its point.

        Args:
            N: (6, r) columns at O.
            X_WO: pose of the object.
        """
        to_O = carry_twist(np.eye(6), self.X_WE.act(self._at), X_WO.translation)
        return N.T @ to_O

    def _correct(self, gap: float, H: Array) -> int:
        """Correct pose and covariance by a gap whose true value is zero; return 1 if it was used.

        This is the update of a Kalman filter: with s = H P Hᵀ + σ², the variance of the gap, the
        displacement changes by −P Hᵀ g/s, and P by −P Hᵀ H P/s. A gap beyond `_GATE` √s is left
        out.

        Args:
            gap: gap in the present pose (m).
            H: (6,) its derivative.
        """
        P = self.covariance
        spread = float(H @ P @ H) + self._noise
        if not gap**2 <= _GATE**2 * spread:
            return 0
        gain = P @ H / spread
        d = -gain * gap
        self.covariance = P - np.outer(gain, H @ P)
        point = self.X_WE.act(self._at)
        R = pin.exp3(d[3:])
        position = point + d[:3] + R @ (self.X_WE.translation - point)
        self.X_WE = pin.SE3(R @ self.X_WE.rotation, position)
        return 1

    def learned(self) -> dict[str, float]:
        """Standard deviations of the parameters that contacts have shown, by name (m, rad).

        They are those whose standard deviation is below half of the first one, each in its own
        unit, world axes: x, y, z of the point, and rotations rx, ry, rz.
        """
        now = np.sqrt(self.covariance.diagonal())
        return {
            name: float(sigma)
            for name, sigma, first in zip(PARAMETERS, now, self._first, strict=True)
            if sigma < LEARNED * first
        }

    def displacement(self) -> Array:
        """Displacement (6,) of the body at its point, from the believed pose (m, rad)."""
        shift = self.X_WE.act(self._at) - self._at
        return np.concatenate((shift, pin.log3(self.X_WE.rotation)))

    def squares(self, displacement: Array) -> float:
        """Squared distance eᵀP⁻¹e of a displacement (6,) from the learned one, χ² with 6 freedoms.

        Args:
            displacement: true one, for a check of the covariance (m, rad).
        """
        e = np.asarray(displacement, dtype=np.float64) - self.displacement()
        return float(e @ np.linalg.solve(self.covariance, e))
