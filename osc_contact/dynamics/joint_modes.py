"""What the joints of a rig feel and how the rig swings on sprung joints with its motors held."""

import numpy as np

from osc_contact.dynamics.chain_state import ChainState
from osc_contact.errors import ModelError
from osc_contact.spatial import Array


def joint_inertias(state: ChainState, actuated: Array) -> Array:
    """(n_a,) inertia each motor moves: of its arm, with an equal share of the object.

    diag(M + JᵀΛ_oJ / arms), kg m² (kg for sliding joints).
    """
    shared = [
        np.diag(arm.M + arm.J.T @ state.payload.Lambda @ arm.J / len(state.arms))
        for arm in state.arms
    ]
    return np.concatenate(shared)[actuated]


def modes(state: ChainState, actuated: Array, stiffness: Array) -> Array:
    """(d,) natural frequencies (Hz), ascending, of the closed chain out of contact, motors held.

    det(WᵀK W − ω² Λ_S) = 0: the motions S are the only ones the closed loops leave.

    Args:
        state: where. actuated: (n_a,) motor joints. stiffness: (n_a,) of their springs.
    """
    W = state.W[actuated]
    L = np.linalg.cholesky(state.Lambda_S)
    whitened = np.linalg.solve(L, np.linalg.solve(L, W.T @ (stiffness[:, None] * W)).T)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(whitened), 0.0)) / (2 * np.pi)


def stiffness_for(state: ChainState, actuated: Array, frequency: float) -> Array:
    """(n_a,) springs proportional to `joint_inertias` that put the first mode at a frequency (Hz).

    Args:
        state: of the chain. actuated: (n,) True for motor joints. frequency: Hz.

    Raises:
        ModelError: no spring can, because some motion moves no motor.
    """
    unit = joint_inertias(state, actuated)
    first = float(modes(state, actuated, unit)[0])
    if not first > 0.0:
        raise ModelError(
            "the object can move while every motor stands still: no stiffness gives the rig a "
            "first mode. Give plant.flexible_joints.stiffness for each motor instead."
        )
    return unit * (frequency / first) ** 2
