"""Oracle of the law: one KKT system of arms, held object and touched bodies, for any contacts.

Unknowns are the accelerations of all joints, of the object and of all bodies, and a multiplier for
each row of a grasp and of a contact. M and h are Pinocchio's, the rows of grasps those of
`grasp_oracle`, and the rows of a contact its gaps, differentiated twice along the motion. N, n_γ, S
and Φ_e of the package are not used. Accelerations of the object are classical.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from grasp_oracle import solve
from grasp_rigs import Case
from numpy.linalg import cholesky, inv, lstsq, svd
from numpy.random import default_rng
from pair_kinds import KINDS as PAIRS
from pair_kinds import PLAIN, Coordinates, rate
from rigs import LWA, data_at, direction, largest, placed, product, shift, unit, vector
from samples import aligned

from osc_contact.dynamics.environment import Conveyor, Environment, Guided, Rail

G = vector(0.0, 0.0, -9.81)
SIZE = 0.15  # scale of the pairs' geometry, which is drawn in units of 1 m
STEP = 0.025  # step of the finite differences (m or rad)
REACH = 6  # number of steps to either side: differences of the twelfth order


# Bodies -------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Body:
    """Mechanism whose last frame is touched, in a state, with the controller's model of it.

    Attributes:
        model: model of the mechanism.
        q, v: its state.
        tau: (nv,) generalised forces (N m, N).
        known: body of the package, or function from O (3,) to the `Environment`.
        prescribed: (nv,) q̈ of its drives, or None.
        name: kind of the body.
        X, V: pose and twist (6,) of the touched frame, at its origin in world axes.
    """

    model: pin.Model
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    known: object
    prescribed: np.ndarray | None = None
    name: str = ""

    def __post_init__(self):
        """Compute pose and twist of the touched frame."""
        self.frame = self.model.nframes - 1
        data = data_at(self.model, self.q, self.v)
        self.X = data.oMf[self.frame]
        self.V = pin.getFrameVelocity(self.model, data, self.frame, LWA).vector

    @classmethod
    def random(cls, name, rng, at):
        """Random body of the kind `name` in `BODIES`, near a point `at` (3,) (m)."""
        return replace(BODIES[name](rng, at), name=name)

    @property
    def given(self):
        """Argument for `bodies` of a controller."""
        return self if callable(self.known) else self.known

    def environment(self, X_WE, V_E, A_E, O):
        """Environment at O (3,), as a `Body` of the package; its measured motion is not used."""
        return self.known(O)

    def pose(self, step):
        """Pose of the touched frame after a displacement of the joints by `step` (nv,)."""
        return data_at(self.model, pin.integrate(self.model, self.q, step)).oMf[self.frame].copy()

    def acceleration(self, qdd, O, of_frame=pin.getFrameAcceleration):
        """Acceleration (6,) of the touched frame at O (3,) for the joint accelerations qdd (nv,).

        It is spatial, or of the kind that the function `of_frame` of Pinocchio computes.
        """
        data = data_at(self.model, self.q, self.v, qdd)
        a = of_frame(self.model, data, self.frame, LWA).vector
        a[:3] += np.cross(a[3:], O - self.X.translation)
        return a

    def seen(self):
        """Measured motion (28,) for a controller: X_WE by rows, V_E, A_E.

        A_E is zero unless a drive prescribes the acceleration.
        """
        A = np.zeros(6)
        if self.prescribed is not None:
            classical = pin.getFrameClassicalAcceleration
            A = self.acceleration(self.prescribed, self.X.translation, classical)
        return np.concatenate((self.X.homogeneous.ravel(), self.V, A))


WORLD = Body(pin.Model(), *[np.zeros(0)] * 3, None, name="world")


def random_inertia(rng):
    """Random inertia of a possible body."""
    a, b, c = rng.uniform(0.01, 0.04, 3)  # any positive a, b, c make b + c, a + c, a + b possible
    turn = pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3))
    spread = turn @ np.diag([b + c, a + c, a + b]) @ turn.T
    return pin.Inertia(rng.uniform(0.5, 4.0), rng.uniform(-0.1, 0.1, 3), spread)


def random_placement(rng, at):
    """Random pose within 0.3 m of a point `at` (3,) along each axis."""
    return placed(*(at + rng.uniform(-0.3, 0.3, 3)), rng.uniform(-3, 3, 3))


def on_joint(joint, rng, at, known, prescribed=False):
    """Body on one joint near a point, with a random state and random forces.

    Args:
        joint: joint model of Pinocchio.
        rng: random numbers.
        at: (3,) point (m).
        known: see `Body`.
        prescribed: True if a drive prescribes the acceleration.
    """
    model = pin.Model()
    model.addJointFrame(model.addJoint(0, joint, random_placement(rng, at), "body"))
    model.appendBodyToJoint(1, random_inertia(rng), placed())
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.5, 0.5, model.nv))
    v = rng.uniform(-1, 1, model.nv)
    tau = rng.standard_normal(model.nv) * 5
    acceleration = rng.standard_normal(model.nv) * 3 if prescribed else None
    return Body(model, q, v, tau, known, acceleration)


def free(rng, at):
    """Free body near a point `at` (3,), with a random wrench on it."""

    def known(O):
        """Environment of the body at O (3,)."""
        wrench = (body.X.rotation @ body.tau.reshape(2, 3).T).T.ravel()
        motion = {"X_WE": body.X, "axes": np.eye(6), "rates": body.V, "O": O}
        return Environment.rail(body.model.inertias[1], **motion, gravity=G, force=wrench)

    body = on_joint(pin.JointModelFreeFlyer(), rng, at, known)
    return body


def guided(joint):
    """Make a function for a body on one joint: on a rail, a hinge, a ball joint or a plane.

    Args:
        joint: function from random numbers to a joint model of Pinocchio.
    """

    def make(rng, at):
        """Body on a random joint near a point `at` (3,)."""

        def known(O):
            """Environment of the body at O (3,), with the twists for unit rates as axes."""
            axes = np.column_stack([replace(body, v=e).V for e in np.eye(body.model.nv)])
            axes = axes[:, 0] if body.model.nv == 1 else axes
            motion = {"rates": body.v, "O": O, "gravity": G, "force": body.tau}
            return Environment.rail(body.model.inertias[1], X_WE=body.X, axes=axes, **motion)

        body = on_joint(joint(rng), rng, at, known)
        return body

    return make


def linkage(rng, at):
    """Linkage of two hinges about skew axes near a point `at` (3,); the second link is touched."""
    model = pin.Model()
    for k in range(2):
        X = random_placement(rng, at if k == 0 else np.zeros(3))
        model.addJoint(k, pin.JointModelRevoluteUnaligned(direction(rng)), X, f"hinge{k}")
        model.appendBodyToJoint(k + 1, random_inertia(rng), placed())
    for k, name in ((1, "upper"), (2, "touched")):
        X = random_placement(rng, np.zeros(3))
        model.addFrame(pin.Frame(name, k, 0, X, pin.FrameType.OP_FRAME))
    q, v, tau = rng.standard_normal((3, 2))
    state = (model, q, v, 2 * tau)
    return Body(*state, lambda O: Environment.articulated(*state, "touched", O))


def moving(rng, at):
    """Free-flying body near a point `at` (3,) whose acceleration is prescribed."""
    return on_joint(pin.JointModelFreeFlyer(), rng, at, Conveyor(), prescribed=True)


def on_joints(rng, at, *joints, inertia):
    """Mechanism of serial joints at a random point c, whose last frame E is the world's at q = 0.

    Args:
        rng: random numbers.
        at: (3,) point near which c is (m).
        *joints: joint models.
        inertia: inertia of each link in the frame of its joint.

    Returns:
        Model, c (3,), and random joint positions and velocities.
    """
    model = pin.Model()
    c = at + rng.uniform(-0.3, 0.3, 3)
    for k, joint in enumerate(joints):
        model.addJoint(k, joint, shift(np.zeros(3) if k else c), f"joint{k}")
        model.appendBodyToJoint(k + 1, inertia, placed())
    model.addFrame(pin.Frame("E", len(joints), 0, shift(-c), pin.FrameType.OP_FRAME))
    return (model, c, rng.uniform(-1.5, 1.5, model.nv), rng.uniform(-1, 1, model.nv))


def hinged(rng, at):
    """Body on a hinge through its centre of mass, with spring and damper, known as `Guided`."""
    a = direction(rng)
    body = random_inertia(rng)
    balanced = pin.Inertia(body.mass, rng.normal() * a, body.inertia)
    model, c, q, v = on_joints(rng, at, pin.JointModelRevoluteUnaligned(a), inertia=balanced)
    k, d, preload = rng.uniform(0, 5, 3)
    through = c + rng.normal() * a
    rail = Rail(np.zeros(3), 2.0 * a, through, None, a @ body.inertia @ a, k, d, preload)
    return Body(model, q, v, preload - k * q - d * v, Guided(rail))


def turning(rng, at):
    """Body on a driven slide and a driven hinge, known as `Conveyor`."""
    u = direction(rng)
    a = direction(rng)
    rates = rng.standard_normal(2) * 3
    joints = (pin.JointModelPrismaticUnaligned(u), pin.JointModelRevoluteUnaligned(a))
    model, _, q, v = on_joints(rng, at, *joints, inertia=random_inertia(rng))
    return Body(model, q, v, np.zeros(2), Conveyor(), rates)


def cart(rng, at):
    """Mass on a slide through the world's origin, with spring and damper, known as `Guided`."""
    u = direction(rng)
    mass, k, c, preload = rng.uniform(1.0, 5.0, 4)
    joint = pin.JointModelPrismaticUnaligned(u)
    model, _, q, v = on_joints(rng, at, joint, inertia=pin.Inertia.FromSphere(mass, 0.1))
    rail = Rail(2.0 * u, inertia=mass, stiffness=k, damping=c, preload=preload)
    return Body(model, q, v, preload - k * q - c * v, Guided(rail))


