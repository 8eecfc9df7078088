"""The contact state of a tick: N and n_γ of the contacts in force, and what their bodies do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.dynamics.rail import Body
from osc_contact.interface import Touched
from osc_contact.spatial import Array

__all__ = ["chosen", "parts_in_force", "surroundings"]

_AT_REST = Environment.fixed()
_STILL = np.zeros(6)


def chosen(touched: Touched | None, active: Array) -> Touched | None:
    """The motion of those touched bodies whose contacts are active (contacts,)."""
    if touched is None or active.all():
        return touched
    return Touched(touched.X_WE[active], touched.V_E[active], touched.A_E[active])


def parts_in_force(
    pairs: Sequence[ContactPair], state: ChainState, touched: Touched | None
) -> list[Contact]:
    """N and n_γ of each pair at the pose and twist of the object; `touched`: of these pairs."""
    X_WO, V_O = state.X_WO, state.V_O
    if touched is None:
        return [pair.contact(X_WO, V_O) for pair in pairs]
    moving = zip(pairs, touched.X_WE, touched.V_E, strict=True)
    return [pair.contact(X_WO, V_O, pin.SE3(X), V) for pair, X, V in moving]


def surroundings(
    bodies: Sequence[Body | None],
    parts: Sequence[Contact],
    touched: Touched | None,
    state: ChainState,
    friction_wrenches: Array | None = None,
) -> Environment:
    """Φ_e, b_e and V_e of all bodies together; contacts on one body share its environment.

    Args:
        bodies: at each contact; None: it does not answer forces, though it may be seen to move.
        parts: N of each contact. touched: how its body moves.
        state: of the chain. friction_wrenches: (6, r) from `Friction.wrenches`, or none.
    """
    if touched is None or not parts:
        return _AT_REST
    O = state.X_WO.translation  # noqa: E741
    of_body: dict[Body, Environment] = {}
    answers = []
    for body, matrix, V, A in zip(bodies, touched.X_WE, touched.V_E, touched.A_E, strict=True):
        if body is None:
            answers.append(Environment.moving(X_WE=pin.SE3(matrix), V_E=V, A_E=_STILL, O=O))
        else:
            if body not in of_body:
                of_body[body] = body.environment(pin.SE3(matrix), V, A, O)
            answers.append(of_body[body])
    return Environment.combine(list(parts), answers, state.metric, friction_wrenches)
