"""Random closed chains: arms of any kind around an object, each with a grasp of any kind."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
from grasp_oracle import PITCH, System, across
from rigs import placed, pose_at, shift, unit, vector

import osc_contact as osc
from osc_contact import robots

BODY = pin.Inertia(2.5, vector(0.02, -0.03, 0.01), np.diag([0.02, 0.05, 0.045]))
KINDS = ("rigid", "hinge", "ball", "slide", "cylinder")


@cache
def _urdf(kind):
    """Model, tip and passive joints of a packaged robot: "scara", "ur5" or "panda"."""
    if kind == "scara":
        return (robots.load_model(robots.urdf_path("scara_left")), "tool", ("hinge",))
    path, _ = robots.find_robot(kind)
    return (robots.load_model(path), {"ur5": "tool0", "panda": "panda_hand_tcp"}[kind], ())


def planar(joints, rng):
    """Model, tip and passive joints of a planar arm with parallel axes and random links."""
    model = pin.Model()
    last = 0
    for i in range(joints):
        at = placed(0.35 if i else 0.0, 0.0, 0.02 * i)
        last = model.addJoint(last, pin.JointModelRZ(), at, f"joint{i}")
        body = pin.Inertia(rng.uniform(1, 3), rng.uniform(-0.1, 0.1, 3), 0.02 * np.eye(3))
        model.appendBodyToJoint(last, body, placed())
    model.upperEffortLimit = np.full(joints, 80.0)
    X = placed(0.3)
    model.addFrame(pin.Frame("wrist", last, 0, placed(), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("tip", last, 0, X, pin.FrameType.OP_FRAME))
    return (model, "tip", ())


#: Number of joints, index of the elbow, and frame of the wrist sensor of each kind of arm.
ARMS = {
    "2R": (2, 1, "wrist"),
    "3R": (3, 1, "wrist"),
    "4R": (4, 1, "wrist"),
    "scara": (5, 1, "wrist_sensor"),
    "ur5": (6, 2, "wrist_3_link"),
    "panda": (7, 3, "panda_hand"),
}


def posture(kind, rng, bend):
    """Random joint positions of an arm; `bend` is the angle of the elbow (rad), singular at 0."""
    n, elbow, _ = ARMS[kind]
    q = rng.uniform(-1.5, 1.5, n)
    if kind == "scara":
        q[2:] *= [0.05, 1.0, 0.3]
    q[elbow] = -abs(bend) if kind == "panda" else bend
    return q


def motions_of(kind, axis):
    """Motions (6, k) that a grasp of a kind with an axis (3,) permits, at the tip in its axes."""
    turn = np.append(np.zeros(3), unit(axis))
    slide = np.append(unit(axis), np.zeros(3))
    columns = {
        "rigid": [],
        "hinge": [turn],
        "ball": np.eye(6)[3:],
        "slide": [slide],
        "cylinder": [turn, slide],
        "screw": [turn + PITCH * slide],
        "plane": [turn, *np.pad(across(unit(axis)), ((0, 0), (0, 3)))],
    }
    return np.reshape(columns[kind], (-1, 6)).T


def grasp_of(kind, X_TO, axis):
    """Grasp of the package of a kind, with its axis (3,) in the tip's frame; a pose if rigid."""
    if kind == "rigid":
        return X_TO
    if kind == "hinge":
        return osc.Grasp.hinge(X_TO, axis)
    return osc.Grasp.ball(X_TO) if kind == "ball" else osc.Grasp(X_TO, motions_of(kind, axis))


def slip_of(kind, axis, rng):
    """Random finite displacement that a grasp permits, as a pose in the tip's frame."""
    turn = rng.uniform(-2, 2)
    slide = rng.uniform(-0.05, 0.05)
    turns = rng.standard_normal(3)
    sizes = {
        "ball": turns,
        "slide": [slide],
        "cylinder": [turn, slide],
        "plane": [turn, *turns[:2]],
    }
    T = motions_of(kind, axis)
    return pin.exp6(T @ sizes.get(kind, [turn] * T.shape[1]))


@dataclass
class Case:
    """Closed chain in a posture.

    Attributes:
        chain: the chain.
        q: (n,) joint positions.
        X_WO: pose of the object.
        grasps: (kind, X_TO, axis) of each arm, for the oracle.
    """

    chain: osc.ClosedChain
    q: np.ndarray
    X_WO: pin.SE3
    grasps: list

    def at_rest(self):
        """State of the chain at rest, by the package."""
        return self.chain.state(self.q, X_WO=self.X_WO, V_O=np.zeros(6))

    def system(self, v, V):
        """Oracle's system of equations at joint velocities v (n,) and the object's twist V (6,)."""
        chain = self.chain
        tips = [f"{arm.name}/{arm.tip}" for arm in chain.arms]
        body = pin.Inertia.Zero() if chain.payload is None else chain.payload.inertia
        return System(chain.model, tips, self.grasps, body, q=self.q, v=v, X_WO=self.X_WO, V_O=V)


def random_case(arms, kinds, rng, bends=None, angle=1e-3, upright=False, body=BODY):
    """Random case; the bases are placed so that the random postures reach the object.

    Args:
        arms: kind of each arm, in `ARMS`.
        kinds: kind of each grasp.
        rng: random numbers.
        bends: angle of each elbow (rad); None: random, far from singular.
        angle: `angle_tolerance` of the chain (rad).
        upright: True: all axes are vertical.
        body: inertia of the object; None: no object.
    """
    X_WO = placed(*rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.5, 0.5, 3))
    parts = []
    held = []
    known = []
    positions = []
    for i, (arm, kind) in enumerate(zip(arms, kinds, strict=True)):
        model, tip, passive = planar(int(arm[0]), rng) if arm[0] in "234" else _urdf(arm)
        bend = rng.uniform(0.5, 1.5) if bends is None else bends[i]
        q = posture(arm, rng, bend)
        axis = rng.standard_normal(3)
        turned = pin.rpy.rpyToMatrix(*rng.uniform(-1.5, 1.5, 3))
        if upright:
            turned = pin.rpy.rpyToMatrix(0, 0, rng.uniform(-3, 3))
            axis = vector(0, 0, 1.0)
            X_WO = shift(X_WO.translation)
        X_TO = pin.SE3(turned, rng.uniform(-0.2, 0.2, 3))
        slip = slip_of(kind, axis, rng)
        made = osc.Arm.from_urdf(
            model,
            name=f"arm{i}",
            tip=tip,
            passive_joints=passive,
            wrist_sensor=ARMS[arm][2],
            damping=0.0,  # the oracles know none
        )
        limits = (made.model.lowerPositionLimit, made.model.upperPositionLimit)
        made.model.lowerPositionLimit = np.minimum(limits[0], q - 1.0)  # random postures know none
        made.model.upperPositionLimit = np.maximum(limits[1], q + 1.0)
        X_WT = X_WO * (slip * X_TO).inverse()
        base = X_WT * pose_at(made.model, q, tip).inverse()
        parts.append(replace(made, base=base))
        held.append(grasp_of(kind, X_TO, axis))
        known.append((kind, X_TO, unit(axis)))
        positions.append(q)
    payload = None if body is None else osc.RigidObject(body)
    chain = osc.ClosedChain(parts, held, payload, angle_tolerance=angle, allow_unactuated=True)
    return Case(chain, np.concatenate(positions), X_WO, known)
