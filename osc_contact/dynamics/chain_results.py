"""State of a closed chain from the results of the law, and their comparison with Pinocchio."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import SE3

from osc_contact.dynamics.chain_records import ChainStructure
from osc_contact.dynamics.chain_state import ArmTerms, ChainState, ObjectTerms, SingularDirection
from osc_contact.dynamics.grasp import Grasp
from osc_contact.errors import ModelError
from osc_contact.law import records as at
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.nested import Table, View
from osc_contact.law.records import Bytes, Rows, views
from osc_contact.law.vectors import motions, reflection, wrenches
from osc_contact.spatial import Array, carry_twist, columns_of

_NO_OBJECT = ObjectTerms(np.zeros((6, 6)), np.zeros(6), np.zeros(6))  #: terms without an object

_NONE = np.zeros(0)  #: alpha_d and active contacts of a chain without contacts


class EvaluatedChain(ChainStructure, Protocol):
    """Closed chain with the functions from which its state is computed; see `ClosedChain`."""

    actuated: NDArray[np.intp]

    def law_row(self, from_leader: bool) -> Bytes:
        """Row of MODEL of the chain.

        Args:
            from_leader: True: the leader determines the object's pose; False: the pose is given.
        """

    def tip_poses(self, data: pin.Data | None = None) -> list[SE3]:
        """Poses of the tips of the arms in the world."""

    def sensor_poses(self, data: pin.Data | None = None) -> tuple[SE3 | None, ...]:
        """Poses of the wrist sensors in the world."""

    def unactuated_motions(self, G: Array, S: Array) -> Array:
        """Motions (6, u) of the object that no motor drives.

        Args:
            G: (d, n_a) generalised force on the object from motor torques.
            S: (6, d) basis of the object's motions.
        """


def chain_work(row: Bytes, q: Array, v: Array, X_WO: SE3 | None, V_O: Array | None) -> View:
    """Run the first part of the law, the arms without contacts; return WORK in new memory.

    Args:
        row: row of MODEL by `chain_row`, made with `from_leader`=True if no pose is given.
        q, v: (n,) joint positions and velocities (rad, m; rad/s, m/s).
        X_WO: pose of the object; None: the joints determine it.
        V_O: (6,) twist of the object; None: the joints determine it.
    """
    rows = Rows(row)
    head, memory, work, _ = views(rows)
    if X_WO is not None:
        memory.located = 1
        memory.X_WO = X_WO.homogeneous
        memory.given = at.GIVEN_POSE if V_O is None else at.GIVEN_TWIST
        memory.V_O = 0.0 if V_O is None else V_O
    rows.job.stop = at.MEASURE
    zeros = np.zeros(6)
    readings = np.zeros((len(head.arms), 6))
    inputs = (q, v, readings, np.eye(4), zeros, zeros, _NONE, np.zeros((0, 28)), _NONE)
    law_rows()(rows.raw, 0, inputs)
    return work


def mass_matrix(work: View, arms: Sequence[slice]) -> Array:
    """Mass matrix M (n, n) of all arms from WORK, which has the rows of each arm's own matrix.

    Args:
        work: record WORK.
        arms: slice of the joints of each arm.
    """
    n = len(work.joints)
    M = np.zeros((n, n))
    for joints in arms:
        M[joints, joints] = work.joints.M[joints, : joints.stop - joints.start]
    return M


def read_state(chain: EvaluatedChain, work: View, static_work: View, data: pin.Data) -> ChainState:
    """Convert the results of the law to the state of a chain at O in world axes.

    The law computes in energy coordinates, turned so that its first m axes are locked by the arms;
    the state has S, Λ_S, μ_S, p_S and so on in the coordinates η of S, and the arms' terms at O.

    Args:
        chain: the arms.
        work: record WORK at (q, v).
        static_work: record WORK at q and v = 0, in which all forces are those of gravity.
        data: data of Pinocchio with the placements at q.

    Raises:
        ModelError: the motors cannot drive every motion, and the chain does not permit that.
    """
    joints = work.joints
    motion = motions(work)
    wrench = wrenches(work)
    m = int(work.locked)
    # in energy coordinates: directions that the arms lock, and free motions
    locked, free = np.split(reflection(work).T, [m], axis=1)
    S = motion @ free
    sigma = work.sigma[:m]  # acceleration along the locked directions at η̇ = 0
    sigma_e = locked @ sigma
    Lambda = work.Lambda[m:, m:].copy()
    p = static_work.chain_bias[m:].copy()  # at v = 0 the bias is that of weight alone
    mu = work.chain_bias[m:] + work.Lambda[m:, :m] @ sigma - p
    W = joints.J_bar @ free
    G = W.T[:, chain.actuated]
    M = mass_matrix(work, chain.slices)
    reference = at.MODEL.view(chain.law_row(from_leader=False)).reference
    X_WO = pin.SE3(work.X_WO)
    V_O = work.V_O.copy()
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
        arms=_all_arm_terms(chain, work, static_work, M, motion, wrench),
        payload=_payload_terms(chain, X_WO, V_O),
        metric=wrench @ wrench.T,
        grasp_points=np.array([tip.translation for tip in chain.tip_poses(data)]),
        sensors=chain.sensor_poses(data),
        filters=_reading_filters(chain, work.arms, motion, wrench),
        Lambda_out=wrench @ work.out_T.T @ wrench.T,
        bias_out=work.bias_out.copy(),
        unactuated=chain.unactuated_motions(G, S),
        reference=(wrench * reference) @ wrench.T,
        full_ranks=chain.full_ranks,
        singular_directions=_singular_directions(chain, work.arms, reference, motion, wrench),
    )


def _all_arm_terms(
    chain: EvaluatedChain, work: View, static_work: View, M: Array, motion: Array, wrench: Array
) -> tuple[ArmTerms, ...]:
    """Convert the operational-space terms of each arm at its grasp.

    Args:
        chain: the arms.
        work: record WORK at (q, v).
        static_work: record WORK at q and v = 0, in which all forces are those of gravity.
        M: (n, n) joint-space inertia of all arms.
        motion, wrench: (6, 6) maps of motions and wrenches from energy coordinates to O, world
            axes.
    """
    terms = []
    for row, grasp, s in zip(work.arms, chain.grasps, chain.slices, strict=True):
        weight = static_work.joints.h[s]
        terms.append(_arm_terms(row, grasp, work.joints[s], weight, M[s, s], motion, wrench))
    return tuple(terms)


def _payload_terms(chain: EvaluatedChain, X_WO: SE3, V_O: Array) -> ObjectTerms:
    """Compute the terms of the held object; they are zero without an object.

    Args:
        chain: the arms, with the object.
        X_WO, V_O: its pose and twist (6,) (m/s, rad/s).
    """
    if chain.payload is None:
        return _NO_OBJECT
    return chain.payload.terms(X_WO, V_O, chain.model.gravity.linear)


def _reading_filters(
    chain: EvaluatedChain, arms: Table, motion: Array, wrench: Array
) -> tuple[Array | None, ...]:
    """Convert the factor (6, 6) of each arm's wrist readings at O.

    It is None for a rigid grasp or an arm without links beyond a sensor: then the factor is 1.

    Args:
        chain: the arms.
        arms: table `arms` of WORK.
        motion, wrench: (6, 6) maps of motions and wrenches from energy coordinates to O, world
            axes.
    """
    return tuple(
        wrench @ row.filter @ motion.T if links and not grasp.is_rigid else None
        for grasp, links, row in zip(chain.grasps, chain.outboard, arms, strict=True)
    )


def _arm_terms(
    row: np.record,
    grasp: Grasp,
    joints: Table,
    weight: Array,
    M: Array,
    motion: Array,
    wrench: Array,
) -> ArmTerms:
    """Convert the operational-space terms of one arm from the results of the law.

    Args:
        row: row of the arm in table `arms` of WORK.
        grasp: grasp of the arm.
        joints: rows of the arm's joints in table `joints` of WORK.
        weight: (n,) torques of gravity (N m, N).
        M: (n, n) mass matrix of the arm.
        motion, wrench: (6, 6) maps of motions and wrenches from energy coordinates to O, world
            axes.
    """
    J = motion @ joints.J.T
    J_bar = joints.J_bar @ wrench.T
    gamma = motion @ row.gamma
    Lambda = wrench @ row.Lambda @ wrench.T
    p = J_bar.T @ weight
    rank = int(row.n_kept)
    return ArmTerms(
        J=J,
        gamma=gamma,
        M=M,
        Phi=J @ np.linalg.solve(M, J.T),
        Lambda=Lambda,
        J_bar=J_bar,
        mu=J_bar.T @ joints.h - p - Lambda @ gamma,
        p=p,
        C=wrench @ row.resisted[: int(row.n_locked)].T,
        N=np.eye(6) if grasp.is_rigid else wrench @ row.kept[:rank].T,
        rank=rank,
    )


def _singular_directions(
    chain: EvaluatedChain, arms: Table, reference: Array, motion: Array, wrench: Array
) -> tuple[SingularDirection, ...]:
    """List the directions in which arms hardly move the object, from the results of the law.

    Args:
        chain: the arms.
        arms: table `arms` of WORK.
        reference: (6,) diagonal of Λ_ref in energy coordinates.
        motion, wrench: (6, 6) maps of motions and wrenches from energy coordinates to O, world
            axes.
    """
    directions = []
    for i, (row, joints) in enumerate(zip(arms, chain.slices, strict=True)):
        n = joints.stop - joints.start
        for e in range(int(row.n_lost)):
            directions.append(
                SingularDirection(
                    arm=i,
                    chi=float(row.chi[e]),
                    share=float(row.share[e]),
                    wrench=wrench @ row.lost[e],
                    twist=motion @ (row.lost[e] / reference),
                    mode=row.mode[e, :n].copy(),
                    locked=bool(row.gone[e]),
                )
            )
    return tuple(directions)


STATES = 3  #: random states at which the law is compared with Pinocchio
TOLERANCE = 1e-9  #: largest difference over the largest element, or over 1


def require_pinocchio_agrees(chain: EvaluatedChain, row: Bytes) -> None:
    """Compare J, M and h = C v + g of the law with Pinocchio's on a few random states.

    Args:
        chain: the arms.
        row: row of MODEL by `chain_row`, made with `from_leader`=False, as the object's pose does
            not matter.

    Raises:
        ModelError: a difference above TOLERANCE: a kind of joint or a property of the model that
            the law does not support.
    """
    rng = np.random.default_rng(0)
    data = chain.model.createData()
    n = chain.nq
    for _ in range(STATES):
        q = rng.uniform(-1.0, 1.0, n)
        v = rng.normal(size=n)
        work = chain_work(row, q, v, SE3.Identity(), np.zeros(6))
        pin.computeAllTerms(chain.model, data, q, v)
        for name, law_value, pinocchio_value in (
            ("J", carry_twist(work.joints.column.T, work.p_C, np.zeros(3)), columns_of(data.J)),
            ("M", mass_matrix(work, chain.slices), data.M),
            ("h", work.joints.h, data.nle),
        ):
            difference = float(np.abs(law_value - pinocchio_value).max(initial=0.0))
            if not difference <= TOLERANCE * np.abs(pinocchio_value).max(initial=1.0):
                raise ModelError(
                    f"the control law's {name} differs from Pinocchio's by {difference:.3g} on a "
                    "random state: the model has a joint or a property that the law does not "
                    "support. Please report it with the model; a chain of plain revolute and "
                    "prismatic joints is supported"
                )