BODIES = {
    "free body": free,
    "rail": guided(lambda rng: pin.JointModelPrismaticUnaligned(direction(rng))),
    "hinge": guided(lambda rng: pin.JointModelRevoluteUnaligned(direction(rng))),
    "ball": guided(lambda rng: pin.JointModelSpherical()),
    "plane": guided(lambda rng: pin.JointModelPlanar()),
    "linkage": linkage,
    "prescribed": moving,
    "hinged face": hinged,
    "turning conveyor": turning,
    "cart": cart,
}


# Contacts -----------------------------------------------------------------------------------------


def touch(name, rng, X_EO):
    """Random pair of a kind that is in contact with the object at the pose X_EO.

    Args:
        name: key of `pair_kinds.KINDS`.
        rng: random numbers.
        X_EO: pose of the object in the touched body's frame.
    """
    while True:
        seed = rng.integers(2**32)
        pair, pose, r = PAIRS[name](default_rng(seed), PLAIN)
        if abs(getattr(pair, "pitch", 1.0)) > 0.3:  # differences need a coarse thread
            break
    scaled = pin.SE3(X_EO.rotation, X_EO.translation / SIZE)
    coordinates = Coordinates(
        X_E=pose(0.7 * rng.standard_normal(6 - r)) * scaled.inverse(), per_metre=SIZE
    )
    return PAIRS[name](default_rng(seed), coordinates)[0]


