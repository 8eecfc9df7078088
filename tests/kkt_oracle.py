"""One KKT system of arms, held object and touched bodies, for any grasps and any contacts.

Unknown are the accelerations of every joint, of the object and of every body, and one multiplier
for each row of a grasp and of a contact. Pinocchio gives M and h, `grasp_oracle` the rows of the
grasps; a contact is what its gaps say, differentiated twice along the motion. No N, no n_γ, no
S, no Φ_e of the package takes part. Accelerations of the object are classical.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
from environment_scenes import KINDS as SCENES
from environment_scenes import Body, axis, on_joints
from grasp_oracle import solve
from grasp_rigs import Case
from numpy.linalg import norm, svd
from numpy.random import default_rng
from pair_kinds import KINDS as PAIRS
from pair_kinds import PLAIN, Coordinates, rate
from rigs import largest, shift

from osc_contact.dynamics.environment import Cart, Conveyor

LWA = pin.LOCAL_WORLD_ALIGNED
SIZE = 0.15  # of the pairs' geometry, as drawn with 1 m
STEP = 0.02  # of the differences (m or rad)


# Bodies -------------------------------------------------------------------------------------------


def cart(rng, at):
    """A mass on a rail from the world's origin, with spring and damper."""
    u = axis(rng)
    (mass, k, c, preload) = rng.uniform(1.0, 5.0, 4)
    joint = pin.JointModelPrismaticUnaligned(u)
    model, _, q, v = on_joints(rng, at, joint, inertia=pin.Inertia.FromSphere(mass, 0.1))
    body = Body(model, q, v, preload - k * q - c * v, "E")
    return body, Cart(2.0 * u, mass, k, c, preload)


BODIES = {name: made[0] for name, (made, _) in SCENES.items() if len(made) == 1}
BODIES["cart"] = cart


class Answering:
    """A body that answers as the maker of the scene says."""

    def __init__(self, answer):
        self.answer = answer

    def environment(self, X_WE, V_E, A_E, O):
        return self.answer(O)


@dataclass
class Touched:
    """A body of the environment, as the oracle and as the controller know it."""

    body: Body
    known: object
    name: str

    @classmethod
    def random(cls, name, rng, at):
        body, known = BODIES[name](rng, at)
        if body.prescribed is not None:
            known = Conveyor()
        return cls(body, Answering(known) if callable(known) else known, name)

    def __post_init__(self):
        self.X = self.pose(np.zeros(self.body.model.nv))

    def pose(self, step):
        """Pose of the touched link, the joints displaced by step (nv,)."""
        model = self.body.model
        data = self.body.model.createData()
        pin.framesForwardKinematics(model, data, pin.integrate(model, self.body.q, step))
        return data.oMf[self.body.id].copy()

    def acceleration(self, qdd, O):
        """(6,) spatial, at O, of the touched link."""
        b = self.body
        data = self.body.model.createData()
        pin.forwardKinematics(b.model, data, b.q, b.v, qdd)
        pin.updateFramePlacements(b.model, data)
        a = pin.getFrameAcceleration(b.model, data, b.id, LWA).vector
        a[:3] += np.cross(a[3:], O - self.X.translation)
        return a

    def seen(self):
        """(28,) X_WE, V_E, A_E: the acceleration is told where a drive makes it."""
        b = self.body
        data = self.body.model.createData()
        told = np.zeros(b.model.nv) if b.prescribed is None else b.prescribed
        pin.forwardKinematics(b.model, data, b.q, b.v, told)
        pin.updateFramePlacements(b.model, data)
        A = pin.getFrameClassicalAcceleration(b.model, data, b.id, LWA).vector
        A = A if b.prescribed is not None else np.zeros(6)
        return np.concatenate((self.X.homogeneous.ravel(), b.V, A))


# Contacts -----------------------------------------------------------------------------------------


def touch(name, rng, X_EO):
    """A pair of a kind whose geometry lies so that it is in contact with the object at X_EO."""
    while True:
        seed = rng.integers(2**32)
        pair, pose, r = PAIRS[name](default_rng(seed), PLAIN)
        if abs(getattr(pair, "pitch", 1.0)) > 0.3:  # a thread coarser than the differences
            break
    drawn = pin.SE3(X_EO.rotation, X_EO.translation / SIZE)
    there = Coordinates(
        X_E=pose(0.7 * rng.standard_normal(6 - r)) * drawn.inverse(), per_metre=SIZE
    )
    return PAIRS[name](default_rng(seed), there)[0]


def slopes(f, k):
    """(r, k) derivatives of f along k coordinates."""
    columns = [rate(lambda t, e=e: f(t * e), h=STEP) for e in np.eye(k)]
    return np.array(columns).T.reshape(len(f(np.zeros(k))), k)


def shifted(X, step):
    return pin.SE3(pin.exp3(step[3:]) @ X.rotation, X.translation + step[:3])


