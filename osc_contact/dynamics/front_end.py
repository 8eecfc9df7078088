"""The law's own kinematics and dynamics of the arms, judged by Pinocchio before their first use."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.chain_look import Look
from osc_contact.dynamics.chain_model import ChainModel
from osc_contact.errors import ModelError
from osc_contact.law.layout import Bytes

__all__ = ["require_pinocchio_agrees"]

STATES, TOLERANCE = 3, 1e-9


def require_pinocchio_agrees(chain: ChainModel, row: Bytes) -> None:
    """Compare J, M and h = C v + g on a few random states.

    Args:
        chain: the arms. row: from `chain_row`, not led: where the object is does not matter.

    Raises:
        ModelError: a difference above 1e-9 of the largest element: a kind of joint or a property of
            the model that the law does not know.
    """
    rng, data, n = np.random.default_rng(0), chain.model.createData(), chain.nq
    for _ in range(STATES):
        q, v = rng.uniform(-1.0, 1.0, n), rng.normal(size=n)
        look = Look(row, q, v, np.eye(4), np.zeros(6))
        pin.computeAllTerms(chain.model, data, q, v)
        for name, ours, theirs in (
            ("J", look.jacobian, data.J.T),
            ("M", look.inertia(chain.slices), data.M),
            ("h", look.joints["h"], data.nle),
        ):
            _require_equal(name, ours, theirs)


def _require_equal(name: str, ours: Any, theirs: Any) -> None:
    worst = float(np.abs(ours - theirs).max(initial=0.0))
    if not worst <= TOLERANCE * max(1.0, float(np.abs(theirs).max(initial=0.0))):
        raise ModelError(
            f"the control law's {name} differs from Pinocchio's by {worst:.3g} on a random state: "
            "the model has a joint or a property that the law does not know. Please report it with "
            "the model; a chain of plain revolute and prismatic joints is known"
        )