def slopes(f, k):
    """Derivatives (r, k) of a function f of k coordinates at zero, which returns (r,) numbers."""
    columns = [rate(lambda t, e=e: f(t * e), h=STEP, reach=REACH) for e in np.eye(k)]
    return np.array(columns).T.reshape(len(f(np.zeros(k))), k)


@dataclass
class Contact:
    """Pair between object and body, with derivatives of its gaps by finite differences.

    Attributes:
        name: kind of the pair.
        pair: pair of the package.
        on: touched body.
        X_WO: pose of the object.
        bent: (r,) result of `bend` if it is known; None: it is computed by differences.
        along_object: (r, 6) derivatives of the gaps by displacements of the object at O.
        along_body: (r, nv) derivatives of the gaps by the body's joints.
    """

    name: str
    pair: object
    on: Body
    X_WO: pin.SE3
    bent: object = None

    def __post_init__(self):
        """Compute the first derivatives of the gaps."""
        self.along_object = slopes(lambda s: self.gaps(s, 0.0 * self.on.v), 6)
        self.along_body = slopes(lambda s: self.gaps(np.zeros(6), s), len(self.on.v))

    def gaps(self, of_object, of_body):
        """Gaps (r,) after displacements of the object (6,) and of the body's joints (nv,)."""
        R = pin.exp3(of_object[3:]) @ self.X_WO.rotation
        X_WO = pin.SE3(R, self.X_WO.translation + of_object[:3])
        return self.pair.gaps(X_WO, self.on.pose(of_body))

    def bend(self, V):
        """Second time derivative (r,) of the gaps at the object's twist V (6,) and q̈ = 0."""
        if self.bent is not None:
            return self.bent
        speed = max(1.0, largest(V), largest(self.on.v))
        V_unit = V / speed
        v_unit = self.on.v / speed
        return speed**2 * rate(lambda t: self.gaps(t * V_unit, t * v_unit), 2, STEP, REACH)

    def slip(self, V):
        """Velocity (3,) of a vertex relative to its face, and arms (3,) from O and from E to it.

        Args:
            V: (6,) twist of the object.
        """
        X_WE = self.on.X
        V_E = self.on.V
        n = X_WE.rotation @ unit(self.pair.normal)
        arm = self.X_WO.rotation @ self.pair.vertex - self.pair.radius * n
        far = self.X_WO.translation + arm - X_WE.translation
        return (V[:3] + np.cross(V[3:], arm) - V_E[:3] - np.cross(V_E[3:], far), arm, far)

    def n_gamma(self, V):
        """n_γ (r,) at the object's twist V (6,): Nᵀ of the relative spatial acceleration."""
        drift = self.on.acceleration(0.0 * self.on.v, self.X_WO.translation)
        return self.bend(V) + self.along_object @ (product(V) + drift)

    def friction(self, V, mu):
        """Coulomb friction on the object (6,) and on the body's joints (nv,), for 1 N of pressure.

        Args:
            V: (6,) twist of the object.
            mu: coefficient of friction.
        """
        slip, arm, far = self.slip(V)
        f = -mu * unit(slip)
        b = self.on
        J = pin.computeFrameJacobian(b.model, b.model.createData(), b.q, b.frame, LWA)
        return (np.append(f, np.cross(arm, f)), -J.T @ np.append(f, np.cross(far, f)))