@dataclass
class Contact:
    """A pair between object and body (None: the world), and how its gaps change."""

    name: str
    pair: object
    on: Touched | None
    X_WO: pin.SE3

    def __post_init__(self):
        nv, X_WE = (0, None) if self.on is None else (self.on.body.model.nv, self.on.X)
        self.along_object = slopes(lambda s: self.pair.gaps(shifted(self.X_WO, s), X_WE), 6)
        self.along_body = slopes(lambda s: self.gaps(np.zeros(6), s), nv)

    def gaps(self, of_object, of_body):
        X_WE = None if self.on is None else self.on.pose(of_body)
        return self.pair.gaps(shifted(self.X_WO, of_object), X_WE)

    def speed(self):
        """(r,) rate of the gaps where the object rests."""
        return self.along_body @ (np.zeros(0) if self.on is None else self.on.body.v)

    def bend(self, V):
        """(r,) second derivative of the gaps while nothing accelerates."""
        v = np.zeros(0) if self.on is None else self.on.body.v
        speed = max(1.0, largest(V), largest(v))
        return speed**2 * rate(lambda t: self.gaps(t / speed * V, t / speed * v), 2, STEP)

    def slip(self, V):
        """Velocity of a vertex against its face, the arms from O and from E to it, and J of E."""
        X_WE = pin.SE3.Identity()
        J = np.zeros((6, 0))
        V_E = np.zeros(6)
        if self.on is not None:
            b = self.on.body
            data = self.on.body.model.createData()
            X_WE = self.on.X
            V_E = b.V
            J = pin.computeFrameJacobian(b.model, data, b.q, b.id, LWA)
        n = X_WE.rotation @ self.pair.normal / norm(self.pair.normal)
        arm = self.X_WO.rotation @ self.pair.vertex - self.pair.radius * n
        far = self.X_WO.translation + arm - X_WE.translation
        return V[:3] + np.cross(V[3:], arm) - V_E[:3] - np.cross(V_E[3:], far), arm, far, J

    def n_gamma(self, V):
        """(r,) Nᵀ of the spatial acceleration of the object less that of the body."""
        object_only = np.concatenate((np.cross(V[3:], V[:3]), np.zeros(3)))
        out = self.bend(V) + self.along_object @ object_only
        if self.on is None:
            return out
        drift = self.on.acceleration(np.zeros(len(self.on.body.v)), self.X_WO.translation)
        return out + self.along_object @ drift

    def friction(self, V, mu):
        """Coulomb's force on the object (6,) and on the joints of the body, for one newton."""
        slip, arm, far, J = self.slip(V)
        f = -mu * slip / norm(slip)
        return np.concatenate((f, np.cross(arm, f))), -J.T @ np.concatenate((f, np.cross(far, f)))


# Everything at once -------------------------------------------------------------------------------


@dataclass
class Answer:
    """Accelerations of joints and object, contact forces, wrench (6,) of each arm at O.

    a, a_object: classical and spatial; a_e: spatial ones of the touched bodies, at O.
    """

    qdd: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    loops: list
    a_object: np.ndarray
    a_e: list


