"""The exact plant: joint-space dynamics, bilateral rigid contacts, loops by multipliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.assembly import (
    closed,
    constraint_rows,
    inertia_of,
    inverse_rows,
    object_columns,
    object_pose,
    row_groups,
)
from osc_contact.dynamics.chain_state import ObjectTerms
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.grasp import moved
from osc_contact.errors import ModelError, PlantError
from osc_contact.interface import Measurement
from osc_contact.plants.faces import (
    Rail,
    along_rails,
    drift_of_faces,
    driven_accelerations,
    force_on_rail,
    free_rails,
    poses,
    touched,
)
from osc_contact.plants.judge import Truth, Watched, require_duration
from osc_contact.robots import frame_id
from osc_contact.spatial import (
    Array,
    as_array,
    carry_twist,
    carry_wrench,
    cross,
    cross_twist,
    cross_wrench,
)

# --- Friction of the joints: viscous, and dry, smooth near rest -----------------------------------

#: speeds by which dry friction is developed (rad/s, m/s)
_SLIP = 1e-3
_SLIDE = 1e-4


@dataclass(frozen=True)
class JointLosses:
    """D v + F tanh(v / v_0) against each joint's motion.

    Attributes:
        damping: (n,) D (N m s/rad; N s/m). friction: (n,) F (N m; N). slip: (n,) v_0 (rad/s; m/s).
    """

    damping: Array
    friction: Array
    slip: Array

    @classmethod
    def of(cls, model: pin.Model) -> JointLosses:
        """The losses of the model."""
        slides = [j.shortname().startswith("JointModelP") for j in list(model.joints)[1:]]
        slip = np.where(slides, _SLIDE, _SLIP)
        return cls(np.array(model.damping), np.array(model.upperDryFrictionLimit), slip)

    def torque(self, v: Array) -> Array:
        """(n,) at joint velocities v (n,)."""
        return np.asarray(self.damping * v + self.friction * np.tanh(v / self.slip))

    def slope(self, v: Array) -> Array:
        """(n,) its derivative there, by which a step looks ahead."""
        rest = 1.0 - np.tanh(v / self.slip) ** 2
        return np.asarray(self.damping + self.friction / self.slip * rest)


# --- Where a wrist sensor cuts the arm, and what it reads there -----------------------------------


@dataclass(frozen=True)
class WristCut:
    """A cut through a link: its joint, where it sits, what stays on the arm's side."""

    joint: int
    placement: pin.SE3
    inboard: Array  # (6, 6) at the joint

    def reading(self, data: pin.Data) -> Array:
        """(6,) wrench through it, in its axes, after `pin.rnea`: the joint's, less its own side."""
        v = data.v[self.joint].vector
        a = data.a_gf[self.joint].vector
        own = self.inboard @ a + cross_wrench(v, self.inboard @ v)
        wrench = data.f[self.joint].vector - own
        return np.asarray(self.placement.actInv(pin.Force(wrench)).vector)


def wrist_cut(model: pin.Model, name: str) -> WristCut:
    """The cut at the frame `name`."""
    cut = frame_id(model, name)
    frame = model.frames[cut]
    above = frame.parentFrame
    beyond = {above if model.frames[above].type == pin.FrameType.FIXED_JOINT else cut}
    inboard: Array = model.inertias[frame.parentJoint].matrix()
    if model.frames[above].type == pin.FrameType.JOINT:  # cut at the joint itself
        return WristCut(frame.parentJoint, frame.placement, np.zeros((6, 6)))
    for f, other in enumerate(model.frames):
        if other.parentFrame in beyond:
            beyond.add(f)
        if f in beyond and other.parentJoint == frame.parentJoint:
            inboard = inboard - other.placement.act(other.inertia).matrix()
    return WristCut(frame.parentJoint, frame.placement, inboard)


