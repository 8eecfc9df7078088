"""Friction of the joints as a part of h, in NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from osc_contact.control.model_row import SLIDING_SLIP, TURNING_SLIP
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.spatial import Array

__all__ = ["friction_torques", "with_friction"]


def friction_torques(chain: ClosedChain, state: ChainState, v: Array, V_D: Array) -> Array:
    """(n,) D v + F s/√(s² + s_0²), with the wanted speeds s = v + J̄ (V_D − V), V_D two ticks on."""
    model = chain.model
    slides = [joint.shortname().startswith("JointModelP") for joint in list(model.joints)[1:]]
    slip = np.where(slides, SLIDING_SLIP, TURNING_SLIP)
    s = v + np.concatenate([arm.J_bar @ (V_D - state.V_O) for arm in state.arms])
    return np.asarray(model.damping * v + model.upperDryFrictionLimit * s / np.hypot(s, slip))


def with_friction(chain: ClosedChain, state: ChainState, v: Array, V_D: Array) -> ChainState:
    """The state of the chain with the joints' friction in h and μ."""
    torques = friction_torques(chain, state, v, V_D)
    arms = tuple(
        replace(arm, mu=arm.mu + arm.J_bar.T @ torques[s])
        for arm, s in zip(state.arms, chain.slices, strict=True)
    )
    return replace(state, h=state.h + torques, mu_S=state.mu_S + state.W.T @ torques, arms=arms)
