"""The exact plant: joint-space dynamics, bilateral rigid contacts, loops by multipliers."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

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

#: speeds by which dry friction is developed (rad/s, m/s)
_SLIP = 1e-3
_SLIDE = 1e-4


# --- Where a wrist sensor cuts the arm, and what it reads there -----------------------------------


@dataclass(frozen=True)
class WristCut:
    """A cut through a link: its joint, where it sits, what stays on the arm's side."""

    joint: int
    placement: pin.SE3
    inboard: Array  # (6, 6) at the joint

    def reading(self, data: pin.Data) -> Array:
        """(6,) wrench through it, in its axes, after `pin.rnea`: the joint's, less its own side."""
        v = data.v[self.joint]
        moving = pin.Force(self.inboard @ data.a_gf[self.joint].vector)
        own = moving + v.cross(pin.Force(self.inboard @ v.vector))
        return np.asarray(self.placement.actInv(data.f[self.joint] - own).vector)


def wrist_cut(model: pin.Model, cut: int) -> WristCut:
    """The cut at a frame, by its number."""
    frame = model.frames[cut]
    joint = frame.parentJoint
    above = frame.parentFrame
    kind = model.frames[above].type
    if kind == pin.FrameType.JOINT:  # cut at the joint itself
        return WristCut(joint, frame.placement, np.zeros((6, 6)))
    beyond = {above if kind == pin.FrameType.FIXED_JOINT else cut}
    inboard: Array = model.inertias[joint].matrix()
    for f, other in enumerate(model.frames):
        if other.parentFrame in beyond:
            beyond.add(f)
        if f in beyond and other.parentJoint == joint:
            inboard = inboard - other.placement.act(other.inertia).matrix()
    return WristCut(joint, frame.placement, inboard)


# --- Its model, its equations side by side, and their solution ------------------------------------


@dataclass(frozen=True)
class Equations:
    """All of an instant's equations but the motors' torques, and what is solved once for all."""

    X: pin.SE3  # of the object
    V: Array  # (6,)
    N: Array  # (6, r)
    M: Array  # (m, m) of joints, of an object that no arm leads, of bodies on rails
    force: Array  # (m,) without motors
    slope: Array  # (n,) of the joint friction over the velocity
    A: Array  # (k, m) rows of loops and contacts
    right: Array  # (k,)
    ends: Array  # (loops + 1,) of the rows of each loop
    passed: list[Array]  # of each loop, the wrenches that it transmits, at O
    first: Array  # (6, n or n + 6) V_O from the joints' rates
    gamma_O: Array  # (6,)
    joints: list[pin.SE3]  # placements of the joints at the tips


