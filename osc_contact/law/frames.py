"""From the coordinates in which the law computes to world axes at O, as matrices.

`work` is a WORK record after a tick, or after its first part. See `energy` for the coordinates;
`chain` turns them so that the first axes are those that the arms lock.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def motions(work: Any) -> NDArray[np.float64]:
    """(6, 6) L⁻ᵀ, from energy coordinates to motions at O in world axes."""
    out, axes = np.zeros((6, 6)), work["axes"]
    out[:3, :3], out[3:, 3:] = axes[2].T, axes[3].T
    out[:3, 3:] = _lever(work) @ axes[3].T
    return out


def wrenches(work: Any) -> NDArray[np.float64]:
    """(6, 6) L, from energy coordinates to wrenches at O in world axes."""
    out, axes = np.zeros((6, 6)), work["axes"]
    out[:3, :3], out[3:, 3:] = axes[0].T, axes[1].T
    out[3:, :3] = _lever(work) @ axes[0].T
    return out


def reflection(work: Any) -> NDArray[np.float64]:
    """(6, 6) that turns energy coordinates so that the first axes are the locked ones."""
    reflection = np.eye(6)
    for k in range(int(work["locked"])):
        v = work["reflectors"][k].copy()
        v[:k] = 0.0
        reflection -= np.outer(work["beta"][k] * v, v @ reflection)
    return reflection


def _lever(work: Any) -> NDArray[np.float64]:
    """(3, 3) [C − O]×."""
    x, y, z = (work["C"] - work["O"]).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
