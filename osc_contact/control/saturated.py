"""What a saturated compiled tick left in its arrays, as a program for `effort_limits`."""

from __future__ import annotations

import numpy as np

from osc_contact.control.effort_limits import EffortLimits, Response
from osc_contact.kernels import layout as at
from osc_contact.spatial import Array

__all__ = ["saturated"]


def saturated(arrays: dict[int, Array], limits: EffortLimits) -> tuple[Response, Array, Array]:
    """The response in the kernels' coordinates, R of the contacts, and S there.

    White coordinates, turned so that the first m axes are locked: SᵀΛ_oS is the identity.

    Returns:
        The response; R (r, r_all) as in `Contact.R`; S (6, d) at O in world axes.
    """
    chain = limits.chain
    signals, rows, sizes = arrays[at.SIGNALS], arrays[at.ROWS], arrays[at.SIZES][0]
    r, m = int(signals[at.RANK]), int(signals[at.LOCKED_AXES])
    turn = np.eye(6)
    for k in range(m):
        v = arrays[at.Q_FACTOR][k, :6].copy()
        v[:k] = 0.0
        turn -= np.outer(rows[at.BETA, k] * v, v @ turn)
    bar = arrays[at.JOINT_ROWS][2]
    N = arrays[at.CONTACT_ROWS][at.TURNED, :r]
    owners = arrays[at.COLUMNS_I][: int(sizes[at.N_COLUMNS]), 0]
    owners = owners[arrays[at.TERMS][owners, 0] != 0.0]  # of the columns in force
    count = len(owners)
    R = np.eye(r) if r == count else arrays[at.SHARE][:r, :count]
    alpha = arrays[at.COLUMNS][at.ALPHA_U, :r].copy()
    E = np.zeros((0, chain.n_a))
    if len(chain.arms) == 2 and rows[at.LINE, :6].any():
        lever = 0.5 * bar @ rows[at.LINE, :6]
        lever[chain.slices[1]] *= -1.0
        E = lever[None, chain.actuated]
    along = 0.5 * (rows[at.ALONG_0, m:6] - rows[at.ALONG_1, m:6])
    response = Response(
        tau=arrays[at.JOINT_VECTORS][1, chain.actuated],
        tau_max=chain.tau_max,
        G=turn[m:] @ bar[chain.actuated].T,
        Lambda=arrays[at.SQUARES][at.LAMBDA, m:, m:] + (np.eye(6 - m) if sizes[at.HELD] else 0.0),
        metric=np.eye(6 - m),
        N=N[:, m:].T,
        pushed=arrays[at.CONTACT_ROWS][at.PUSHED, :r, m:].T,
        Phi_e=arrays[at.SQUARES][at.PHI_MU, :r, :r],
        normal=N @ N.T,
        alpha=alpha,
        E=E,
        carried=along[None] if len(E) else np.zeros((0, 6 - m)),
        mass=chain.reference.inertia.mass,
        **limits.floors(owners, R, alpha),
    )
    return response, R, _at_operational_point(arrays) @ turn[m:].T


def _at_operational_point(arrays: dict[int, Array]) -> Array:
    """(6, 6) from white motions to motions at O in world axes."""
    axes, rows = arrays[at.AXES], arrays[at.ROWS]
    x, y, z = rows[at.CENTRE, :3] - rows[at.O, :3]
    out = np.zeros((6, 6))
    out[:3, :3], out[3:, 3:] = axes[2].T, axes[3].T
    out[:3, 3:] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ axes[3].T
    return out