@dataclass(frozen=True)
class Solution:
    """The equations of one instant."""

    qdd: Array  # (n,)
    sdd: Array  # (bodies, 2) accelerations along the rails
    a_O: Array  # (6,) of the object, spatial
    alpha: Array  # (r,)
    wrenches: Array  # (arms, 6) in the wrists


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
        """Build from the true parts.

        Args:
            chain: the true arms, grasps and object (not the controller's copy).
            contacts: the true contacts, of any kind.
            step: integration step (s).
            rails: how each body of the environment moves; default: all are fixed.
            on: the body of each contact; default: each has its own.

        Raises:
            ModelError: the chain holds no object.
        """
        if chain.payload is None:
            raise ModelError("the rigid plant needs an object; give the chain a payload")
        self.chain = chain
        self.contacts = tuple(contacts)
        self.faces = Faces(rails, on, len(contacts))
        self.dt = step
        self.time = 0.0
        self.model = chain.model.copy()
        self._tips = [self.model.frames[tip] for tip in chain.tips]
        if chain.leader is not None:  # the object rides on its last joint
            tip = self._tips[chain.leader]
            X = tip.placement * chain.grasps[chain.leader].X_TO
            self.model.appendBodyToJoint(tip.parentJoint, chain.payload.inertia, X)
        self._sensors = [
            None if sensor is None else wrist_cut(chain.model, sensor) for sensor in chain.sensors
        ]
        self._slip = np.where(sliding(self.model), _SLIDE, _SLIP)
        self.data = self.model.createData()
        self.q = np.zeros(chain.nq)
        self.v = np.zeros(chain.nq)
        # of an object that no arm leads
        self._X = pin.SE3.Identity()
        self._V = np.zeros(6)
        self._tau = np.zeros(chain.n_a)
        self._set_up: tuple[bytes, Any] = b"", None
        self._solved: tuple[bytes, Any] = b"", None

    def reset(self, q: Array) -> None:
        """Start at rest at q, moved onto loops and contacts."""
        self.time = 0.0
        self.faces.reset()
        q = as_array("q", q, (self.chain.nq,))
        self._project(q, object_pose(self.chain, q), np.zeros(self.chain.nq), np.zeros(6))
        self._tau = np.zeros(self.chain.n_a)

    def hold(self, tau: Array) -> None:
        """Apply torques from now on; time stands still."""
        self._tau = as_array("tau", tau, (self.chain.n_a,))

    def measure(self) -> Measurement:
        """Encoders, and the wrist wrenches under the torques applied last."""
        wrenches = self._now()[0].wrenches.copy()
        return Measurement(self.q.copy(), self.v.copy(), wrenches, self.faces.touched())

    def truth(self) -> Truth:
        """Contact forces under the torques applied last; rigid contacts are always closed."""
        solution, (X, V) = self._now()
        closed = np.ones(len(self.contacts), dtype=bool)
        return Truth(solution.alpha, closed, X, V, tuple(self.faces.poses()))

    def log(self) -> Watched:
        """A log of the truth."""
        return Watched(self, self.contacts)

    def _now(self) -> tuple[Solution, tuple[pin.SE3, Array]]:
        """The solution under the torques applied last, pose and twist of the object."""
        key = self._state() + self._tau.tobytes()
        if self._solved[0] != key:  # `measure` and `truth` of one instant share it
            solution = self._solve(self._tau, with_wrenches=True)
            now = self._equations()
            self._solved = key, (solution, (now.X, now.V))
        return self._solved[1]

    def poses(self) -> Array:
        """See `Judge.poses`."""
        pin.computeAllTerms(self.model, self.data, self.q, self.v)
        tips = self.chain.tip_poses(self.data)
        return np.array([X.homogeneous for X in (self._object()[0], *tips)])

    def command(self, tau: Array, duration: float) -> None:
        """Integrate with the trapezoidal rule in positions, then project onto the constraints."""
        require_duration(duration)
        self.hold(tau)
        for _ in range(max(1, round(duration / self.dt))):
            solution = self._solve(self._tau, ahead=self.dt)
            v = self.v + solution.qdd * self.dt
            q = self.q + 0.5 * (self.v + v) * self.dt
            if not (np.isfinite(q).all() and np.abs(v).max() < 1e3):
                raise PlantError(f"rigid plant diverged at t = {self.time:.4f} s, v = {v}")
            self.time += self.dt
            faces = self.faces
            rates = faces.rates + solution.sdd * self.dt
            faces.s += 0.5 * (faces.rates + rates) * self.dt
            faces.rates = rates
            faces.drive(self.time)
            a = solution.a_O.copy()
            a[:3] += cross(self._V[3:], self._V[:3])  # classical
            V = self._V + a * self.dt
            X = moved(self._X, 0.5 * (self._V + V) * self.dt)
            self._project(q, X, v, V)

    def stop(self, reason: str = "") -> None:
        """Nothing to do."""

    def accelerations(self, tau: Array) -> tuple[Array, Array, Array]:
        """(q̈ (n,), spatial object acceleration (6,) at O, α (r,)) under torques now."""
        solution = self._solve(as_array("tau", tau, (self.chain.n_a,)))
        return solution.qdd, solution.a_O, solution.alpha

    # --- dynamics --------------------------------------------------------------------------------

    def _solve(self, tau: Array, with_wrenches: bool = False, ahead: float = 0.0) -> Solution:
        """All joints and free bodies at once, one multiplier for each row of loops and contacts.

        Joint friction D v + F tanh(v / v₀) is that of the velocities `ahead` (s) of now, to first
        order.
        """
        chain = self.chain
        n = chain.nq
        now = self._equations()
        force = now.force.copy()
        force[chain.actuated] += tau
        M = now.M.copy()
        M[:n, :n] += ahead * np.diag(now.slope)
        unheld = np.linalg.solve(M, force)
        inverse, multipliers = inverse_rows(chain, now.A, M)
        short = now.right - now.A @ unheld
        x = unheld + inverse @ short
        lam = multipliers @ short  # M x = force + Aᵀλ
        size = now.first.shape[1]
        sdd = self.faces.second.copy()
        sdd[self.faces.free] = x[size:]
        *shares, alpha = np.split(lam, now.ends[1:])
        qdd = x[:n]
        wrenches = np.zeros((len(self._tips), 6))
        if with_wrenches:
            loops = [passed @ share for passed, share in zip(now.passed, shares, strict=True)]
            wrenches = self._wrist(qdd, loops, now.N @ alpha, now)
        return Solution(qdd, sdd, now.first @ x[:size] + now.gamma_O, alpha, wrenches)

    def _state(self) -> bytes:
        """What the equations follow from."""
        faces = self.faces
        free = (self._V, self._X.homogeneous, faces.s, faces.rates, faces.second)
        return np.concatenate((self.q, self.v, *free), axis=None).tobytes()

    def _equations(self) -> Equations:
        """The equations now; `measure`, `truth` and `command` of one instant share them."""
        state = self._state()
        if self._set_up[0] != state:
            self._set_up = state, self._work_out()
        return self._set_up[1]

    def _work_out(self) -> Equations:
        chain = self.chain
        model = self.model
        faces = self.faces
        pin.computeAllTerms(model, self.data, self.q, self.v)
        pin.forwardKinematics(model, self.data, self.q, self.v, 0.0 * self.v)
        X, V = self._object()
        O = X.translation  # noqa: E741
        parts = faces.parts(self.contacts, X, V)
        N, n_gamma = stacked(parts)
        J = self._jacobian(X)
        tips = chain.tip_poses(self.data)
        first = object_columns(chain, J)
        gamma_O = np.zeros(6) if chain.leader is None else self._drift(chain.leader, X)
        right = []
        normals = []
        for i, (s, grasp) in enumerate(zip(chain.slices, chain.grasps, strict=True)):
            if i == chain.leader:
                continue
            drift = self._drift(i, X) - gamma_O
            passed = np.eye(6)
            if not grasp.is_rigid:  # N is carried by the tip while the object slips
                passed = grasp.wrenches_at(tips[i], O)
                drift = passed.T @ (drift + cross_twist(J[:, s] @ self.v[s], V))
            right.append(drift)
            normals.append(passed)
        ends = np.cumsum([0, *map(len, right)])
        along, on_faces = faces.closing(parts, O)
        right.append(N.T @ gamma_O - n_gamma - on_faces)
        dry = np.array(model.upperDryFrictionLimit)
        share = np.tanh(self.v / self._slip)
        slope = model.damping + dry / self._slip * (1.0 - share**2)
        force = -self.data.nle - (model.damping * self.v + dry * share)
        M = np.array(self.data.M)
        if chain.leader is None:
            body = chain.reference.terms(X, V, model.gravity.linear)
            force = np.concatenate((force, -body.mu - body.p))
            M = block_diagonal([M, body.Lambda])
        A = constraint_rows(chain, O, N, self.data)
        bodies, joints = faces.free
        if len(bodies):
            own = along[:, bodies, joints]
            A = np.hstack((A, np.vstack((np.zeros((ends[-1], len(bodies))), own))))
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
            right=np.concatenate(right),
            ends=ends,
            passed=normals,
            first=first,
            gamma_O=gamma_O,
            joints=[self.data.oMi[tip.parentJoint].copy() for tip in self._tips],
        )

    def _wrist(self, qdd: Array, loops: list[Array], f_c: Array, now: Equations) -> Array:
        """Wrist wrenches in sensor axes: what each arm's joint transmits, minus its own side.

        Newton–Euler from the base: the wrench through the sensor's joint, less what the links
        between that joint and the sensor need.

        Args:
            qdd: (n,) accelerations. loops: (6,) wrench of each arm but the leader on the object.
            f_c: (6,) of the object on its contacts. now: the equations.
        """
        leader = self.chain.leader
        if leader is not None:  # it bears the rest; the object's inertia rides on its joint
            loops.insert(leader, f_c - sum(loops, np.zeros(6)))
        external = [pin.Force.Zero() for _ in range(self.model.njoints)]
        for tip, wrench, X in zip(self._tips, loops, now.joints, strict=True):
            at_origin = pin.Force(carry_wrench(-wrench, now.X.translation, np.zeros(3)))
            external[tip.parentJoint] = X.actInv(at_origin)
        pin.rnea(self.model, self.data, self.q, self.v, qdd, external)
        return np.array(
            [np.zeros(6) if cut is None else cut.reading(self.data) for cut in self._sensors]
        )

    def _object(self) -> tuple[pin.SE3, Array]:
        """Pose of the object and its twist (6,) at O, world axes."""
        leader = self.chain.leader
        if leader is None:
            return self._X, self._V
        X = self.chain.object_pose(self.data)
        s = self.chain.slices[leader]
        return X, self._jacobian(X)[:, s] @ self.v[s]

    def _jacobian(self, X: pin.SE3) -> Array:
        return columns_at(self.data.J, X.translation)

    def _drift(self, i: int, X: pin.SE3) -> Array:
        """Spatial drift at O, from Pinocchio's own acceleration pass at q̈ = 0."""
        a = pin.getFrameAcceleration(self.model, self.data, self.chain.tips[i], pin.WORLD).vector
        return carry_twist(a, np.zeros(3), X.translation)

    def _project(self, q: Array, X: pin.SE3, v: Array, V: Array) -> None:
        """Take positions, then velocities, of joints and object, put onto the constraints."""
        chain = self.chain
        self.q, self._X = closed(chain, q, X, partial(self.faces.gaps, self.contacts))
        pin.computeAllTerms(chain.model, chain.data, self.q, v)
        X = self._X if chain.leader is None else chain.object_pose()
        parts = self.faces.parts(self.contacts, X, np.zeros(6))
        A = constraint_rows(chain, X.translation, stacked(parts)[0])
        along = self.faces.closing(parts, X.translation)[0]
        b = np.zeros(len(A))
        b[len(A) - len(along) :] = -np.tensordot(along, self.faces.rates)
        x = np.concatenate((v, V))[: A.shape[1]]
        inverse, _ = inverse_rows(chain, A, inertia_of(chain, X))
        for _ in range(2):
            x = x - inverse @ (A @ x - b)
        self.v = x[: chain.nq]
        self._V = x[chain.nq :] if chain.leader is None else V
