"""Any contact whose gaps can be computed: N and n_γ from derivatives of the gap functions."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import (
    Bodies,
    Extent,
    PackagedPair,
    register_pair,
)
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, as_array, cross_twist, norm

# Eighth-order central differences at the steps ±1 … ±4.
_STEPS = np.array([1.0, 2.0, 3.0, 4.0])
_FIRST = np.array([672.0, -168.0, 32.0, -3.0]) / 840.0
_SECOND = np.array([8064.0, -1008.0, 128.0, -9.0]) / 5040.0


@register_pair()
class GapFunctions(PackagedPair):
    """r smooth functions of the relative pose that the contact keeps at zero, 0 ≤ r ≤ 6.

    N = −∂g/∂ξ for relative displacements ξ at O, and, since g(X_EA) depends on the relative pose
    only, n_γ = Nᵀ(V_E × V_rel) + d²g/ds² along the motion of constant relative twist V_rel.
    Both come from central differences of eighth order (48 and 8 evaluations), the object turned
    about its own origin by `step` (rad) and moved by `step · length` (m). For functions that bend
    over `length` or more the truncation error is below 1e-15 of g (a tenth of that length: 1e-8),
    the rounding error 1e-16/step² = 3e-13 of g times (speed/length)². g must be smooth on both
    sides of contact, 4 steps far.

    Attributes:
        gap: pose of the object in the environment frame → (r,) gaps (m or rad), shrinking as the
            object moves into the environment.
        length: over which the geometry bends (m), for instance the smallest radius of curvature.
        step: of the differences (rad, and part of `length`).
        name: used in messages and recordings.
    """

    gap: Callable[[SE3], npt.ArrayLike]
    length: Extent = 0.1
    step: float = 0.02
    name: str = "gap_functions"

    def _make(self) -> None:
        if not 1e-5 <= self.step <= 0.3:
            raise InvalidInputError(f"{self.name}.step = {self.step}; give 1e-5 … 0.3")

    def _contact(self, b: Bodies) -> Contact:
        X_EA = b.X_E.actInv(b.X_A)
        to_E = np.kron(np.eye(2), b.X_E.rotation.T)
        units = np.repeat([self.length, 1.0], 3)
        slopes = [self._differences(X_EA, xi)[0] for xi in np.diag(units)]
        N = -to_E.T @ (np.array(slopes) / units[:, None])  # at O
        V_rel = b.V_rel
        xi = to_E @ V_rel
        speed = norm(xi / units)  # how many units of `step` per second
        bend = self._differences(X_EA, xi / speed)[1] * speed**2 if speed else 0.0
        return Contact(N, cross_twist(b.V_E, V_rel) @ N + bend, name=self.name)

    def _gaps(self, b: Bodies) -> Array:
        return self._at(b.X_E.actInv(b.X_A))

    def _at(self, X_EA: SE3) -> Array:
        return as_array(f"{self.name}.gap(X_EA)", self.gap(X_EA), (None,))

    def _differences(self, X_EA: SE3, xi: Array) -> tuple[Array, Array]:
        """First and second derivative of the gaps along the constant twist xi (6,), at A's origin
        in E's axes."""
        at_A = SE3(np.eye(3), X_EA.translation)
        turned = SE3(X_EA.rotation, np.zeros(3))

        def g(s: float) -> Array:
            return self._at(at_A * pin.exp6(s * xi) * turned)

        ahead = np.array([g(k * self.step) for k in _STEPS])
        behind = np.array([g(-k * self.step) for k in _STEPS])
        first = _FIRST @ (ahead - behind) / self.step
        return first, _SECOND @ (ahead + behind - 2.0 * self._at(X_EA)) / self.step**2