@dataclass
class State:
    """Arms that hold an object which touches bodies, friction mu; at rest until `move`."""

    case: Case
    contacts: list
    mu: float = 0.0
    rest: State | None = None  # the same arms at rest

    def __post_init__(self):
        self.n = self.case.chain.nq
        self.bodies = list({id(c.on): c.on for c in self.contacts if c.on is not None}.values())
        self.N = np.vstack([np.zeros((0, 6)), *(c.along_object for c in self.contacts)])
        if self.rest is None:
            self._at(np.zeros(self.n), np.zeros(6))
        else:
            self.grasps = self.rest.grasps

    def _at(self, v, V):
        """Grasps, and the accelerations they permit: x₀ + Z y of all joints and the object."""
        self.v = v
        self.V = V
        self.system = self.case.system(v, V)
        rows = self.system.rows
        n = self.n
        self.grasps = np.vstack([np.zeros((0, n + 6)), *(row.coefficients for row in rows)])
        U, values, Vh = svd(self.grasps)
        rank = np.count_nonzero(values > 1e-9 * values.max(initial=1.0))
        right = U[:, :rank].T @ np.array([row.right for row in rows])
        self.Z = Vh[rank:]
        S, sizes, _ = svd(self.Z[:, n:].T)
        self.S = S[:, : np.count_nonzero(sizes > 1e-9)]
        self.sigma = (Vh[:rank].T @ (right / values[:rank]))[n:]

    def move(self, rng):
        """A random velocity that keeps grasps and contacts."""
        A = np.vstack((self.grasps, np.hstack((np.zeros((len(self.N), self.n)), self.N))))
        b = np.concatenate((np.zeros(len(self.grasps)), *(-c.speed() for c in self.contacts)))
        x = rng.standard_normal(self.n + 6)
        for _ in range(2):
            x += np.linalg.lstsq(A, b - A @ x, rcond=1e-10)[0]
        assert largest(A @ x - b) < 1e-11
        self._at(x[: self.n], x[self.n :])

    def answer(self, tau):
        """What motor torques (n_a,) make of all that is connected."""
        s = self.system
        n = self.n + 6
        end = self.n + 6
        parts = {}
        for one in self.bodies:
            parts[id(one)] = slice(end, end + one.body.model.nv)
            end += one.body.model.nv
        M = np.zeros((end, end))
        force = np.zeros(end)
        rows = []
        right = []
        M[: self.n, : self.n] = s.M
        M[self.n : n, self.n : n] = s.I
        friction = self.case.chain.model.damping * self.v
        force[: self.n] = -s.h - friction
        force[self.n : n] = s.pull
        force[self.case.chain.actuated] += tau
        for row in s.rows:
            rows.append(np.concatenate((row.coefficients, np.zeros(end - n))))
            right.append(row.right)
        for one in self.bodies:
            b = one.body
            part = parts[id(one)]
            data = one.body.model.createData()
            pin.computeAllTerms(b.model, data, b.q, b.v)
            M[part, part] = data.M
            force[part] = b.tau - data.nle
            if b.prescribed is not None:
                rows.extend(np.eye(end)[part])
                right.extend(b.prescribed)
        first = len(rows)
        pushes = list(rows)
        for c in self.contacts:
            row = np.zeros((len(c.along_object), end))
            lean = np.zeros_like(row)
            row[:, self.n : n] = c.along_object
            if c.on is not None:
                row[:, parts[id(c.on)]] = c.along_body
            if self.mu:
                lean[:, self.n : n], dragged = c.friction(self.V, self.mu)
                if c.on is not None:
                    lean[:, parts[id(c.on)]] = dragged
            rows.extend(row)
            pushes.extend(row + lean)
            right.extend(-c.bend(self.V))
        A = np.reshape(rows, (-1, end))
        P = np.reshape(pushes, (-1, end))
        K = np.block([[M, -P.T], [A, np.zeros((len(A), len(A)))]])
        y = np.concatenate((force, right))
        x, _ = solve(K, y)
        assert largest(K @ x - y) < 1e-9 * max(1.0, largest(y))
        pulls = P[: self.system.ends[-1], self.n : n] * x[end : end + self.system.ends[-1], None]
        loops = [pulls[a:b].sum(axis=0) for a, b in pairwise(self.system.ends)]
        a = x[self.n : n]
        w = self.V[3:]
        O = self.case.X_WO.translation
        spatial = a - np.concatenate((np.cross(w, self.V[:3]), np.zeros(3)))
        a_e = [one.acceleration(x[parts[id(one)]], O) for one in self.bodies]
        return Answer(x[: self.n], a, x[end + first :], loops, spatial, a_e)

    def readings(self, answer):
        """(arms, 6) of the wrist sensors: what moves the object and the links beyond them."""
        chain = self.case.chain
        out = []
        model = chain.model
        data = chain.model.createData()
        pin.forwardKinematics(model, data, self.case.q, self.v, answer.qdd)
        pin.updateFramePlacements(model, data)
        at_O = shift(self.case.X_WO.translation)
        for arm, links, pull in zip(chain.arms, chain.outboard, answer.loops, strict=True):
            total = at_O.act(pin.Force(pull))
            for link in links:
                X = data.oMi[link.joint]
                V = data.v[link.joint]
                a = data.a[link.joint] - X.actInv(model.gravity)
                total += X.act(link.inertia * a + V.cross(link.inertia * V))
            sensor = data.oMf[model.getFrameId(f"{arm.name}/{arm.wrist_sensor}")]
            out.append(sensor.actInv(total).vector)
        return np.array(out)

    def nearest(self, W, target, value):
        """The acceleration that the grasps permit nearest to target (6,) in W, N a = value (r,)."""
        S = self.S
        NS = self.N @ self.S
        r = len(self.N)
        K = np.block([[S.T @ W @ S, NS.T], [NS, np.zeros((r, r))]])
        y = np.concatenate((S.T @ W @ (target - self.sigma), value - self.N @ self.sigma))
        return S @ solve(K, y)[0][: S.shape[1]] + self.sigma

    def inertia_of_all(self):
        """(6, 6) what object and arms weigh together, in the motions that the grasps permit."""
        n = self.n
        M = np.zeros((n + 6, n + 6))
        M[:n, :n] = self.system.M
        M[n:, n:] = self.system.I
        own = self.Z[:, n:] @ self.S
        mobility = own.T @ np.linalg.solve(self.Z @ M @ self.Z.T, own)
        return self.S @ np.linalg.inv(mobility) @ self.S.T

    def apart(self, N=None):
        """How far the columns are from dependence, as object and arms feel them: 0 … 1."""
        N = self.N if N is None else N
        inertia = self.system.I
        S = self.S
        if len(N) > S.shape[1]:
            return 0.0
        size = np.sqrt(np.einsum("ri,ir->r", N, np.linalg.solve(inertia, N.T)))
        felt = np.linalg.solve(np.linalg.cholesky(S.T @ inertia @ S), S.T @ N.T) / size
        return svd(felt, compute_uv=False).min(initial=1.0)
