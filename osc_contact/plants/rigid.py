"""The exact plant: Pinocchio joint-space dynamics, bilateral rigid contacts, loops by multipliers.

It shares no formula with the closed chain of the controller: no S, no Λ_S, but all joints of all
arms at once with one multiplier per constraint row. Positions and velocities are projected onto
the constraints after each step, so NᵀV_rel = 0 to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.assembly import close, constraint_rows, inverse_rows
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import ModelError, PlantError
from osc_contact.interface import Measurement
from osc_contact.plants.faces import Rail, touched
from osc_contact.plants.plant import Truth, Watched
from osc_contact.spatial import Array, as_array, carry_twist, carry_wrench, cross_wrench

__all__ = ["RigidPlant"]


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
            rails: how each body of the environment slides; default: all are fixed.
            on: the body of each contact; default: each has its own.

        Raises:
            ModelError: the chain holds no object.
        """
        if chain.payload is None:
            raise ModelError("the rigid plant needs an object; give the chain a payload")
        self.chain = chain
        self.contacts = tuple(contacts)
        self.on = tuple(range(len(self.contacts)) if on is None else on)
        bodies = max(self.on, default=-1) + 1
        self.rails: list[Rail | None] = list(rails or [None] * bodies)
        self.dt = step
        self.time = 0.0
        self._travel, self._speed = self._at_start(), np.zeros(len(self.rails))
        self.model, self._tips = _with_object(chain)
        self._sensors = [
            None if arm.wrist_sensor is None
            else _sensor(chain.model, f"{arm.name}/{arm.wrist_sensor}")
            for arm in chain.arms
        ]  # fmt: skip
        self.data = self.model.createData()
        self.q = np.zeros(chain.nq)
        self.v = np.zeros(chain.nq)
        self._tau = np.zeros(chain.n_a)
        self._solved: tuple[bytes, Any] = b"", None

    def reset(self, q: Array) -> None:
        """Start at rest at q, moved onto loops and contacts."""
        self.time = 0.0
        self._travel, self._speed = self._at_start(), np.zeros(len(self.rails))
        self._drive()
        self.q = close(self.chain, as_array("q", q, (self.chain.nq,)), self._gaps)
        self.v = self._on_constraints(np.zeros(self.chain.nq))
        self._tau = np.zeros(self.chain.n_a)

    def hold(self, tau: Array) -> None:
        """Apply torques from now on; time stands still."""
        self._tau = as_array("tau", tau, (self.chain.n_a,))

    def measure(self) -> Measurement:
        """Encoders, and the wrist wrenches under the torques applied last."""
        wrenches = self._now()[0].wrenches.copy()
        seen = touched(self.rails, self.on, self._travel, self._speed, self._driven_acceleration())
        return Measurement(self.q.copy(), self.v.copy(), wrenches, seen)

    def truth(self) -> Truth:
        """Contact forces under the torques applied last; rigid contacts are always closed."""
        solution, (X, V) = self._now()
        faces = tuple(self._face(i)[0] for i in range(len(self.contacts)))
        return Truth(solution.alpha, np.ones(len(self.contacts), dtype=bool), X, V, faces)

    def log(self, capacity: int) -> Watched:
        """A log of the truth of up to `capacity` instants."""
        return Watched(self, self.contacts)

    def _now(self) -> tuple[_Solution, tuple[pin.SE3, Array]]:
        """The solution under the torques applied last, pose and twist of the object."""
        state = (self.q, self.v, self._tau, self._travel, self._speed, np.array([self.time]))
        key = np.concatenate(state).tobytes()
        if self._solved[0] != key:  # `measure` and `truth` of one instant share it
            found = self._solve(self._tau, with_wrenches=True)
            self._solved = key, (found, self._object())
        return self._solved[1]

    def step(self, tau: Array, duration: float) -> None:
        """Integrate with the trapezoidal rule in positions, then project onto the constraints."""
        self.hold(tau)
        for _ in range(max(1, round(duration / self.dt))):
            solution = self._solve(self._tau)
            v = self.v + solution.qdd * self.dt
            q = self.q + 0.5 * (self.v + v) * self.dt
            if not (np.isfinite(q).all() and np.abs(v).max() < 1e3):
                raise PlantError(f"rigid plant diverged at t = {self.time:.4f} s, v = {v}")
            self.time += self.dt
            speed = self._speed + solution.sdd * self.dt
            self._travel = self._travel + 0.5 * (self._speed + speed) * self.dt
            self._speed = speed
            self._drive()
            self.q = close(self.chain, q, self._gaps)
            self.v = self._on_constraints(v)

    def accelerations(self, tau: Array) -> tuple[Array, Array, Array]:
        """(q̈ (n,), spatial object acceleration (6,) at O, α (r,)) under torques now."""
        solution = self._solve(as_array("tau", tau, (self.chain.n_a,)))
        X, _ = self._object()
        s, J = self.chain.slices[0], self._jacobian(0, X)
        return solution.qdd, J[:, s] @ solution.qdd[s] + self._drift(0, X), solution.alpha

    # --- faces -----------------------------------------------------------------------------------

    def _at_start(self) -> Array:
        """(bodies,) travel at t = 0."""
        return np.array(
            [0.0 if r is None or r.motion is None else r.motion(0.0)[0] for r in self.rails]
        )

    def _drive(self) -> None:
        """Put the driven faces where they are to be now."""
        for i, rail in enumerate(self.rails):
            if rail is not None and rail.motion is not None:
                self._travel[i], self._speed[i], _ = rail.motion(self.time)

    def _driven_acceleration(self) -> Array:
        return np.array(
            [0.0 if r is None or r.motion is None else r.motion(self.time)[2] for r in self.rails]
        )

    def _face(self, i: int) -> tuple[pin.SE3, Array]:
        """Pose and twist of the body at contact i."""
        body = self.on[i]
        rail = self.rails[body]
        X, V = pin.SE3.Identity(), np.zeros(6)
        if rail is not None:
            X.translation = rail.direction * self._travel[body]
            V[:3] = rail.direction * self._speed[body]
        return X, V

    def _along_rails(self, parts: list[Contact]) -> Array:
        """(r, bodies) Nᵀ[u; 0]: how fast each gap closes as the body comes along its rail."""
        out = np.zeros((sum(c.r for c in parts), len(self.rails)))
        row = 0
        for part, body in zip(parts, self.on, strict=True):
            rail = self.rails[body]
            if rail is not None:
                out[row : row + part.r, body] = part.N[:3].T @ rail.direction
            row += part.r
        return out

    # --- dynamics --------------------------------------------------------------------------------

    def _solve(self, tau: Array, with_wrenches: bool = False) -> _Solution:
        """All joints and carts at once, one multiplier for each row of loops and contacts."""
        chain, n, k = self.chain, self.chain.nq, 6 * (len(self._tips) - 1)
        pin.computeAllTerms(self.model, self.data, self.q, self.v)
        X, V = self._object()
        parts = self._parts(X, V)
        N, n_gamma = _stacked(parts)
        pin.forwardKinematics(self.model, self.data, self.q, self.v, np.zeros(n))
        gamma = [self._drift(i, X) for i in range(len(self._tips))]
        first = np.zeros((6, n))
        first[:, chain.slices[0]] = self._jacobian(0, X)[:, chain.slices[0]]
        rows, right = [], []
        for i, s in enumerate(chain.slices[1:], start=1):
            loop = first.copy()
            loop[:, s] -= self._jacobian(i, X)[:, s]
            rows.append(loop)
            right.append(gamma[i] - gamma[0])
        along, driven = self._along_rails(parts), self._driven_acceleration()
        rows.append(N.T @ first)
        right.append(n_gamma - N.T @ gamma[0] + along @ driven)
        force = -self.data.nle
        force[chain.actuated] += tau
        on_rails = {i: r for i, r in enumerate(self.rails) if r is not None and r.motion is None}
        carts = list(on_rails)
        A, M = np.vstack(rows), np.array(self.data.M)
        if carts:
            A = np.hstack((A, np.vstack((np.zeros((k, len(carts))), -along[:, carts]))))
            masses = np.diag([rail.mass for rail in on_rails.values()])
            M = np.block([[M, np.zeros((n, len(carts)))], [np.zeros((len(carts), n)), masses]])
            force = np.concatenate((force, [self._on_cart(i, r) for i, r in on_rails.items()]))
        b = np.concatenate(right)
        free = np.linalg.solve(M, force)
        inverse, multipliers = inverse_rows(A, M, len(rows) - 1)
        x = free + inverse @ (b - A @ free)
        lam = multipliers @ (b - A @ free)  # M x = force + Aᵀλ
        qdd, sdd = x[:n], driven.copy()
        sdd[carts] = x[n:]
        alpha = -lam[k:]
        wrenches = np.zeros((len(self._tips), 6))
        if with_wrenches:
            a_O = first @ qdd + gamma[0]
            wrenches = self._wrist(qdd, lam[:k].reshape(-1, 6), N @ alpha, a_O, X, V)
        return _Solution(qdd, sdd, alpha, wrenches)

    def _on_cart(self, i: int, rail: Rail) -> float:
        """Force along the rail besides the contact's (N)."""
        weight = rail.mass * float(rail.direction @ self.model.gravity.linear)
        spring = rail.stiffness * self._travel[i] + rail.damping * self._speed[i]
        return float(weight + rail.preload - spring)

    def _wrist(
        self, qdd: Array, loops: Array, f_c: Array, a_O: Array, X: pin.SE3, V: Array
    ) -> Array:
        """Wrist wrenches in sensor axes: what each arm's joint transmits, minus its own side.

        Newton–Euler from the base: the wrench through the sensor's joint, less what the links
        between that joint and the sensor need.
        """
        chain = self.chain
        payload = chain.payload
        assert payload is not None  # the constructor refused otherwise
        body = payload.terms(X, V, self.model.gravity.linear)
        # the multiplier of a loop row is what that arm does to the object; the first bears the rest
        hold = body.Lambda @ a_O + body.mu + body.p + f_c
        on_object = [hold - loops.sum(axis=0), *loops]
        external = [pin.Force.Zero() for _ in range(self.model.njoints)]
        for i, (tip, wrench) in enumerate(zip(self._tips, on_object, strict=True)):
            joint = self.model.frames[tip].parentJoint
            at_origin = carry_wrench(-wrench, X.translation, np.zeros(3))
            if i == 0:  # the object's inertia rides on this joint: add only what differs
                at_origin = carry_wrench(hold - wrench - f_c, X.translation, np.zeros(3))
            external[joint] = self.data.oMi[joint].actInv(pin.Force(at_origin))
        pin.rnea(self.model, self.data, self.q, self.v, qdd, external)
        readings = np.zeros((len(self._tips), 6))
        for i, sensor in enumerate(self._sensors):
            if sensor is not None:
                readings[i] = self._through(sensor)
        return readings

    def _through(self, sensor: _Sensor) -> Array:
        v, a = self.data.v[sensor.joint].vector, self.data.a_gf[sensor.joint].vector
        own = sensor.inboard @ a + cross_wrench(v, sensor.inboard @ v)
        wrench = self.data.f[sensor.joint].vector - own
        return np.asarray(sensor.placement.actInv(pin.Force(wrench)).vector)

    def _object(self) -> tuple[pin.SE3, Array]:
        X = self._pose(0)
        s = self.chain.slices[0]
        return X, self._jacobian(0, X)[:, s] @ self.v[s]

    def _pose(self, i: int) -> pin.SE3:
        frame = self.model.frames[self._tips[i]]
        return self.data.oMi[frame.parentJoint] * frame.placement * self.chain.grasps[i]

    def _jacobian(self, i: int, X: pin.SE3) -> Array:
        J = pin.getFrameJacobian(self.model, self.data, self._tips[i], pin.ReferenceFrame.WORLD)
        return carry_twist(J, np.zeros(3), X.translation)

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
        return np.concatenate([np.zeros(0), *gaps]), _stacked(self._parts(X, np.zeros(6)))[0]

    def _on_constraints(self, v: Array) -> Array:
        pin.computeAllTerms(self.chain.model, self.chain.data, self.q, v)
        X = self.chain.object_poses()[0]
        parts = self._parts(X, np.zeros(6))
        A = constraint_rows(self.chain, X.translation, _stacked(parts)[0])
        along = self._along_rails(parts)
        b = np.zeros(len(A))
        b[len(A) - len(along) :] = -along @ self._speed
        for _ in range(2):
            v = v - inverse_rows(A, self.chain.data.M, len(self._tips) - 1)[0] @ (A @ v - b)
        return v


