"""A look at the closed chain: the law's own first stage at one (q, v), read from its records."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.chain_model import ChainModel
from osc_contact.dynamics.chain_state import ArmTerms, ChainState, SingularDirection
from osc_contact.dynamics.payload import ObjectTerms
from osc_contact.errors import ModelError
from osc_contact.law import tables as at
from osc_contact.law import tick as law
from osc_contact.law.compiled import rows
from osc_contact.law.frames import motions, reflection, wrenches
from osc_contact.law.layout import Bytes
from osc_contact.spatial import Array

__all__ = ["Look", "read_state"]

_NOTHING = ObjectTerms(np.zeros((6, 6)), np.zeros(6), np.zeros(6))
_SIX, _POSE, _NONE, _STILL = np.zeros(6), np.eye(4), np.zeros(0), np.zeros((0, 28))
_WHY = {
    at.BAD_INERTIA: "the joint-space inertia of an arm is not positive definite; check the masses "
    "and inertias of its links",
    at.OBJECT_UNKNOWN: "the joints do not tell where the object is, or how it moves: its grasps "
    "let it move while every arm stands still. Grasp it so that this is blocked, or give the "
    "measured pose and twist: state(q, v, X_WO, V_O)",
}


class Look:
    """What the law makes of the arms at (q, v), before any contact: WORK after its first part.

    Attributes:
        head: CHAIN record. work: WORK record. arms, joints: ARM_WORK and JOINT_WORK rows.
        jacobian: (n, 6) columns at the world's origin.
    """

    def __init__(
        self, row: Bytes, q: Array, v: Array, X_WO: Array | None = None, V_O: Array | None = None
    ) -> None:
        """Run it in memory of its own.

        Args:
            row: from `chain_rows.chain_row`; led, if no pose is given.
            q, v: (n,). X_WO: (4, 4), V_O: (6,) of the object, if they are given.
        """
        self.head = head = row[: at.CHAIN_BYTES].view(at.CHAIN)[0]
        k, n = int(head["n_arms"]), int(head["n_joints"])
        memory = np.zeros(int(head["memory_bytes"]), dtype=np.uint8)
        if X_WO is not None:
            given = memory[: at.MEMORY_BYTES].view(at.MEMORY)[0]
            given["located"], given["X_WO"] = 1, X_WO
            given["given"] = at.GIVEN_POSE if V_O is None else at.GIVEN_TWIST
            given["V_O"] = 0.0 if V_O is None else V_O
        floats = np.zeros(int(head["work_bytes"]) // 8)
        raw = floats.view(np.uint8)
        rows()(
            row, memory, raw, q, v, np.zeros((k, 6)), _POSE, _SIX, _SIX, _NONE,
            np.zeros(max(1, int(head["n_bars"]))), _STILL, 0, _NONE, np.zeros(1, np.int64),
            law.LOOK, law.MEASURE, 0, 1,
        )  # fmt: skip
        self.work = raw[: at.WORK_BYTES].view(at.WORK)[0]
        start = int(head["arm_work_at"])
        self.arms = raw[start : start + k * at.ARM_WORK_BYTES].view(at.ARM_WORK)
        start = int(head["joint_work_at"])
        self.joints = raw[start : start + n * at.JOINT_WORK_BYTES].view(at.JOINT_WORK)
        start = int(head["jacobian_at"]) // 8
        self.jacobian = floats[start : start + 6 * n].reshape(n, 6)

    def inertia(self, arms: Sequence[slice]) -> Array:
        """M (n, n) of all arms, given each one's part of the joints."""
        n = len(self.joints)
        M = np.zeros((n, n))
        for s in arms:
            M[s, s] = self.joints["M"][s, : s.stop - s.start]
        return M

    def require_done(self) -> None:
        """Refuse what the law could not take.

        Raises:
            ModelError: an arm without inertia, or joints that do not tell where the object is.
        """
        reason = int(self.work["reason"])
        if reason != at.NO_REASON:
            raise ModelError(_WHY[reason])


