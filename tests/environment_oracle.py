"""Oracle for contact with moving and yielding bodies: robots, object, environment at once.

One Pinocchio model holds the arms, the free-flying object and every environment mechanism. Their
joint accelerations, one multiplier for each row of a loop closure, one for each contact and one
for each joint that is driven along a prescribed motion are solved together by least squares. No
formula is shared with the package: contacts and loops are written with *classical* accelerations
of points (relative motion in a turning frame, with Coriolis terms), never with N, n_γ, Φ_e, S.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

LWA = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


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
    frame: str | None = None  # default: the frame of the body


@dataclass
class Solution:
    qdd: np.ndarray  # of the arms
    a_object: np.ndarray  # spatial, at O
    alpha: np.ndarray
    a_e: list[np.ndarray]  # spatial acceleration of each touched link, at O
    body_qdd: list[np.ndarray]
    loops: np.ndarray  # (arms, 6) wrench of each arm on the object, at O; split not unique


class Whole:
    """The merged model of chain, object and mechanisms (same joints, any state)."""

    def __init__(self, chain, models):
        merged = chain.model.copy()
        self.arms = slice(0, merged.nv)
        j = merged.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
        merged.appendBodyToJoint(j, chain.payload.inertia, pin.SE3.Identity())
        add_point(merged, "object_frame", j, pin.SE3.Identity())
        self.tips = []
        for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
            tip = merged.frames[merged.getFrameId(f"{arm.name}/{arm.tip}")]
            name = f"object held by {arm.name}"
            add_point(merged, name, tip.parentJoint, tip.placement * grasp.X_TO)
            self.tips.append(name)
        self.parts = []
        for i, model in enumerate(models):
            copy = model.copy()
            for k in range(1, copy.njoints):
                copy.names[k] = f"e{i}/{copy.names[k]}"
            for frame in list(copy.frames)[1:]:
                frame.name = f"e{i}/{frame.name}"
            start = merged.nv
            merged = pin.appendModel(merged, copy, 0, pin.SE3.Identity())
            self.parts.append(slice(start, merged.nv))
        self.model = merged
        self.data = merged.createData()


def add_point(model, name, joint, X):
    model.addFrame(pin.Frame(name, joint, 0, X, pin.FrameType.OP_FRAME))


def kkt(chain, q, v, tau, bodies, touches, whole=None, mu=0.0) -> Solution:
    """Accelerations and forces of everything at once; V of the object follows the first arm.

    With Coulomb friction mu each contact force leans against the slip of the object.
    """
    whole = Whole(chain, [b.model for b in bodies]) if whole is None else whole
    model, data, k = whole.model, whole.data, len(chain.arms)
    n = model.nv
    X, V = _object_state(chain, q, v)
    O, R = X.translation, X.rotation  # noqa: E741
    Q = np.concatenate([q, pin.SE3ToXYZQUAT(X), *(b.q for b in bodies)])
    U = np.concatenate([v, R.T @ V[:3], R.T @ V[3:], *(b.v for b in bodies)])
    force = np.concatenate([np.zeros(whole.arms.stop + 6), *(b.tau for b in bodies)])
    force[chain.actuated] = tau
    pin.computeAllTerms(model, data, Q, U)
    M, h = np.array(data.M), np.array(data.nle)
    pin.forwardKinematics(model, data, Q, U, np.zeros(n))
    pin.updateFramePlacements(model, data)

    def frame(name):
        """Placement, Jacobian, twist and classical acceleration at q̈ = 0 of a frame."""
        f = model.getFrameId(name)
        return (
            np.array(data.oMf[f].translation),
            pin.getFrameJacobian(model, data, f, LWA),
            pin.getFrameVelocity(model, data, f, LWA).vector.copy(),
            pin.getFrameClassicalAcceleration(model, data, f, LWA).vector.copy(),
        )

    _, J_o, V_o, a_o = frame("object_frame")
    rows, right, leaning = [], [], {}
    for name in whole.tips:
        _, J_t, _, a_t = frame(name)
        rows.append(J_t - J_o)
        right.append(a_o - a_t)
    for touch in touches:
        name = f"e{touch.body}/{touch.frame or bodies[touch.body].frame}"
        p_E, J_E, V_E, a_E = frame(name)
        n_out = data.oMf[model.getFrameId(name)].rotation @ touch.normal
        n_out = n_out / np.linalg.norm(n_out)
        s = R @ touch.vertex
        r = O + s - p_E
        w, u = V_o[3:], V_E[3:]
        J_p = J_o[:3] - pin.skew(s) @ J_o[3:]
        J_m = J_E[:3] - pin.skew(r) @ J_E[3:]  # of the point of the face now under the vertex
        a_p = a_o[:3] + np.cross(a_o[3:], s) + np.cross(w, np.cross(w, s))
        a_m = a_E[:3] + np.cross(a_E[3:], r) + np.cross(u, np.cross(u, r))
        slip = V_o[:3] + np.cross(w, s) - V_E[:3] - np.cross(u, r)
        lean = mu * slip / np.linalg.norm(slip) if mu else np.zeros(3)
        leaning[len(rows)] = lean @ (J_p - J_m)
        rows.append((n_out @ (J_p - J_m))[None])  # + α pushes the object out of the face
        right.append([-n_out @ (a_p - a_m - 2 * np.cross(u, slip))])
    driven = [i for i, b in enumerate(bodies) if b.prescribed is not None]
    for i in driven:
        rows.append(np.eye(n)[whole.parts[i]])
        right.append(bodies[i].prescribed)
    A, b = np.vstack(rows), np.concatenate(right)
    m = len(b)
    forces = np.vstack([row - leaning.get(i, 0.0) for i, row in enumerate(rows)])
    K = np.block([[M, -forces.T], [A, np.zeros((m, m))]])
    y = np.concatenate((force - h, b))
    x = _solve(K, y)
    qdd, lam = x[:n], x[n:]
    pin.forwardKinematics(model, data, Q, U, qdd)
    a_e = []
    for i, body in enumerate(bodies):
        p_E, _, V_E, a_E = frame(f"e{i}/{body.frame}")
        a_e.append(_spatial_at(O - p_E, V_E, a_E))
    return Solution(
        qdd=qdd[whole.arms],
        a_object=_spatial_at(np.zeros(3), V_o, frame("object_frame")[3]),
        alpha=lam[6 * k : 6 * k + len(touches)],
        a_e=a_e,
        body_qdd=[qdd[s] for s in whole.parts],
        loops=-lam[: 6 * k].reshape(k, 6),
    )


def _object_state(chain, q, v):
    """Pose, and twist at O in world axes, of the object as the first arm holds it."""
    arm, data = chain.arms[0], chain.model.createData()
    pin.forwardKinematics(chain.model, data, q, v)
    pin.updateFramePlacements(chain.model, data)
    f = chain.model.getFrameId(f"{arm.name}/{arm.tip}")
    X = data.oMf[f] * chain.grasps[0].X_TO
    V = pin.getFrameVelocity(chain.model, data, f, LWA).vector
    shift = X.translation - data.oMf[f].translation
    return X, np.concatenate((V[:3] + np.cross(V[3:], shift), V[3:]))


def _spatial_at(r, V, a):
    """Spatial acceleration at the point r away from one of twist V and classical acceleration a."""
    v = V[:3] + np.cross(V[3:], r)
    classical = a[:3] + np.cross(a[3:], r) + np.cross(V[3:], np.cross(V[3:], r))
    return np.concatenate((classical - np.cross(V[3:], v), a[3:]))


def _solve(K, y):
    """Least squares, equilibrated and refined: the loop of two SCARAs has a redundant row."""
    scale = 1.0 / np.sqrt(np.abs(K).max(axis=1))
    Ks = K * np.outer(scale, scale)
    x = scale * np.linalg.lstsq(Ks, scale * y, rcond=1e-13)[0]
    for _ in range(2):
        x += scale * np.linalg.lstsq(Ks, scale * (y - K @ x), rcond=1e-13)[0]
    return x
