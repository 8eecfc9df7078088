"""Parts of the exact plant: its model, its equations side by side, and their solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.spatial import Array

__all__ = ["Solution", "beside", "stacked", "with_object"]


@dataclass(frozen=True)
class Solution:
    """The equations of one instant."""

    qdd: Array  # (n,)
    sdd: Array  # (bodies, 2) accelerations along the rails
    a_O: Array  # (6,) of the object, spatial
    alpha: Array  # (r,)
    wrenches: Array  # (arms, 6) in the wrists


def beside(A: Array, B: Array) -> Array:
    """The block-diagonal matrix of two."""
    none = np.zeros((len(A), len(B)))
    return np.block([[A, none], [none.T, B]])


def stacked(parts: list[Contact]) -> tuple[Array, Array]:
    """N (6, r) and n_γ (r,) of all contacts side by side."""
    N = np.hstack([np.zeros((6, 0)), *(c.N for c in parts)])
    return N, np.concatenate([np.zeros(0), *(c.n_gamma for c in parts)])


def with_object(chain: ClosedChain) -> tuple[pin.Model, list[int]]:
    """The merged model with the object's inertia riding on the last joint of the leading arm."""
    model = chain.model.copy()
    tips = list(chain.tips)
    if chain.leader is not None:
        assert chain.payload is not None
        tip = model.frames[tips[chain.leader]]
        X = tip.placement * chain.grasps[chain.leader].X_TO
        model.appendBodyToJoint(tip.parentJoint, chain.payload.inertia, X)
    return model, tips
