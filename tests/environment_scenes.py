"""Bodies of the environment, and chains that press on them: random scenes for the tests."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from grasp_rigs import Case
from rigs import largest, one_panda, panda_pair, random_state, scara_pair, unit

import osc_contact as osc
from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.dynamics.assembly import constraint_rows, inverse_rows, row_groups
from osc_contact.dynamics.environment import Conveyor, Environment, Hinge
from osc_contact.plants.faces import Faces, Rail
from osc_contact.response import require_reachable

G = np.array([0.0, 0.0, -9.81])
RIGS = (scara_pair, panda_pair, one_panda)
RTOL = 1e-9


def close_to(got, want):
    """Largest difference relative to the size of the vector."""
    return largest(got - want) / max(largest(want), 1e-3)


LWA = pin.LOCAL_WORLD_ALIGNED


@dataclass
class Body:
    """One mechanism of the environment: the state of a Pinocchio model, and the link touched."""

    model: pin.Model
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    frame: str
    prescribed: np.ndarray | None = None  # q̈ it has whatever presses on it

    def __post_init__(self):
        self.data = self.model.createData()
        pin.forwardKinematics(self.model, self.data, self.q, self.v, 0 * self.v)
        pin.updateFramePlacements(self.model, self.data)
        self.id = self.model.getFrameId(self.frame)
        self.X = self.data.oMf[self.id]

    @property
    def V(self):
        """Twist at the origin of the touched frame, world axes."""
        return pin.getFrameVelocity(self.model, self.data, self.id, LWA).vector


@dataclass
class Touch:
    """Vertex of the object (object frame) on a face of bodies[body] (normal in its frame)."""

    vertex: np.ndarray
    normal: np.ndarray
    body: int


# Bodies of the environment, each as a Pinocchio model and as an Environment -----------------------


def random_inertia(rng):
    a, b, c = rng.uniform(0.01, 0.04, 3)  # any positive a, b, c make b + c, a + c, a + b possible
    turn = pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3))
    spread = turn @ np.diag([b + c, a + c, a + b]) @ turn.T
    return pin.Inertia(rng.uniform(0.5, 4.0), rng.uniform(-0.1, 0.1, 3), spread)


def random_placement(rng, at):
    return pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3)), at + rng.uniform(-0.3, 0.3, 3))


def one_joint(joint, rng, X, prescribed=False):
    model = pin.Model()
    model.addJointFrame(model.addJoint(0, joint, X, "body"))
    model.appendBodyToJoint(1, random_inertia(rng), pin.SE3.Identity())
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.5, 0.5, model.nv))
    v = rng.uniform(-1, 1, model.nv)
    tau = rng.standard_normal(model.nv) * 5
    acceleration = rng.standard_normal(model.nv) * 3 if prescribed else None
    return Body(model, q, v, tau, "body", acceleration)


def axis(rng):
    x = rng.standard_normal(3)
    return unit(x)


def rigid(rng, at):
    body = one_joint(pin.JointModelFreeFlyer(), rng, random_placement(rng, at))
    R = body.X.rotation
    wrench = np.concatenate((R @ body.tau[:3], R @ body.tau[3:]))
    return body, lambda O: Environment.rigid_body(
        body.model.inertias[1], X_WE=body.X, V_E=body.V, O=O, gravity=G, wrench=wrench
    )


def guided(joint):
    """A body on one joint: rail, door, ball, plate on a plane."""

    def make(rng, at):
        body = one_joint(joint(rng), rng, random_placement(rng, at))
        axes = np.column_stack([replace(body, v=e).V for e in np.eye(body.model.nv)])
        if body.model.nv == 1:
            axes = axes[:, 0]
        return body, lambda O: Environment.rail(
            body.model.inertias[1],
            X_WE=body.X,
            axes=axes,
            rates=body.v,
            O=O,
            gravity=G,
            force=body.tau,
        )

    return make


def linkage(rng, at):
    """Two hinges about skew axes; the second link is touched."""
    model = pin.Model()
    for k in range(2):
        X = random_placement(rng, at if k == 0 else np.zeros(3))
        model.addJoint(k, pin.JointModelRevoluteUnaligned(axis(rng)), X, f"hinge{k}")
        model.appendBodyToJoint(k + 1, random_inertia(rng), pin.SE3.Identity())
    for k, name in ((1, "upper"), (2, "touched")):
        X = random_placement(rng, np.zeros(3))
        model.addFrame(pin.Frame(name, k, 0, X, pin.FrameType.OP_FRAME))
    body = Body(
        model, rng.standard_normal(2), rng.standard_normal(2), rng.standard_normal(2) * 2, "touched"
    )
    return body, lambda O: Environment.articulated(
        body.model, body.q, body.v, body.tau, "touched", O
    )


def moving(rng, at):
    body = one_joint(pin.JointModelFreeFlyer(), rng, random_placement(rng, at), prescribed=True)
    R = body.X.rotation
    v = body.v
    a = body.prescribed
    classical = np.concatenate((R @ (a[:3] + np.cross(v[3:], v[:3])), R @ a[3:]))
    return body, lambda O: Environment.moving(X_WE=body.X, V_E=body.V, A_E=classical, O=O)


def on_joints(rng, at, *joints, inertia):
    """E on joints at a random point c, E's axes the world's and its origin there at q = 0."""
    model = pin.Model()
    c = at + rng.uniform(-0.3, 0.3, 3)
    for k, joint in enumerate(joints):
        X = pin.SE3(np.eye(3), np.zeros(3) if k else c)
        model.addJoint(k, joint, X, f"joint{k}")
        model.appendBodyToJoint(k + 1, inertia, pin.SE3.Identity())
    X = pin.SE3(np.eye(3), -c)
    model.addFrame(pin.Frame("E", len(joints), 0, X, pin.FrameType.OP_FRAME))
    return model, c, rng.uniform(-1.5, 1.5, model.nv), rng.uniform(-1, 1, model.nv)


def hinged(rng, at):
    """`Hinge`: a body whose centre of mass lies on the axis, with a spring and a damper."""
    a = axis(rng)
    joint = pin.JointModelRevoluteUnaligned
    body = random_inertia(rng)
    balanced = pin.Inertia(body.mass, rng.normal() * a, body.inertia)
    model, c, q, v = on_joints(rng, at, joint(a), inertia=balanced)
    k, d, preload = rng.uniform(0, 5, 3)
    hinge = Hinge(2.0 * a, c + rng.normal() * a, a @ body.inertia @ a, k, d, preload)
    body = Body(model, q, v, preload - k * q - d * v, "E")
    return body, lambda O: hinge.environment(body.X, body.V, np.zeros(6), O)


def turning(rng, at):
    """`Rail` and `Conveyor`: a driven slide that carries a driven hinge."""
    u = axis(rng)
    a = axis(rng)
    rates = rng.standard_normal(2) * 3
    joints = pin.JointModelPrismaticUnaligned(u), pin.JointModelRevoluteUnaligned(a)
    model, c, q, v = on_joints(rng, at, *joints, inertia=random_inertia(rng))
    rail = Rail(u, a, c, lambda t: (q, v, rates))
    faces = Faces([rail], [0])
    faces.drive(0.0)
    seen = faces.touched()
    X = pin.SE3(seen.X_WE[0])
    V = seen.V_E[0]
    A = seen.A_E[0]
    body = Body(model, q, v, np.zeros(2), "E", rates)
    return body, lambda O: Conveyor().environment(X, V, A, O)


rail = guided(lambda rng: pin.JointModelPrismaticUnaligned(axis(rng)))
KINDS = {  # bodies, and the body of each contact
    "free body": ([rigid], [0, 0]),
    "rail": ([rail], [0, 0]),
    "hinge": ([guided(lambda rng: pin.JointModelRevoluteUnaligned(axis(rng)))], [0, 0]),
    "ball": ([guided(lambda rng: pin.JointModelSpherical())], [0, 0]),
    "plane": ([guided(lambda rng: pin.JointModelPlanar())], [0, 0]),
    "linkage": ([linkage], [0, 0]),
    "prescribed": ([moving], [0, 0]),
    "hinged face": ([hinged], [0, 0]),
    "turning conveyor": ([turning], [0, 0]),
    "rail and free body": ([rail, rigid], [0, 1]),
    "prescribed and linkage": ([moving, linkage], [0, 1]),
    "three on two bodies": ([rigid, linkage], [0, 1, 0]),
}


@dataclass
class Scene:
    chain: osc.ClosedChain
    state: osc.ChainState
    contact: osc.Contact
    parts: list[osc.Contact]
    each: list[Environment]  # behind each part
    environment: Environment
    bodies: list[Body]
    touches: list[Touch]
    q: np.ndarray
    v: np.ndarray
    N_dot: np.ndarray

    def solve(self, tau, mu=0.0):
        """What motor torques make of it all, with friction mu."""
        from kkt_oracle import Contact, State, Touched

        X = self.state.X_WO
        case = Case(self.chain, self.q, X, [("rigid", g.X_TO, None) for g in self.chain.grasps])
        touched = [Touched(body, None, "") for body in self.bodies]
        pairs = pairs_at(self.state, self.bodies, self.touches)
        whole = State(
            case,
            [Contact("", p, touched[t.body], X) for p, t in zip(pairs, self.touches, strict=True)],
            mu,
        )
        whole._at(self.v, self.state.V_O)
        return whole.answer(tau)


def pairs_at(state, bodies, touches):
    """Vertex and face of each touch, so placed that they meet."""
    points = [bodies[t.body].X.actInv(state.X_WO.act(t.vertex)) for t in touches]
    return [VertexOnFace(t.vertex, p, t.normal) for t, p in zip(touches, points, strict=True)]


def contacts_at(state, bodies, touches):
    """The contact of each touch at this instant."""
    on = [bodies[t.body] for t in touches]
    return [
        pair.contact(state.X_WO, state.V_O, body.X, body.V)
        for pair, body in zip(pairs_at(state, bodies, touches), on, strict=True)
    ]


def following(chain, q, v, N, normal_speed):
    """The nearest velocity with closed loops and NᵀV_O = normal_speed."""
    pin.computeAllTerms(chain.model, chain.data, q, v)
    A = constraint_rows(chain, chain.object_poses()[0].translation, N)
    b = np.concatenate((np.zeros(A.shape[0] - N.shape[1]), -normal_speed))
    for _ in range(3):
        v = v - inverse_rows(A, np.array(chain.data.M), row_groups(chain))[0] @ (A @ v - b)
    return v


def scene(rig, kind, rng):
    """A random state of a chain pressing on random bodies, all moving, contacts kept."""
    chain = rig()
    makers, owners = KINDS[kind]
    while True:
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        O = state.X_WO.translation
        made = [make(rng, O) for make in makers]
        bodies = [m[0] for m in made]
        each = [m[1](O) for m in made]
        touches = [Touch(rng.uniform(-0.3, 0.3, 3), rng.standard_normal(3), i) for i in owners]
        N = np.hstack([p.N for p in contacts_at(state, bodies, touches)])
        try:
            require_reachable(state, osc.Contact(N))
        except osc.ContactError:
            continue
        speed = np.concatenate([N[:, [j]].T @ each[i].V_e for j, i in enumerate(owners)])
        v = following(chain, q, v, N, speed)
        state = chain.state(q, v)
        parts = contacts_at(state, bodies, touches)
        behind = [each[i] for i in owners]
        environment = Environment.combine(parts, behind, state.metric)
        contact = osc.Contact.stack(parts)
        rates = [
            _rate(state, p.N[:3, 0], each[i].V_e, t.vertex)
            for p, t, i in zip(parts, touches, owners, strict=True)
        ]
        return Scene(
            chain,
            state,
            contact,
            parts,
            behind,
            environment,
            bodies,
            touches,
            q,
            v,
            np.column_stack(rates),
        )


def _rate(state, n, V_e, vertex):
    """Ṅ of one contact, reference point frozen."""
    s = state.X_WO.rotation @ vertex
    n_dot = np.cross(V_e[3:], n)
    s_dot = state.V_O[:3] + np.cross(state.V_O[3:], s)
    return np.concatenate((n_dot, np.cross(s_dot, n) + np.cross(s, n_dot)))


def cases(*rigs):
    return pytest.mark.parametrize(
        "rig, kind",
        [(rig, kind) for rig in rigs for kind in KINDS],
        ids=lambda x: str(getattr(x, "__name__", x)),
    )


def twist_at(body, state):
    shift = state.X_WO.translation - body.X.translation
    return np.concatenate((body.V[:3] + np.cross(body.V[3:], shift), body.V[3:]))