# Everything at once -------------------------------------------------------------------------------


@dataclass
class Answer:
    """Solution of the KKT system.

    Attributes:
        qdd: (n,) accelerations of the joints.
        a, a_object: (6,) classical and spatial acceleration of the object at O.
        alpha: (r,) contact forces (N).
        loops: wrench (6,) of each arm on the object at O.
        a_e: spatial acceleration (6,) of each touched body at O.
        residual: relative residual; not zero if no acceleration keeps all loops closed.
    """

    qdd: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    loops: list
    a_object: np.ndarray
    a_e: list
    residual: float


@dataclass
class State:
    """Arms that hold an object which touches bodies; at rest until `move`.

    Attributes:
        case: arms and object.
        contacts: contacts of the object.
        mu: coefficient of friction.
        rest: state of the same arms at rest, from which the grasps are taken; None: they are
            computed.
        N: (r, 6) derivatives of all gaps by displacements of the object.
        S: (6, d) motions of the object that the grasps permit.
        sigma: (6,) acceleration at η̇ = 0.
        Z: rows of permitted accelerations of joints and object.
    """

    case: Case
    contacts: list
    mu: float = 0.0
    rest: object = None

    def __post_init__(self):
        """Collect bodies and gaps, and compute the grasps at rest."""
        self.n = self.case.chain.nq
        self.bodies = list({id(c.on): c.on for c in self.contacts}.values())
        self.N = np.vstack([np.zeros((0, 6)), *(c.along_object for c in self.contacts)])
        if self.rest is None:
            self.at(np.zeros(self.n), np.zeros(6))
        else:
            self.grasps = self.rest.grasps

    def at(self, v, V):
        """Compute grasps and permitted accelerations x₀ + Zᵀy at joint velocities v and twist V.

        x has the accelerations of all joints and of the object. Returns the state itself.
        """
        self.v = v
        self.V = V
        self.system = self.case.system(v, V)
        n = self.n
        self.grasps = self.system.rows
        U, values, Vh = svd(self.grasps)
        rank = np.count_nonzero(values > 1e-9 * values.max(initial=1.0))
        right = U[:, :rank].T @ self.system.right
        self.Z = Vh[rank:]
        S, sizes, _ = svd(self.Z[:, n:].T)
        self.S = S[:, : np.count_nonzero(sizes > 1e-9)]
        self.sigma = (Vh[:rank].T @ (right / values[:rank]))[n:]
        return self

    def move(self, rng):
        """Move at a random velocity that keeps grasps and contacts."""
        A = np.vstack((self.grasps, np.hstack((np.zeros((len(self.N), self.n)), self.N))))
        b = np.concatenate(
            (np.zeros(len(self.grasps)), *(-c.along_body @ c.on.v for c in self.contacts))
        )
        x = rng.standard_normal(self.n + 6)
        for _ in range(2):
            x += lstsq(A, b - A @ x, rcond=1e-10)[0]
        assert largest(A @ x - b) < 1e-11
        self.at(x[: self.n], x[self.n :])

    def answer(self, tau, exact=True):
        """Solve for the response of arms, object and bodies to motor torques.

        Args:
            tau: (n_a,) motor torques (N m, N).
            exact: True if a response has to exist.
        """
        s = self.system
        n = self.n + 6
        ends = np.cumsum([n, *(len(b.v) for b in self.bodies)])
        parts = {id(b): slice(*at) for b, at in aligned(self.bodies, pairwise(ends))}
        end = ends[-1]
        M = np.zeros((end, end))
        force = np.zeros(end)
        M[: self.n, : self.n] = s.M
        M[self.n : n, self.n : n] = s.I
        force[: self.n] = -s.h - self.case.chain.model.damping * self.v
        force[self.n : n] = s.pull
        force[self.case.chain.actuated] += tau
        rows = [np.pad(row, (0, end - n)) for row in s.rows]
        right = [*s.right]
        for b in self.bodies:
            part = parts[id(b)]
            data = b.model.createData()
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
            row[:, parts[id(c.on)]] = c.along_body
            if self.mu:
                lean[:, self.n : n], lean[:, parts[id(c.on)]] = c.friction(self.V, self.mu)
            rows.extend(row)
            pushes.extend(row + lean)
            right.extend(-c.bend(self.V))
        A = np.reshape(rows, (-1, end))
        P = np.reshape(pushes, (-1, end))
        K = np.block([[M, -P.T], [A, np.zeros((len(A), len(A)))]])
        y = np.append(force, right)
        x, _ = solve(K, y)
        residual = largest(K @ x - y) / max(1.0, largest(y))
        assert residual < 1e-9 or not exact
        pulls = P[: s.ends[-1], self.n : n] * x[end : end + s.ends[-1], None]
        loops = [pulls[a:b].sum(axis=0) for a, b in pairwise(s.ends)]
        a = x[self.n : n]
        O = self.case.X_WO.translation
        a_e = [b.acceleration(x[parts[id(b)]], O) for b in self.bodies]
        return Answer(x[: self.n], a, x[end + first :], loops, a - product(self.V), a_e, residual)

    def readings(self, answer):
        """Readings (arms, 6) of the wrist sensors: wrenches that move object and outboard links.

        Args:
            answer: response to the motor torques.
        """
        chain = self.case.chain
        model = chain.model
        data = data_at(model, self.case.q, self.v, answer.qdd)
        out = []
        for arm, links, pull in aligned(chain.arms, chain.outboard, answer.loops):
            total = shift(self.case.X_WO.translation).act(pin.Force(pull))
            for link in links:
                X = data.oMi[link.joint]
                V = data.v[link.joint]
                a = data.a[link.joint] - X.actInv(model.gravity)
                total += X.act(link.inertia * a + V.cross(link.inertia * V))
            sensor = data.oMf[model.getFrameId(f"{arm.name}/{arm.wrist_sensor}")]
            out.append(sensor.actInv(total).vector)
        return np.array(out)

    def nearest(self, W, target, value):
        """Permitted acceleration (6,) that is nearest to `target` (6,), with N a = `value` (r,).

        W (6, 6) is the metric of the distance.
        """
        S = self.S
        NS = self.N @ self.S
        r = len(self.N)
        K = np.block([[S.T @ W @ S, NS.T], [NS, np.zeros((r, r))]])
        y = np.append(S.T @ W @ (target - self.sigma), value - self.N @ self.sigma)
        return S @ solve(K, y)[0][: S.shape[1]] + self.sigma

    def inertia_of_all(self):
        """Inertia (6, 6) of object and arms together at O, in the motions that grasps permit."""
        n = self.n
        M = np.zeros((n + 6, n + 6))
        M[:n, :n] = self.system.M
        M[n:, n:] = self.system.I
        own = self.Z[:, n:] @ self.S
        mobility = own.T @ np.linalg.solve(self.Z @ M @ self.Z.T, own)
        return self.S @ inv(mobility) @ self.S.T

    def apart(self, N=None):
        """Distance (0 … 1) of the rows of N (r, 6) from dependence in the object's energy metric.

        Only their parts along S count; 0 if there are more rows than motions.
        """
        N = self.N if N is None else N
        inertia = self.system.I
        S = self.S
        if len(N) > S.shape[1]:
            return 0.0
        size = np.sqrt(np.einsum("ri,ir->r", N, np.linalg.solve(inertia, N.T)))
        felt = np.linalg.solve(cholesky(S.T @ inertia @ S), S.T @ N.T) / size
        return svd(felt, compute_uv=False).min(initial=1.0)


def pressed(case, pairs):
    """State of arms at rest whose object is in contact with pairs that are fixed to the world."""
    return State(case, [Contact(pair.name, pair, WORLD, case.X_WO) for pair in pairs])


def held(chain, q, v, pairs=()):
    """State of arms at q, v that hold their object rigidly, in contact with pairs in the world."""
    data = data_at(chain.model, q, v)
    X_WT = chain.tip_poses(data)[0]
    X_WO = X_WT * chain.grasps[0].X_TO
    V = pin.getFrameVelocity(chain.model, data, chain.tips[0], LWA).vector
    V[:3] += np.cross(V[3:], X_WO.translation - X_WT.translation)
    case = Case(chain, q, X_WO, [("rigid", grasp.X_TO, None) for grasp in chain.grasps])
    return pressed(case, pairs).at(v, V)