# --- Its model, its equations side by side, and their solution ------------------------------------


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
        rails: Sequence[Rail | None] | None = None,
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
        self.on = tuple(range(len(self.contacts)) if on is None else on)
        self.rails: list[Rail | None] = list(rails or [None] * (max(self.on, default=-1) + 1))
        self.dt = step
        self.time = 0.0
        #: travel and angle of every body (bodies, 2), and their rates
        self._s: Array = np.zeros((len(self.rails), 2))
        self._rates: Array = np.zeros((len(self.rails), 2))
        self.model, self._tips = with_object(chain)
        self._sensors = [
            None
            if arm.wrist_sensor is None
            else wrist_cut(chain.model, f"{arm.name}/{arm.wrist_sensor}")
            for arm in chain.arms
        ]
        self._losses = JointLosses.of(self.model)
        self.data = self.model.createData()
        self.q = np.zeros(chain.nq)
        self.v = np.zeros(chain.nq)
        # of an object that no arm leads
        self._X = pin.SE3.Identity()
        self._V = np.zeros(6)
        self._tau = np.zeros(chain.n_a)
        self._solved: tuple[bytes, Any] = b"", None

    def reset(self, q: Array) -> None:
        """Start at rest at q, moved onto loops and contacts."""
        self.time = 0.0
        self._s, self._rates = np.zeros_like(self._s), np.zeros_like(self._s)
        self._drive()
        q = as_array("q", q, (self.chain.nq,))
        self.q, self._X = closed(self.chain, q, object_pose(self.chain, q), self._gaps)
        self.v, self._V = self._on_constraints(np.zeros(self.chain.nq), np.zeros(6))
        self._tau = np.zeros(self.chain.n_a)

    def hold(self, tau: Array) -> None:
        """Apply torques from now on; time stands still."""
        self._tau = as_array("tau", tau, (self.chain.n_a,))

    def measure(self) -> Measurement:
        """Encoders, and the wrist wrenches under the torques applied last."""
        wrenches = self._now()[0].wrenches.copy()
        driven = driven_accelerations(self.rails, self.time)
        seen = touched(self.rails, self.on, self._s, self._rates, driven)
        return Measurement(self.q.copy(), self.v.copy(), wrenches, seen)

    def truth(self) -> Truth:
        """Contact forces under the torques applied last; rigid contacts are always closed."""
        solution, (X, V) = self._now()
        bodies = poses(self.rails, self._s)
        faces = tuple(bodies[body] for body in self.on)
        return Truth(solution.alpha, np.ones(len(self.contacts), dtype=bool), X, V, faces)

    def log(self) -> Watched:
        """A log of the truth."""
        return Watched(self, self.contacts)

    def _now(self) -> tuple[Solution, tuple[pin.SE3, Array]]:
        """The solution under the torques applied last, pose and twist of the object."""
        state = (
            self.q,
            self.v,
            self._tau,
            self._s.ravel(),
            self._rates.ravel(),
            self._V,
            self._X.homogeneous.ravel(),
            np.array([self.time]),
        )
        key = np.concatenate(state).tobytes()
        if self._solved[0] != key:  # `measure` and `truth` of one instant share it
            solution = self._solve(self._tau, with_wrenches=True)
            self._solved = key, (solution, self._object())
        return self._solved[1]

    def poses(self) -> Array:
        """See `Judge.poses`."""
        pin.computeAllTerms(self.model, self.data, self.q, self.v)
        tips = [self._tip(i) for i in range(len(self._tips))]
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
            rates = self._rates + solution.sdd * self.dt
            self._s = self._s + 0.5 * (self._rates + rates) * self.dt
            self._rates = rates
            self._drive()
            turning = cross(self._V[3:], self._V[:3])  # from spatial to classical
            V = self._V + (solution.a_O + np.concatenate((turning, np.zeros(3)))) * self.dt
            X = moved(self._X, 0.5 * (self._V + V) * self.dt)
            self.q, self._X = closed(self.chain, q, X, self._gaps)
            self.v, self._V = self._on_constraints(v, V)

    def stop(self, reason: str = "") -> None:
        """Nothing to do."""

    def accelerations(self, tau: Array) -> tuple[Array, Array, Array]:
        """(q̈ (n,), spatial object acceleration (6,) at O, α (r,)) under torques now."""
        solution = self._solve(as_array("tau", tau, (self.chain.n_a,)))
        return solution.qdd, solution.a_O, solution.alpha

    # --- faces -----------------------------------------------------------------------------------

    def _drive(self) -> None:
        """Put the driven faces where they are to be now."""
        for i, rail in enumerate(self.rails):
            if rail is not None and rail.motion is not None:
                self._s[i], self._rates[i], _ = rail.motion(self.time)

    def _face(self, i: int) -> tuple[pin.SE3, Array]:
        """Pose and twist of the body at contact i."""
        body = self.on[i]
        rail = self.rails[body]
        if rail is None:
            return pin.SE3.Identity(), np.zeros(6)
        X = rail.pose(self._s[body])
        return X, rail.twist(self._s[body], self._rates[body], X.translation)

    # --- dynamics --------------------------------------------------------------------------------

    def _solve(self, tau: Array, with_wrenches: bool = False, ahead: float = 0.0) -> Solution:
        """All joints and free bodies at once, one multiplier for each row of loops and contacts.

        Joint friction is that of the velocities `ahead` (s) of now, to first order.
        """
        chain = self.chain
        n = self.chain.nq
        pin.computeAllTerms(self.model, self.data, self.q, self.v)
        X, V = self._object()
        parts = self._parts(X, V)
        N, n_gamma = stacked(parts)
        pin.forwardKinematics(self.model, self.data, self.q, self.v, np.zeros(n))
        J = self._jacobian(X)
        first = object_columns(chain, J)
        gamma_O = np.zeros(6) if chain.leader is None else self._drift(chain.leader, X)
        rows = []
        right = []
        normals = []
        for i, (s, grasp) in enumerate(zip(chain.slices, chain.grasps, strict=True)):
            if i == chain.leader:
                continue
            loop = first.copy()
            drift = self._drift(i, X) - gamma_O
            passed = np.eye(6)
            loop[:, s] -= J[:, s]
            if not grasp.is_rigid:  # N is carried by the tip while the object slips
                passed = grasp.wrenches_at(self._tip(i), X.translation)
                loop = passed.T @ loop
                drift = passed.T @ (drift + cross_twist(J[:, s] @ self.v[s], V))
            rows.append(loop)
            right.append(drift)
            normals.append(passed)
        along = along_rails(self.rails, self.on, self._s, parts, X.translation)
        driven = driven_accelerations(self.rails, self.time)
        on_faces = drift_of_faces(
            self.rails, self.on, self._s, self._rates, parts, X.translation
        ) + np.tensordot(along, driven)
        k = sum(map(len, right))
        rows.append(N.T @ first)
        right.append(n_gamma - N.T @ gamma_O + on_faces)
        force = -self.data.nle - self._losses.torque(self.v)
        force[chain.actuated] += tau
        M = np.array(self.data.M) + ahead * np.diag(self._losses.slope(self.v))
        if chain.leader is None:
            body = self._body(X, V)
            force = np.concatenate((force, -body.mu - body.p))
            M = beside(M, body.Lambda)
        free = free_rails(self.rails)
        at = np.array(list(free), dtype=int), np.array([r.joints[0] for r in free.values()], int)
        A = np.vstack(rows)
        size = len(M)
        if free:
            A = np.hstack((A, np.vstack((np.zeros((k, len(free))), -along[:, *at]))))
            M = beside(M, np.diag([rail.inertia for rail in free.values()]))
            g = self.model.gravity.linear
            pulls = [force_on_rail(r, self._s[i], self._rates[i], g) for i, r in free.items()]
            force = np.concatenate((force, pulls))
        b = np.concatenate(right)
        unheld = np.linalg.solve(M, force)
        inverse, multipliers = inverse_rows(A, M, row_groups(chain))
        x = unheld + inverse @ (b - A @ unheld)
        lam = multipliers @ (b - A @ unheld)  # M x = force + Aᵀλ
        qdd = x[:n]
        sdd = driven.copy()
        sdd[at] = x[size:]
        alpha = -lam[k:]
        a_O = first @ x[:size] + gamma_O
        wrenches = np.zeros((len(self._tips), 6))
        if with_wrenches:
            shares = np.split(lam[:k], np.cumsum([N_i.shape[1] for N_i in normals]))  # on object
            loops = [passed @ share for passed, share in zip(normals, shares, strict=False)]
            wrenches = self._wrist(qdd, loops, N @ alpha, a_O, X, V)
        return Solution(qdd, sdd, a_O, alpha, wrenches)

    def _body(self, X: pin.SE3, V: Array) -> ObjectTerms:
        assert self.chain.payload is not None  # the constructor refused otherwise
        return self.chain.payload.terms(X, V, self.model.gravity.linear)

    def _wrist(
        self, qdd: Array, loops: list[Array], f_c: Array, a_O: Array, X: pin.SE3, V: Array
    ) -> Array:
        """Wrist wrenches in sensor axes: what each arm's joint transmits, minus its own side.

        Newton–Euler from the base: the wrench through the sensor's joint, less what the links
        between that joint and the sensor need.
        """
        leader = self.chain.leader
        body = self._body(X, V)
        hold = body.Lambda @ a_O + body.mu + body.p + f_c
        if leader is not None:  # it bears the rest
            loops.insert(leader, hold - sum(loops, np.zeros(6)))
        external = [pin.Force.Zero() for _ in range(self.model.njoints)]
        for i, (tip, wrench) in enumerate(zip(self._tips, loops, strict=True)):
            joint = self.model.frames[tip].parentJoint
            at_origin = carry_wrench(-wrench, X.translation, np.zeros(3))
            if i == leader:  # the object's inertia rides on this joint: add only what differs
                at_origin = carry_wrench(hold - wrench - f_c, X.translation, np.zeros(3))
            external[joint] = self.data.oMi[joint].actInv(pin.Force(at_origin))
        pin.rnea(self.model, self.data, self.q, self.v, qdd, external)
        readings = np.zeros((len(self._tips), 6))
        for i, sensor in enumerate(self._sensors):
            if sensor is not None:
                readings[i] = sensor.reading(self.data)
        return readings

    def _object(self) -> tuple[pin.SE3, Array]:
        leader = self.chain.leader
        if leader is None:
            return self._X, self._V
        X = self._tip(leader) * self.chain.grasps[leader].X_TO
        s = self.chain.slices[leader]
        return X, self._jacobian(X)[:, s] @ self.v[s]

    def _tip(self, i: int) -> pin.SE3:
        frame = self.model.frames[self._tips[i]]
        return self.data.oMi[frame.parentJoint] * frame.placement

    def _jacobian(self, X: pin.SE3) -> Array:
        return carry_twist(self.data.J, np.zeros(3), X.translation)

    def _drift(self, i: int, X: pin.SE3) -> Array:
        """Spatial drift at O, from Pinocchio's own acceleration pass at q̈ = 0."""
        a = pin.getFrameAcceleration(
            self.model, self.data, self._tips[i], pin.ReferenceFrame.WORLD
        ).vector
        return carry_twist(a, np.zeros(3), X.translation)

    def _parts(self, X: pin.SE3, V: Array) -> list[Contact]:
        """N and n_γ of every contact with the object at X, V and the faces where they are."""
        faces = [self._face(i) for i in range(len(self.contacts))]
        return [pair.contact(X, V, *face) for pair, face in zip(self.contacts, faces, strict=True)]

    def _gaps(self, X: pin.SE3) -> tuple[Array, Array]:
        gaps = [pair.gaps(X, self._face(i)[0]) for i, pair in enumerate(self.contacts)]
        return np.concatenate([np.zeros(0), *gaps]), stacked(self._parts(X, np.zeros(6)))[0]

    def _on_constraints(self, v: Array, V: Array) -> tuple[Array, Array]:
        chain = self.chain
        n = self.chain.nq
        pin.computeAllTerms(chain.model, chain.data, self.q, v)
        X = self._X if chain.leader is None else chain.object_pose()
        parts = self._parts(X, np.zeros(6))
        A = constraint_rows(chain, X.translation, stacked(parts)[0])
        along = along_rails(self.rails, self.on, self._s, parts, X.translation)
        b = np.zeros(len(A))
        b[len(A) - len(along) :] = -np.tensordot(along, self._rates)
        x = np.concatenate((v, V))[: A.shape[1]]
        for _ in range(2):
            x = x - inverse_rows(A, inertia_of(chain, X), row_groups(chain))[0] @ (A @ x - b)
        return x[:n], x[n:] if chain.leader is None else V