def read_state(chain: ChainModel, now: Look, rest: Look, data: pin.Data) -> ChainState:
    """The state of a chain.

    Args:
        now: at (q, v). rest: at the same q and v = 0, where all forces are gravity's.
        data: with the placements at q.

    Raises:
        ModelError: the motors cannot drive every motion, and the chain does not allow that.
    """
    work, joints = now.work, now.joints
    motion, wrench, turn = motions(work), wrenches(work), reflection(work)
    m, sigma, held = int(work["locked"]), work["sigma"], chain.payload is not None
    locked, free = turn[:m].T, turn[m:].T  # what η̇ moves, in energy coordinates
    S, sigma_e = motion @ free, locked @ sigma[:m]
    Lambda = work["Lambda"][m:, m:] + held * np.eye(6 - m)
    p = rest.work["chain_bias"][m:].copy()
    mu = work["chain_bias"][m:] + work["Lambda"][m:, :m] @ sigma[:m] - p
    W = joints["J_bar"] @ free
    G = W.T[:, chain.actuated]
    M = now.inertia(chain.slices)
    X_WO, V_O = pin.SE3(work["X_WO"]), work["V_O"].copy()
    payload = _NOTHING
    if chain.payload is not None:
        payload = chain.payload.terms(X_WO, V_O, chain.model.gravity.linear)
    tips = chain.tip_poses(data)
    return ChainState(
        X_WO=X_WO,
        V_O=V_O,
        S=S,
        C=wrench @ locked,
        Lambda_S=Lambda,
        Phi=S @ np.linalg.solve(Lambda, S.T),
        mu_S=mu,
        p_S=p,
        sigma=motion @ sigma_e,
        G=G,
        W=W,
        w=joints["offset"] + joints["J_bar"] @ sigma_e,
        h=joints["h"].copy(),
        M=M,
        arms=tuple(
            _arm_terms(now, rest, i, s, M[s, s], motion, wrench) for i, s in enumerate(chain.slices)
        ),
        payload=payload,
        metric=wrench @ wrench.T,
        grasp_points=np.array([t.translation for t in tips]),
        sensors=chain.sensor_poses(data),
        filters=tuple(_filters(chain, now, motion, wrench)),
        Lambda_out=wrench @ work["out_T"].T @ wrench.T,
        bias_out=work["bias_out"].copy(),
        unactuated=chain.unactuated_motions(G, S),
        reference=(wrench * now.head["reference"]) @ wrench.T,
        full_ranks=chain.full_ranks,
        singular_directions=tuple(_singular_directions(chain, now, motion, wrench))
        if work["n_lost"]
        else (),
    )


def _arm_terms(
    now: Look, rest: Look, number: int, s: slice, M: Array, motion: Array, wrench: Array
) -> ArmTerms:
    own, joints = now.arms[number], now.joints[s]
    J, J_bar = motion @ joints["J"].T, joints["J_bar"] @ wrench.T
    gamma, Lambda = motion @ own["gamma"], wrench @ own["Lambda"] @ wrench.T
    p, rank = J_bar.T @ rest.joints["h"][s], int(own["n_kept"])
    return ArmTerms(
        J=J,
        gamma=gamma,
        M=M,
        Phi=J @ np.linalg.solve(M, J.T),
        Lambda=Lambda,
        J_bar=J_bar,
        mu=J_bar.T @ joints["h"] - p - Lambda @ gamma,
        p=p,
        C=wrench @ own["resisted"][: int(own["n_locked"])].T,
        N=wrench @ own["kept"][:rank].T if own["passed"].any() else np.eye(6),
        rank=rank,
    )


def _filters(chain: ChainModel, now: Look, motion: Array, wrench: Array) -> Any:
    """Of each wrist's reading, as matrices at O."""
    for grasp, links, own in zip(chain.grasps, chain.outboard, now.arms, strict=True):
        filtered = links and not grasp.is_rigid
        yield wrench @ own["filter"] @ motion.T if filtered else None


def _singular_directions(chain: ChainModel, now: Look, motion: Array, wrench: Array) -> Any:
    """Every direction that the law found an arm to be losing."""
    reference = now.head["reference"]
    for i, (own, s) in enumerate(zip(now.arms, chain.slices, strict=True)):
        for e in range(int(own["n_lost"])):
            lost, mode = own["lost"][e], own["mode"][e, : s.stop - s.start].copy()
            yield SingularDirection(
                i, float(own["chi"][e]), float(own["share"][e]), wrench @ lost,
                motion @ (lost / reference), mode, bool(own["gone"][e]),
            )  # fmt: skip