@dataclass(frozen=True)
class _Solution:
    """q̈ (n,), accelerations along the rails (bodies,), α (r,), wrist wrenches (arms, 6)."""

    qdd: Array
    sdd: Array
    alpha: Array
    wrenches: Array


def _stacked(parts: list[Contact]) -> tuple[Array, Array]:
    if not parts:
        return np.zeros((6, 0)), np.zeros(0)
    return np.hstack([c.N for c in parts]), np.concatenate([c.n_gamma for c in parts])


def _with_object(chain: ClosedChain) -> tuple[pin.Model, list[int]]:
    """The merged model with the object's inertia riding on the first arm's last joint."""
    model = chain.model.copy()
    tips = [model.getFrameId(f"{arm.name}/{arm.tip}") for arm in chain.arms]
    frame = model.frames[tips[0]]
    assert chain.payload is not None
    model.appendBodyToJoint(
        frame.parentJoint, chain.payload.inertia, frame.placement * chain.grasps[0]
    )
    return model, tips


@dataclass(frozen=True)
class _Sensor:
    """A cut through a link: its joint, where it sits, what stays on the arm's side."""

    joint: int
    placement: pin.SE3
    inboard: Array  # (6, 6) at the joint


def _sensor(model: pin.Model, name: str) -> _Sensor:
    cut = model.getFrameId(name)
    frame = model.frames[cut]
    above = frame.parentFrame
    beyond = {above if model.frames[above].type == pin.FrameType.FIXED_JOINT else cut}
    inboard: Array = model.inertias[frame.parentJoint].matrix()
    if model.frames[above].type == pin.FrameType.JOINT:  # cut at the joint itself
        return _Sensor(frame.parentJoint, frame.placement, np.zeros((6, 6)))
    for f, other in enumerate(model.frames):
        if other.parentFrame in beyond:
            beyond.add(f)
        if f in beyond and other.parentJoint == frame.parentJoint:
            inboard = inboard - other.placement.act(other.inertia).matrix()
    return _Sensor(frame.parentJoint, frame.placement, inboard)
