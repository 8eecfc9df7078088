"""Arms that hold one object: the closed chain of section 6 and its equation of motion, eq. 13.

The object can make only the motions S that every arm permits (dual SCARA: five). In them

    Λ_S η̇ + μ_S + p_S + Sᵀf_c = G τ,        a = S η̇ + σ,        q̈ = W η̇ + w,

and Φ₀ = S Λ_S⁻¹ Sᵀ takes the place of Λ₀⁻¹: a 6×6 matrix of rank d, never a damped inverse.
Grasps may permit motions (`Grasp`); these have no mass and no motor drives them.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.dynamics.chain_model import ChainModel, chain_row
from osc_contact.dynamics.chain_state import ArmTerms, ChainState, ObjectTerms, SingularDirection
from osc_contact.errors import ModelError
from osc_contact.law import records as at
from osc_contact.law.chain import OBJECT_UNKNOWN
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.reasons import NO_REASON, SENTENCES
from osc_contact.law.records import Bytes, Rows, views
from osc_contact.law.vectors import motions, reflection, wrenches
from osc_contact.spatial import Array, as_array, carry_twist

_NOTHING = ObjectTerms(np.zeros((6, 6)), np.zeros(6), np.zeros(6))

_NONE = np.zeros(0)


class Look:
    """What the law makes of the arms at (q, v), before any contact: WORK after its first part.

    Attributes:
        head, work: MODEL and WORK records. arms, joints: ARM_WORK and JOINT_WORK rows.
        jacobian: (n, 6) columns at the world's origin.
    """

    def __init__(
        self, row: Bytes, q: Array, v: Array, X_WO: Array | None = None, V_O: Array | None = None
    ) -> None:
        """Run it in separate memory.

        Args:
            row: from `chain_row`; led, if no pose is given.
            q, v: (n,). X_WO: (4, 4), V_O: (6,) of the object, if they are given.
        """
        rows = Rows(row)
        records = views(rows)
        self.head, memory, self.work, _ = records
        k = int(self.head.n_arms)
        if X_WO is not None:
            memory.located = 1
            memory.X_WO = X_WO
            memory.given = at.GIVEN_POSE if V_O is None else at.GIVEN_TWIST
            memory.V_O = 0.0 if V_O is None else V_O
        rows.job.stop = at.MEASURE
        six = np.zeros(6)
        given = q, v, np.zeros((k, 6)), np.eye(4), six, six, _NONE, np.zeros((0, 28))
        law_rows()(rows.raw, 0, given)
        self.arms = self.work.arms
        self.joints = self.work.joints
        self.jacobian = self.work.J_world

    def inertia(self, arms: Sequence[slice]) -> Array:
        """M (n, n) of all arms, given each one's part of the joints."""
        n = len(self.joints)
        M = np.zeros((n, n))
        for s in arms:
            M[s, s] = self.joints.M[s, : s.stop - s.start]
        return M


def read_state(chain: ChainModel, now: Look, rest: Look, data: pin.Data) -> ChainState:
    """The state of a chain.

    Args:
        now: at (q, v). rest: at the same q and v = 0, where all forces are gravity's.
        data: with the placements at q.

    Raises:
        ModelError: the motors cannot drive every motion, and the chain does not allow that.
    """
    work = now.work
    joints = now.joints
    motion = motions(work)
    wrench = wrenches(work)
    m = int(work.locked)
    locked, free = np.split(reflection(work).T, [m], axis=1)  # what η̇ moves, in energy coordinates
    S = motion @ free
    sigma = work.sigma[:m]
    sigma_e = locked @ sigma
    Lambda = work.Lambda[m:, m:] + (chain.payload is not None) * np.eye(6 - m)
    p = rest.work.chain_bias[m:].copy()
    mu = work.chain_bias[m:] + work.Lambda[m:, :m] @ sigma - p
    W = joints.J_bar @ free
    G = W.T[:, chain.actuated]
    M = now.inertia(chain.slices)
    X_WO = pin.SE3(work.X_WO)
    V_O = work.V_O.copy()
    payload = _NOTHING
    if chain.payload is not None:
        payload = chain.payload.terms(X_WO, V_O, chain.model.gravity.linear)
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
        w=joints.offset + joints.J_bar @ sigma_e,
        h=joints.h.copy(),
        M=M,
        arms=tuple(
            _arm_terms(now, rest, i, s, M[s, s], motion, wrench) for i, s in enumerate(chain.slices)
        ),
        payload=payload,
        metric=wrench @ wrench.T,
        grasp_points=np.array([tip.translation for tip in chain.tip_poses(data)]),
        sensors=chain.sensor_poses(data),
        filters=tuple(
            wrench @ own.filter @ motion.T if links and not grasp.is_rigid else None
            for grasp, links, own in zip(chain.grasps, chain.outboard, now.arms, strict=True)
        ),
        Lambda_out=wrench @ work.out_T.T @ wrench.T,
        bias_out=work.bias_out.copy(),
        unactuated=chain.unactuated_motions(G, S),
        reference=(wrench * now.head.reference) @ wrench.T,
        full_ranks=chain.full_ranks,
        singular_directions=tuple(_singular_directions(chain, now, motion, wrench)),
    )


