"""The exact plant: joint-space dynamics, bilateral rigid contacts, loops by multipliers."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.assembly import (
    closed,
    constraint_rows,
    inertia_of,
    inverse_rows,
    object_columns,
    object_pose,
)
from osc_contact.dynamics.closed_chain import ClosedChain, columns_at
from osc_contact.dynamics.environment import Rail
from osc_contact.dynamics.grasp import moved
from osc_contact.errors import ModelError, PlantError
from osc_contact.interface import Measurement
from osc_contact.lab.plants.faces import Faces, stacked
from osc_contact.loop.judge import Truth, Watched, require_duration
from osc_contact.robots.model import sliding
from osc_contact.spatial import (
    Array,
    as_array,
    block_diagonal,
    carry_twist,
    carry_wrench,
    cross,
    cross_twist,
)

_TURNING_FRICTION_SPEED = (
    1e-3  #: speed at which dry friction of a turning joint is developed (rad/s)
)
_SLIDING_FRICTION_SPEED = 1e-4  #: speed at which dry friction of a sliding joint is developed (m/s)


# --- Section of an arm at a wrist sensor, and the wrench there ------------------------------------


@dataclass(frozen=True)
class WristCut:
    """Section through a link at a wrist sensor.

    Attributes:
        joint: index of the joint that moves the link.
        placement: pose of the sensor's frame in the frame of the joint.
        inboard: (6, 6) inertia of the link's part on the arm's side, at the joint.
    """

    joint: int
    placement: pin.SE3
    inboard: Array

    def reading(self, data: pin.Data) -> Array:
        """Wrench (6,) through the section, in the sensor's axes (N, N m).

        It is the wrench of the joint less the forces that the inboard part needs.

        Args:
            data: results of `pin.rnea`.
        """
        v = data.v[self.joint]
        inertial = pin.Force(self.inboard @ data.a_gf[self.joint].vector)
        inboard_force = inertial + v.cross(pin.Force(self.inboard @ v.vector))
        return np.asarray(self.placement.actInv(data.f[self.joint] - inboard_force).vector)


def wrist_cut(model: pin.Model, cut: int) -> WristCut:
    """Make the section at the frame of a wrist sensor through the link that carries it.

    The links beyond the sensor are fixed to the same joint as the link before it. The inertia of
    the part before the section is that of the joint's whole body, less the inertias of all frames
    beyond.

    Args:
        model: model of the arms.
        cut: index of the sensor's frame.

    Returns:
        Joint, placement of the sensor in it, and the inertia (6, 6) of the part before the section,
        in the joint's frame.
    """
    frame = model.frames[cut]
    joint = frame.parentJoint
    parent = frame.parentFrame
    kind = model.frames[parent].type
    if kind == pin.FrameType.JOINT:  # the section is at the joint itself
        return WristCut(joint, frame.placement, np.zeros((6, 6)))
    outboard = {parent if kind == pin.FrameType.FIXED_JOINT else cut}
    inboard: Array = model.inertias[joint].matrix()
    for f, other in enumerate(model.frames):
        if other.parentFrame in outboard:
            outboard.add(f)
        if f in outboard and other.parentJoint == joint:
            inboard = inboard - other.placement.act(other.inertia).matrix()
    return WristCut(joint, frame.placement, inboard)


# --- Equations of motion of the whole plant, and their solution -----------------------------------


@dataclass(frozen=True)
class Equations:
    """Equations of motion of an instant, without the motors: M x = force + Aᵀλ, A x = right.

    The unknowns x (m,) are accelerations: n of the joints, 6 of the object if no arm leads it, then
    one of each free body on a rail. λ (k,) are multipliers: for each loop the wrenches that it
    transmits, then the contact forces α.

    Attributes:
        X: pose of the object.
        V: (6,) its twist at O, world axes.
        N: (6, r) directions of force of the contacts.
        M: (m, m) inertia matrix.
        force: (m,) weight, velocity forces, friction, springs (N, N m).
        slope: (n,) derivative of the joint friction with respect to the velocity.
        A: (k, m) rows of loops and contacts.
        right: (k,) right-hand side.
        ends: (loops + 1,) first row of each loop, and the row after the last loop.
        passed: for each loop the wrenches (6, rows) at O that it transmits.
        first: (6, n or n + 6) matrix of V_O from the rates of joints, or of joints and object.
        gamma_O: (6,) acceleration of the object at zero joint accelerations.
        joints: placements of the last joints of the arms.
    """

    X: pin.SE3
    V: Array
    N: Array
    M: Array
    force: Array
    slope: Array
    A: Array
    right: Array
    ends: Array
    passed: list[Array]
    first: Array
    gamma_O: Array
    joints: list[pin.SE3]


@dataclass(frozen=True)
class Solution:
    """Solution of the equations of motion at one instant.

    Attributes:
        qdd: (n,) joint accelerations.
        sdd: (bodies, 2) accelerations along and about the rails.
        a_O: (6,) spatial acceleration of the object at O, world axes.
        alpha: (r,) contact forces (N).
        wrenches: (arms, 6) wrist readings, in the sensors' axes.
    """

    qdd: Array
    sdd: Array
    a_O: Array
    alpha: Array
    wrenches: Array


# --- The plant ------------------------------------------------------------------------------------
#
# It shares no formula with the closed chain of the controller: no S, no Λ_S, but all joints of all
# arms at once with one multiplier per constraint row. The object rides on the first arm that holds
# it rigidly; where none does it is a separate body. Positions and velocities are projected onto the
# constraints after each step, so NᵀV_rel = 0 to rounding.


class RigidPlant:
    """Arms, object and faces as rigid bodies whose contacts neither open nor yield."""

    def __init__(
        self,
        chain: ClosedChain,
        contacts: Sequence[ContactPair],
        step: float,
        rails: Sequence[Rail] | None = None,
        on: Sequence[int] | None = None,
    ) -> None:
        """Make the plant of true arms, object and contacts, at rest at zero joint positions.

        Args:
            chain: the true arms, grasps and object (not the controller's model).
            contacts: the true contacts, of any kind.
            step: integration step (s).
            rails: rail of each body of the environment; None: all bodies are fixed.
            on: index of the body of each contact; None: each contact has its own body.

        Raises:
            ModelError: the chain has no object.
        """
        if chain.payload is None:
            raise ModelError("the rigid plant needs an object; give the chain a payload")
        self.chain = chain
        self.contacts = tuple(contacts)
        self.faces = Faces(rails, on, len(contacts))
        self.dt = step
        self.time = 0.0
        self.model = chain.model.copy()
        #: frame of each arm's tip
        self._tip_frames = [self.model.frames[tip] for tip in chain.tips]
        if chain.leader is not None:  # the object rides on its last joint
            tip = self._tip_frames[chain.leader]
            X = tip.placement * chain.grasps[chain.leader].X_TO
            self.model.appendBodyToJoint(tip.parentJoint, chain.payload.inertia, X)
        #: parts of the model beyond each wrist sensor; None without a sensor
        self._wrist_cuts = [
            None if sensor is None else wrist_cut(chain.model, sensor) for sensor in chain.sensors
        ]
        #: (n,) speed below which dry friction is regularised (rad/s, m/s)
        self._friction_speed = np.where(
            sliding(self.model), _SLIDING_FRICTION_SPEED, _TURNING_FRICTION_SPEED
        )
        self.data = self.model.createData()
        self.q = np.zeros(chain.nq)
        self.v = np.zeros(chain.nq)
        # pose and twist of the object if no arm leads it
        self._X = pin.SE3.Identity()
        self._V = np.zeros(6)  #: (6,) twist of the object if no arm leads it; `_X` its pose
        self._tau = np.zeros(chain.n_a)  #: (n_a,) torques that act (N m, N)
        #: equations, and their solution, with the state that they belong to
        self._cached_equations: tuple[bytes, Equations] | None = None
        #: equations, slope of friction by which M was changed, and results of `_inverse`
        self._last_inverse: tuple[Equations, Array, tuple[Array, Array, Array]] | None = None
        #: solution of these equations under the present torques
        self._cached_solution: tuple[bytes, tuple[Solution, tuple[pin.SE3, Array]]] | None = None

    def reset(self, q: Array) -> None:
        """Start at rest at joint positions next to q (n,) at which loops and contacts close."""
        self.time = 0.0
        self.faces.reset()
        q = as_array("q", q, (self.chain.nq,))
        self._project_state(q, object_pose(self.chain, q), np.zeros(self.chain.nq), np.zeros(6))
        self._tau = np.zeros(self.chain.n_a)

    def hold(self, tau: Array) -> None:
        """Apply torques tau (n_a,) from now on without letting time pass (N m, N)."""
        self._tau = as_array("tau", tau, (self.chain.n_a,))

    def measure(self) -> Measurement:
        """Read encoders, and the wrist wrenches under the torques applied last."""
        wrenches = self._present_solution()[0].wrenches.copy()
        return Measurement(self.q.copy(), self.v.copy(), wrenches, self.faces.touched())

    def truth(self) -> Truth:
        """True state, with contact forces under the torques applied last; contacts stay closed."""
        solution, (X, V) = self._present_solution()
        closed = np.ones(len(self.contacts), dtype=bool)
        return Truth(solution.alpha, closed, X, V, tuple(self.faces.poses()))

    def log(self) -> Watched:
        """New, empty record of the truth."""
        return Watched(self, self.contacts)

    def _present_solution(self) -> tuple[Solution, tuple[pin.SE3, Array]]:
        """Solution under the torques applied last; pose and twist (6,) of the object.

        `measure` and `truth` of one instant share them.
        """
        key = self._state_key() + self._tau.tobytes()
        if self._cached_solution is None or self._cached_solution[0] != key:
            solution = self._solve_motion(self._tau, with_wrenches=True)
            equations = self._present_equations()
            self._cached_solution = (key, (solution, (equations.X, equations.V)))
        return self._cached_solution[1]

    def poses(self) -> Array:
        """True poses (1 + arms, 4, 4) of the object and of the tips."""
        pin.computeAllTerms(self.model, self.data, self.q, self.v)
        tips = self.chain.tip_poses(self.data)
        return np.array([X.homogeneous for X in (self._object_state()[0], *tips)])

    def command(self, tau: Array, duration: float) -> None:
        """Integrate with the trapezoidal rule in positions, then project onto the constraints.

        Args:
            tau: (n_a,) motor torques (N m, N).
            duration: period (s), rounded to whole steps.

        Raises:
            PlantError: the simulation diverges.
        """
        require_duration(duration)
        self.hold(tau)
        for _ in range(max(1, round(duration / self.dt))):
            solution = self._solve_motion(self._tau, ahead=self.dt)
            v = self.v + solution.qdd * self.dt
            q = self.q + 0.5 * (self.v + v) * self.dt
            if not (np.isfinite(q).all() and np.abs(v).max() < 1e3):
                raise PlantError(f"rigid plant diverged at t = {self.time:.4f} s, v = {v}")
            self.time += self.dt
            faces = self.faces
            rates = faces.rates + solution.sdd * self.dt
            faces.s += 0.5 * (faces.rates + rates) * self.dt
            faces.rates[:] = rates
            faces.drive(self.time)
            a = solution.a_O.copy()
            a[:3] += cross(self._V[3:], self._V[:3])  # from spatial to classical
            V = self._V + a * self.dt
            X = moved(self._X, 0.5 * (self._V + V) * self.dt)
            self._project_state(q, X, v, V)

    def stop(self, reason: str = "") -> None:
        """Accept a stop; a simulation needs no action."""

    def accelerations(self, tau: Array) -> tuple[Array, Array, Array]:
        """Accelerations and contact forces in the present state under given torques.

        Args:
            tau: (n_a,) motor torques (N m, N).

        Returns:
            Joint accelerations (n,); spatial acceleration (6,) of the object at O, world axes;
            contact forces α (r,) (N).
        """
        solution = self._solve_motion(as_array("tau", tau, (self.chain.n_a,)))
        return solution.qdd, solution.a_O, solution.alpha

    # --- dynamics --------------------------------------------------------------------------------

    def _solve_motion(
        self, tau: Array, with_wrenches: bool = False, ahead: float = 0.0
    ) -> Solution:
        """Solve the equations of joints and free bodies, with the multipliers of all constraints.

            M x = force + Aᵀλ,   A x = right

        x (m,) are accelerations of the joints, of the object if no arm leads it, and of the bodies
        on rails, λ the multipliers of the loops, then the contact forces α; `Equations` has the
        operands, the motor torques are added to `force`. Joint friction D v + F tanh(v / v₀) is
        extrapolated in time, to first order, which makes fast friction stable: its slope times
        `ahead` is added to M.

        Args:
            tau: (n_a,) motor torques (N m, N).
            with_wrenches: True: wrist readings are computed, too; False: they are zero.
            ahead: time by which friction is extrapolated (s).

        Returns:
            Accelerations of joints, rails and object, contact forces α (N), and wrist readings.
        """
        chain = self.chain
        n = chain.nq
        equations = self._present_equations()
        force = equations.force.copy()
        force[chain.actuated] += tau
        M, inverse, multipliers = self._inverse(equations, ahead)
        # accelerations without constraints, then their correction so that A x = right
        unconstrained = np.linalg.solve(M, force)
        deficit = equations.right - equations.A @ unconstrained
        x = unconstrained + inverse @ deficit
        lam = multipliers @ deficit  # M x = force + Aᵀλ
        # parts of x: joints and object first, then the free bodies on rails
        size = equations.first.shape[1]
        sdd = self.faces.second.copy()
        sdd[self.faces.free] = x[size:]
        *loop_multipliers, alpha = np.split(lam, equations.ends[1:])
        qdd = x[:n]
        wrenches = np.zeros((len(self._tip_frames), 6))
        if with_wrenches:
            loops = [
                basis @ values
                for basis, values in zip(equations.passed, loop_multipliers, strict=True)
            ]
            wrenches = self._wrist_readings(qdd, loops, equations.N @ alpha, equations)
        return Solution(qdd, sdd, equations.first @ x[:size] + equations.gamma_O, alpha, wrenches)

    def _inverse(self, equations: Equations, ahead: float) -> tuple[Array, Array, Array]:
        """Inertia (m, m) with the slope of friction, and results of `inverse_rows` for it.

        Those of the last call are returned where they are the same.

        Args:
            equations: equations of the instant.
            ahead: time by which friction is extrapolated (s).
        """
        added = ahead * equations.slope
        last = self._last_inverse
        if last is None or last[0] is not equations or (last[1] != added).any():
            M = equations.M.copy()
            n = len(added)
            M[:n, :n] += np.diag(added)
            last = (equations, added, (M, *inverse_rows(self.chain, equations.A, M)))
            self._last_inverse = last
        return last[2]

    def _state_key(self) -> bytes:
        """Bytes of all numbers that the equations depend on, as the key of a cache."""
        faces = self.faces
        free = (self._V, self._X.homogeneous, faces.s, faces.rates, faces.second)
        return np.concatenate((self.q, self.v, *free), axis=None).tobytes()

    def _present_equations(self) -> Equations:
        """Equations in the present state, which `measure`, `truth` and `command` share."""
        state = self._state_key()
        if self._cached_equations is None or self._cached_equations[0] != state:
            self._cached_equations = (state, self._make_equations())
        return self._cached_equations[1]

    def _close_loops(
        self, X: pin.SE3, V: Array, J: Array, gamma_O: Array
    ) -> tuple[list[Array], list[Array]]:
        """Closure of the loops: every arm but the leader must move the object as the leader does.

        Args:
            X: pose of the object.
            V: (6,) its twist at O in world axes (m/s, rad/s).
            J: (6, n) Jacobians of all arms side by side, at O in world axes.
            gamma_O: (6,) acceleration of the object by the velocities of the leader's joints at
                q̈ = 0 (m/s², rad/s²).

        Returns:
            For each other arm: the accelerations (m_i,) by velocities that its joints have to
            balance, and the wrenches (6, m_i) that its grasp transmits, in world axes at O.
        """
        chain = self.chain
        tips = chain.tip_poses(self.data)
        right_sides = []
        normals = []
        for i, (s, grasp) in enumerate(zip(chain.slices, chain.grasps, strict=True)):
            if i == chain.leader:
                continue
            drift = self._drift(i, X) - gamma_O
            basis = np.eye(6)
            if not grasp.is_rigid:  # N is carried by the tip while the object slips
                basis = grasp.wrenches_at(tips[i], X.translation)
                drift = basis.T @ (drift + cross_twist(J[:, s] @ self.v[s], V))
            right_sides.append(drift)
            normals.append(basis)
        return right_sides, normals

    def _make_equations(self) -> Equations:
        """Compute the equations of motion in the present state, M x = force + Aᵀλ, A x = right.

        x has the accelerations of the joints (n), then those of the object (6, only if no arm holds
        it rigidly) and of the bodies on rails. M is their inertia, `force` the forces without
        motors (weight, products of velocities, friction; N m, N), A the rows of the constraints:
        loops closed by the grasps, then contacts, whose multipliers λ are the contact forces α.
        """
        chain = self.chain
        model = self.model
        faces = self.faces
        pin.computeAllTerms(model, self.data, self.q, self.v)
        pin.forwardKinematics(model, self.data, self.q, self.v, 0.0 * self.v)
        X, V = self._object_state()
        O = X.translation  # noqa: E741
        parts = faces.parts(self.contacts, X, V)
        N, n_gamma = stacked(parts)
        # object: Jacobian of x at O, drift at zero accelerations, closure of the loops
        J = self._jacobian(X)
        first = object_columns(chain, J)
        gamma_O = np.zeros(6) if chain.leader is None else self._drift(chain.leader, X)
        right_sides, normals = self._close_loops(X, V, J, gamma_O)
        ends = np.cumsum([0, *map(len, right_sides)])
        # contacts: no acceleration along N relative to the faces
        by_rail, face_drift = faces.closing(parts, O)
        right_sides.append(N.T @ gamma_O - n_gamma - face_drift)
        # smooth friction of the joints, dry · tanh(v/v_slip), and its slope for the implicit step
        dry = np.array(model.upperDryFrictionLimit)
        share = np.tanh(self.v / self._friction_speed)
        slope = model.damping + dry / self._friction_speed * (1.0 - share**2)
        force = -self.data.nle - (model.damping * self.v + dry * share)
        # without a leader the object's motion has coordinates of its own, as have bodies on rails
        M = np.array(self.data.M)
        if chain.leader is None:
            body = chain.reference.terms(X, V, model.gravity.linear)
            force = np.concatenate((force, -body.mu - body.p))
            M = block_diagonal([M, body.Lambda])
        A = constraint_rows(chain, O, N, self.data)
        # columns of A, and inertia, of the bodies that move on rails by forces
        bodies, joints = faces.free
        if len(bodies):
            contact_rows = by_rail[:, bodies, joints]
            loop_rows = np.zeros((ends[-1], len(bodies)))
            A = np.hstack((A, np.vstack((loop_rows, contact_rows))))
            M = block_diagonal([M, np.diag([faces.rails[i].inertia for i in bodies])])
            force = np.concatenate((force, faces.pulls(model.gravity.linear)))
        return Equations(
            X=X.copy(),
            V=V.copy(),
            N=N,
            M=M,
            force=force,
            slope=slope,
            A=A,
            right=np.concatenate(right_sides),
            ends=ends,
            passed=normals,
            first=first,
            gamma_O=gamma_O,
            joints=[self.data.oMi[tip.parentJoint].copy() for tip in self._tip_frames],
        )

    def _wrist_readings(
        self, qdd: Array, loops: list[Array], f_c: Array, equations: Equations
    ) -> Array:
        """Wrist readings (arms, 6) in the sensors' axes, by the Newton–Euler algorithm (N, N m).

        Args:
            qdd: (n,) joint accelerations.
            loops: wrench (6,) at O of each arm on the object, in the order of the arms without the
                leader.
            f_c: (6,) wrench of the object on its contacts at O.
            equations: equations of the instant.
        """
        leader = self.chain.leader
        if leader is not None:  # the object is part of its last link and needs no wrench
            loops.insert(leader, f_c - sum(loops, np.zeros(6)))
        external = [pin.Force.Zero() for _ in range(self.model.njoints)]
        for tip, wrench, X in zip(self._tip_frames, loops, equations.joints, strict=True):
            at_origin = pin.Force(carry_wrench(-wrench, equations.X.translation, np.zeros(3)))
            external[tip.parentJoint] = X.actInv(at_origin)
        pin.rnea(self.model, self.data, self.q, self.v, qdd, external)
        return np.array(
            [
                np.zeros(6) if sensor is None else sensor.reading(self.data)
                for sensor in self._wrist_cuts
            ]
        )

    def _object_state(self) -> tuple[pin.SE3, Array]:
        """Pose of the object and its twist (6,) at O, world axes."""
        leader = self.chain.leader
        if leader is None:
            return self._X, self._V
        X = self.chain.object_pose(self.data)
        s = self.chain.slices[leader]
        return X, self._jacobian(X)[:, s] @ self.v[s]

    def _jacobian(self, X: pin.SE3) -> Array:
        """Jacobian (6, n) of all joints at the origin of X, world axes."""
        return columns_at(self.data.J, X.translation)

    def _drift(self, i: int, X: pin.SE3) -> Array:
        """Spatial acceleration (6,) of a tip at q̈ = 0, at the origin of X, world axes.

        It is computed by Pinocchio's acceleration pass, not by a formula of the controller.

        Args:
            i: index of the arm.
            X: pose of the object.
        """
        a = pin.getFrameAcceleration(self.model, self.data, self.chain.tips[i], pin.WORLD).vector
        return carry_twist(a, np.zeros(3), X.translation)

    def _project_state(self, q: Array, X: pin.SE3, v: Array, V: Array) -> None:
        """Project positions, then velocities, onto the constraints, and store them.

        Args:
            q: (n,) joint positions.
            X: pose of the object, used if no arm leads it.
            v: (n,) joint velocities.
            V: (6,) twist of the object at O, used if no arm leads it.
        """
        chain = self.chain
        self.q, self._X = closed(chain, q, X, partial(self.faces.gaps, self.contacts))
        pin.computeAllTerms(chain.model, chain.data, self.q, v)
        X = self._X if chain.leader is None else chain.object_pose()
        parts = self.faces.parts(self.contacts, X, np.zeros(6))
        A = constraint_rows(chain, X.translation, stacked(parts)[0])
        by_rail, _ = self.faces.closing(parts, X.translation)
        b = np.zeros(len(A))
        b[len(A) - len(by_rail) :] = -np.tensordot(by_rail, self.faces.rates)
        x = np.concatenate((v, V))[: A.shape[1]]
        inverse, _ = inverse_rows(chain, A, inertia_of(chain, X))
        for _ in range(2):  # the second projection removes rounding errors of the first
            x = x - inverse @ (A @ x - b)
        self.v = x[: chain.nq]
        self._V = x[chain.nq :] if chain.leader is None else V
