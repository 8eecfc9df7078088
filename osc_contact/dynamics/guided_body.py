"""A rigid body that moves along given twists only: how it answers a contact force (eq. 14)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.dynamics.definite import inverse, symmetric
from osc_contact.spatial import Array, as_array, carry_twist, cross_wrench

__all__ = ["guided_body"]


def guided_body(
    inertia: pin.Inertia,
    X_WE: pin.SE3,
    A: Array,
    rates: Array,
    O: npt.ArrayLike,  # noqa: E741 - the operational point
    gravity: npt.ArrayLike,
    Q: Array,
) -> tuple[Array, Array, Array]:
    """Φ_e (6, 6), b_e (6,) and V_e (6,) at O: AᵀIA s̈ = Q + Aᵀ(weight − V ×* IV) at its origin.

    No drift: a space of motions fixed in the world has none, and one fixed in the body V × V.

    Args:
        inertia: in the body's own frame (kg, m). X_WE: its pose in the world.
        A: (6, k) twists per unit rate at its origin. rates: (k,) how fast it moves along each.
        O: (3,) operational point in the world (m). gravity: (3,) m/s².
        Q: (k,) what else acts along each twist (N, N m).

    Raises:
        InvalidInputError: wrong shapes or non-finite numbers.
        ModelError: no inertia along one of the twists.
    """
    p, point = X_WE.translation, as_array("O", O, (3,))
    I: Array = pin.SE3(X_WE.rotation, np.zeros(3)).act(inertia).matrix()  # noqa: E741
    V = A @ rates
    acting = I[:, :3] @ as_array("gravity", gravity, (3,)) - cross_wrench(V, I @ V)
    M_inv = inverse(A.T @ I @ A, "the body's inertia along its axes")
    at_O = carry_twist(A, p, point)
    return (
        symmetric(at_O @ M_inv @ at_O.T),
        at_O @ (M_inv @ (Q + A.T @ acting)),
        carry_twist(V, p, point),
    )
