"""Oracle of grasps: full systems of equations for arms that hold an object by any grasp.

Unknowns are the accelerations of all joints and of the object, in classical terms. A grasp is
written as points and directions that stay together, differentiated twice by hand. N, T and
generalised inverses of the package are not used.
"""

import numpy as np
import pinocchio as pin
from numpy.linalg import lstsq
from rigs import largest, product, rotated, shift, terms_at, unit
from samples import aligned

PITCH = 0.1  # pitch of screws (m/rad)


class System:
    """Mass matrix, forces and constraints of arms and object in a state.

    Attributes:
        M, h: (n, n), (n,) inertia and velocity and gravity forces of the joints.
        I, pull: (6, 6), (6,) inertia of the object, and its force at p̈ = ω̇ = 0.
        rows, right: (m, n + 6), (m,) constraints rows [q̈; p̈; ω̇] = right; rows [v; ṗ; ω] = 0.
        ends: ends of each arm's rows, after a 0.
    """

    def __init__(self, model, tips, grasps, body, *, q, v, X_WO, V_O):
        """Compute the system.

        Args:
            model: merged model of the arms.
            tips: names of the tips' frames.
            grasps: (kind, X_TO, axis (3,) in the tip's frame) of each arm.
            body: inertia of the object.
            q, v: (n,) state of the joints.
            X_WO, V_O: pose and twist (6,) of the object.
        """
        data = terms_at(model, q, v)
        self.M = np.array(data.M)
        self.h = np.array(data.nle)
        inertia = rotated(X_WO.rotation).act(body)
        V = pin.Motion(V_O)
        self.I = inertia.matrix()
        self.pull = self.I @ (model.gravity.vector + product(V_O)) - V.cross(inertia * V).vector
        rows = []
        right = []
        self.ends = [0]
        for tip, (kind, X_TO, axis) in aligned(tips, grasps):
            at = (model, data, model.getFrameId(tip), pin.LOCAL)
            J = pin.getFrameJacobian(*at)
            of_tip = pin.getFrameVelocity(*at)
            a = pin.getFrameAcceleration(*at)
            to_tip = data.oMf[at[2]].inverse()
            of_O = (to_tip * shift(X_WO.translation)).action
            # relative to the tip the grasp moves with V_rel, whose rate is of_O a_O - J q̈ + rest
            V_rel = pin.Motion(of_O @ V_O) - of_tip
            rest = -of_O @ product(V_O) - a.vector - of_tip.cross(V_rel).vector
            for s, bend in derivatives(kind, axis, to_tip * X_WO * X_TO.inverse(), V_rel):
                rows.append(np.append(-s @ J, s @ of_O))
                right.append(-bend - s @ rest)
            self.ends.append(len(rows))
        self.rows = np.reshape(rows, (-1, model.nv + 6))
        self.right = np.array(right)


def derivatives(kind, axis, X, V):
    """Yield gradient (6,) and second derivative of each expression that a grasp keeps at zero.

    The second time derivative is that at constant V.

    Args:
        kind: kind of the grasp.
        axis: (3,) axis in the frame of the tip.
        X, V: pose and twist of the grasped frame in the frame of the tip.
    """
    p = X.translation
    w = V.angular
    p_dot = V.linear + np.cross(w, p)
    E = np.eye(3)
    if kind in ("rigid", "hinge", "ball"):
        lines = E
    else:
        lines = {"plane": [axis], "screw": [*across(axis), axis]}.get(kind, across(axis))
    for s in lines:  # s · p = 0, along the axis of a screw the pitch times the angle
        turn = PITCH * s if kind == "screw" and s is axis else 0.0
        yield (np.append(s, np.cross(p, s) - turn), s @ np.cross(w, p_dot))
    pairs = []
    if kind in ("rigid", "slide"):
        pairs = aligned(E, E[[1, 2, 0]])
    elif kind != "ball":
        pairs = [(s, axis) for s in across(axis)]
    for s, of_object in pairs:  # directions in tip and object that stay perpendicular
        b = X.rotation @ of_object
        yield (np.append(np.zeros(3), np.cross(b, s)), s @ np.cross(w, np.cross(w, b)))


def solve(K, y):
    """Solve K x = y by least squares, equilibrated and refined, since loops may be redundant.

    Returns:
        x, and the largest scaled residual.
    """
    scale = 1.0 / np.sqrt(np.abs(K).max(axis=1))
    Ks = K * np.outer(scale, scale)
    x = scale * lstsq(Ks, scale * y, rcond=1e-13)[0]
    for _ in range(3):
        x += scale * lstsq(Ks, scale * (y - K @ x), rcond=1e-13)[0]
    return (x, largest(scale * (K @ x - y)))


def across(axis):
    """Two perpendicular unit vectors (3,) that are perpendicular to an axis (3,)."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first = unit(first)
    return (first, np.cross(unit(axis), first))
