"""Joint positions compared with the joints' limits."""

from __future__ import annotations

import numpy as np

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["require_in_range"]

ROUNDING = 1e-6  #: m, rad; what a number may lose on its way through a file


def require_in_range(name: str, chain: ClosedChain, q: Array, beyond: Array | float = 0.0) -> None:
    """Refuse joint positions outside the joints' limits.

    Args:
        name: of the argument, for the message.
        chain: whose joints they are.
        q: (n,) positions (rad, m). Numbers that are not finite are not compared.
        beyond: (n,) or one number: how far past its limits a joint may stand (rad, m).

    Raises:
        InvalidInputError: one stands further out; with all that do, and whether they look like
            degrees.
    """
    lower = np.array(chain.model.lowerPositionLimit)
    upper = np.array(chain.model.upperPositionLimit)
    out = np.maximum(lower - q, q - upper) > beyond + ROUNDING
    if not out.any():
        return
    found = [
        f"{chain.joint_names[j]} at {q[j]:.4g} (limits {lower[j]:.4g} … {upper[j]:.4g})"
        for j in np.flatnonzero(out)
    ]
    turned = np.radians(q)
    degrees = np.abs(q).max() > np.pi and ((lower <= turned) & (turned <= upper)).all()
    raise InvalidInputError(
        f"{name}: outside the limits of its joint (rad or m): {', '.join(found)}; "
        + (
            f"the numbers look like degrees: give np.radians({np.round(q, 4).tolist()})"
            if degrees
            else "give positions within the limits, or correct the limits in the robot's file"
        )
    )