def _arm_terms(
    now: Look, rest: Look, number: int, s: slice, M: Array, motion: Array, wrench: Array
) -> ArmTerms:
    own = now.arms[number]
    joints = now.joints[s]
    J = motion @ joints.J.T
    J_bar = joints.J_bar @ wrench.T
    gamma = motion @ own.gamma
    Lambda = wrench @ own.Lambda @ wrench.T
    p = J_bar.T @ rest.joints.h[s]
    rank = int(own.n_kept)
    return ArmTerms(
        J=J,
        gamma=gamma,
        M=M,
        Phi=J @ np.linalg.solve(M, J.T),
        Lambda=Lambda,
        J_bar=J_bar,
        mu=J_bar.T @ joints.h - p - Lambda @ gamma,
        p=p,
        C=wrench @ own.resisted[: int(own.n_locked)].T,
        N=wrench @ own.kept[:rank].T if own.passed.any() else np.eye(6),
        rank=rank,
    )


def _singular_directions(chain: ChainModel, now: Look, motion: Array, wrench: Array) -> Any:
    """Every direction that the law found an arm to be losing."""
    reference = now.head.reference
    for i, (own, s) in enumerate(zip(now.arms, chain.slices, strict=True)):
        for e in range(int(own.n_lost)):
            lost = own.lost[e]
            yield SingularDirection(
                i,
                float(own.chi[e]),
                float(own.share[e]),
                wrench @ lost,
                motion @ (lost / reference),
                own.mode[e, : s.stop - s.start].copy(),
                bool(own.gone[e]),
            )


STATES = 3
TOLERANCE = 1e-9


def require_pinocchio_agrees(chain: ChainModel, row: Bytes) -> None:
    """Compare J, M and h = C v + g on a few random states.

    Args:
        chain: the arms. row: from `chain_row`, not led: where the object is does not matter.

    Raises:
        ModelError: a difference above 1e-9 of the largest element: a kind of joint or a property of
            the model that the law does not know.
    """
    rng = np.random.default_rng(0)
    data = chain.model.createData()
    n = chain.nq
    for _ in range(STATES):
        q = rng.uniform(-1.0, 1.0, n)
        v = rng.normal(size=n)
        look = Look(row, q, v, np.eye(4), np.zeros(6))
        pin.computeAllTerms(chain.model, data, q, v)
        for name, ours, theirs in (
            ("J", look.jacobian, data.J.T),
            ("M", look.inertia(chain.slices), data.M),
            ("h", look.joints.h, data.nle),
        ):
            worst = float(np.abs(ours - theirs).max(initial=0.0))
            if not worst <= TOLERANCE * np.abs(theirs).max(initial=1.0):
                raise ModelError(
                    f"the control law's {name} differs from Pinocchio's by {worst:.3g} on a random "
                    "state: the model has a joint or a property that the law does not support. "
                    "Please report it with the model; a chain of plain revolute and prismatic "
                    "joints is supported"
                )


class ClosedChain(ChainModel):
    """Several arms that hold one object (or one arm whose tip is the object).

    Made, and described by attributes, as its `ChainModel`.
    """

    def state(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        X_WO: pin.SE3 | None = None,
        V_O: npt.ArrayLike | None = None,
        *,
        data: pin.Data | None = None,
    ) -> ChainState:
        """Everything the contact model needs to know of the chain at (q, v).

        Args:
            q: (n,) joint positions, arms in order, each in model order, passive joints included.
            v: (n,) joint velocities, consistent with the closed loop.
            X_WO, V_O: pose and twist (6,) of the object, where the joints do not determine them.
            data: to work in (threads need one each); default: the chain's own.

        Raises:
            InvalidInputError: wrong sizes or non-finite numbers.
            ModelError: the joints do not determine where the object is, or the motors cannot drive
                every motion the arms permit.
        """
        q = as_array("q", q, (self.nq,))
        v = as_array("v", v, (self.nq,))
        data = self.data if data is None else data
        pin.forwardKinematics(self.model, data, q, v)
        led = X_WO is None and V_O is None and self.leader is not None
        row = self.law_row(led)
        still = np.zeros(self.nq)
        if led:
            now = Look(row, q, v)
            rest = Look(row, q, still)
        else:
            X_WO = X_WO or self.object_pose(data)
            V_O = self._twist(X_WO, data) if V_O is None else as_array("V_O", V_O, (6,))
            now = Look(row, q, v, X_WO.homogeneous, V_O)
            rest = Look(row, q, still, X_WO.homogeneous, np.zeros(6))
        reason = int(now.work.reason)
        if reason != NO_REASON:
            measured = ", or give the measured pose and twist: state(q, v, X_WO, V_O)"
            raise ModelError(SENTENCES[reason] + measured * (reason == OBJECT_UNKNOWN))
        return read_state(self, now, rest, data)

    def _twist(self, X_WO: pin.SE3, data: pin.Data) -> Array | None:
        """(6,) of the object from the leader's tip; None: the law finds it."""
        if self.leader is None:
            return None
        joint = self.model.frames[self.tips[self.leader]].parentJoint
        V = data.oMi[joint].act(data.v[joint]).vector
        return carry_twist(V, np.zeros(3), X_WO.translation)

    def law_row(self, led: bool) -> Bytes:
        """The chain as the law's MODEL, see `chain_row`.

        Raises:
            ModelError: arms that the law does not know.
        """
        row = self._rows[led]
        at.MODEL.view(row).gravity = self.model.gravity.linear  # may have changed
        return row

    @cached_property
    def _rows(self) -> dict[bool, Bytes]:
        rows = {led: chain_row(self, led) for led in (False, True)}
        require_pinocchio_agrees(self, rows[False])
        return rows
