"""Where a run starts: joint positions with closed loops, touching contacts, within limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.dynamics.assembly import close, object_pose, reach
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.errors import ModelError, ScenarioError
from osc_contact.runs.contacts import pose_of
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array

__all__ = ["asked_pose", "posture_of", "standoff_of", "touching"]

FAR_M = 0.02  #: a contact further from what it touches is named where the start is not found


def posture_of(scenario: Scenario, chain: ClosedChain) -> Array:
    """(n,) the postures of all arms.

    Raises:
        ScenarioError: not one number for each joint on the way to a tip.
    """
    q = np.concatenate([arm.posture for arm in scenario.arms])
    if q.shape != (chain.nq,):
        counts = ", ".join(f"{arm.name} {arm.model.nv}" for arm in chain.arms)
        raise ScenarioError(
            f"posture: {len(q)} joint positions given; on the way to their tips the arms "
            f"have: {counts}"
        )
    return q


def asked_pose(scenario: Scenario, chain: ClosedChain, posture: Array) -> pin.SE3:
    """`object.pose`, or where the posture puts what the first arm with a rigid grasp holds.

    Args:
        scenario: with or without `object.pose`.
        chain: arms and grasps.
        posture: (n,) joint positions (m, rad).

    Raises:
        ModelError: it is left out, and the joints do not tell the pose.
    """
    given = scenario.object.pose
    return object_pose(chain, posture) if given is None else pose_of(given)


def touching(chain: ClosedChain, pairs: Sequence[ContactPair], q: Array, X_WO: pin.SE3) -> Array:
    """(n,) joint positions near q that put the object onto its contacts, from near X_WO.

    Args:
        chain: arms and grasps.
        pairs: that shall be in contact.
        q: (n,) joint positions to begin from (m, rad).
        X_WO: pose of the object to begin from.

    Raises:
        ModelError: arms, grasps and contacts cannot be met together. ScenarioError: only outside
            the joints' limits. Both name the contact that is furthest away.
    """

    def gaps(X: pin.SE3) -> tuple[Array, Array]:
        rest = np.zeros(6)
        N = [pair.contact(X, rest).N for pair in pairs]
        gap = np.concatenate([np.zeros(0), *(pair.gaps(X) for pair in pairs)])
        return gap, np.hstack([np.zeros((6, 0)), *N])

    q_near = reach(chain, q, X_WO)
    try:
        q_contact = close(chain, q_near, gaps)
        _require_within_limits(chain, q_contact)
    except (ModelError, ScenarioError) as error:
        raise type(error)(f"{error}{_away(pairs, X_WO)}") from error
    return q_contact


def standoff_of(state: ChainState, contact: Contact, distance: float) -> Array:
    """The displacement (6,) of least kinetic energy that opens every gap by `distance`.

    Args:
        state: of the chain, in contact.
        contact: the contacts that open.
        distance: of every gap (m).
    """
    H = state.S.T @ state.metric @ state.S
    N_S = state.S.T @ contact.N
    H_inv_N = np.linalg.solve(H, N_S)
    away = -distance * np.ones(contact.r)  # a gap opens against N
    return np.asarray(state.S @ (H_inv_N @ np.linalg.solve(N_S.T @ H_inv_N, away)))


def _away(pairs: Sequence[ContactPair], X_WO: pin.SE3) -> str:
    """Which contact is furthest from its face at the pose that is asked for, in words."""
    gaps = [float(np.abs(pair.gaps(X_WO)).max(initial=0.0)) for pair in pairs]
    if max(gaps, default=0.0) < FAR_M:
        return ""
    name = pairs[int(np.argmax(gaps))].name
    return (
        f". At object.pose contact '{name}' is {1e3 * max(gaps):.0f} mm away from what it touches: "
        "move that to the object, or object.pose and posture to it"
    )


def _require_within_limits(chain: ClosedChain, q: Array) -> None:
    low, high = chain.model.lowerPositionLimit, chain.model.upperPositionLimit
    for j, name in enumerate(chain.joint_names):
        if not low[j] <= q[j] <= high[j]:
            raise ScenarioError(
                f"to touch the contacts joint {name} would stand at {q[j]:.4g}, outside its limits "
                f"[{low[j]:.4g}, {high[j]:.4g}]; move object, faces or base, or change the posture"
            )
