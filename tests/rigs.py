"""Chains and random states for the tests: the SCARA pair, two Pandas, one Panda."""

from functools import cache

import complaints
import numpy as np
import pinocchio as pin
import scenario_runs
from numpy.testing import assert_allclose

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts.pairs.pair import Bodies
from osc_contact.dynamics.assembly import close, constraint_rows, inverse_rows, reach
from osc_contact.lab.plants.rigid import RigidPlant
from osc_contact.response import require_reachable

LWA = pin.LOCAL_WORLD_ALIGNED
refused = complaints.invalid_input
rig_of = scenario_runs.rig_of
STILL = np.zeros(6)  #: a twist, or an acceleration
UNLIMITED = osc.SafetySettings.motors_only()
"""Limits of the motors only, for random states, which are not successive states of a motion."""


def largest(x):
    """Largest magnitude of the elements of an array; 0 of an empty array."""
    return np.abs(x).max(initial=0.0)


def within(x, limit):
    """True if the magnitude of every element of x is at most `limit`."""
    return (np.abs(x) <= limit).all()


def miss(got, expected):
    """Largest difference relative to the largest expected element or to 1, if that is larger."""
    return largest(got - expected) / max(largest(expected), 1.0)


def assert_near(got, expected, *, atol=0.0, rtol=1e-7, name=""):
    """Assert |got − expected| ≤ atol + rtol |expected| element by element.

    Args:
        got, expected: arrays, or nested lists of numbers.
        name: shown where they differ.
    """
    assert_allclose(got, expected, rtol=rtol, atol=atol, err_msg=name)


def assert_close(got, expected, *, tolerance=1e-8, name=""):
    """Assert |got − expected| ≤ tolerance max(1, largest |expected|) element by element.

    Args:
        got, expected: arrays, or nested lists of numbers.
        name: shown where they differ.
    """
    assert_allclose(
        got, expected, rtol=0, atol=tolerance * max(1.0, largest(expected)), err_msg=name
    )


def vector(*numbers):
    """Array of floats."""
    return np.array(numbers, dtype=float)


def unit(x):
    """Vector x/|x| of unit length."""
    return x / np.linalg.norm(x)


def direction(rng):
    """Random unit vector (3,)."""
    return unit(rng.standard_normal(3))


def any_rotation(rng):
    """Random rotation matrix (3, 3)."""
    return pin.exp3(rng.standard_normal(3))


def pose_of(rng):
    """Random pose."""
    return pin.SE3(any_rotation(rng), rng.standard_normal(3))


def shift(p):
    """Pose at the position p (3,) with the identity as rotation."""
    return pin.SE3(np.eye(3), np.array(p, dtype=float))


def rotated(R):
    """Pose at the origin with the rotation matrix R (3, 3)."""
    return pin.SE3(R, np.zeros(3))


def displacement(start, end):
    """Displacement (6,) from a pose to another: of the origin, then rotation vector, world axes."""
    turn = pin.log3(end.rotation @ start.rotation.T)
    return np.append(end.translation - start.translation, turn)


def data_at(model, q, *rates):
    """Data of Pinocchio with the poses of all frames at q and, if given, rates v and a."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, *rates)
    pin.updateFramePlacements(model, data)
    return data


def pose_at(model, q, frame):
    """Pose of a frame, given by its name, at q."""
    return data_at(model, q).oMf[model.getFrameId(frame)]


def terms_at(model, q, v):
    """Data of Pinocchio at q, v and v̇ = 0: poses of all frames, M, h, gravity and Jacobians."""
    data = data_at(model, q, v, np.zeros(model.nv))
    pin.computeAllTerms(model, data, q, v)
    return data


def product(V):
    """Difference (6,) of classical and spatial acceleration at the twist V (6,): [ω × v; 0]."""
    return np.append(np.cross(V[3:], V[:3]), np.zeros(3))


def ticked(controller, *given):
    """Torques of a tick, which has to end OK."""
    tau = controller.tick(*given)
    assert controller.status is osc.Status.OK, controller.reason
    return tau


def assert_derivatives(at, t, h, *atol):
    """Assert that V_D of a reference is the rate of its pose, and A_D the rate of V_D.

    Args:
        at: function from the time (s) to the reference.
        t: time (s).
        h: step of the differences.
        *atol: tolerances of V_D and of A_D.

    Returns:
        The reference at t.
    """
    before, now, after = (at(t + step) for step in (-h, 0.0, h))
    assert_allclose(now.V_D, displacement(before.X_WD, after.X_WD) / (2 * h), atol=atol[0])
    assert_allclose(now.A_D, (after.V_D - before.V_D) / (2 * h), atol=atol[1])
    return now


def held_tick(controller, words, *given):
    """Torques of a tick, which has to be held for a reason with the given words."""
    tau = controller.tick(*given)
    assert controller.status is osc.Status.HELD and words in controller.reason, controller.reason
    return tau


def unloaded(q, v, arms=1):
    """Measurement with wrist readings of zero."""
    return osc.Measurement(q, v, np.zeros((arms, 6)))


ROD = pin.Inertia(1.5, vector(0.01, -0.004, 0.006), np.diag([2e-3, 0.045, 0.044]))
"""Rod whose centre of mass is off its axis, so that no term of the equations vanishes."""


def placed(x=0.0, y=0.0, z=0.0, rpy=(0.0, 0.0, 0.0)):
    """Pose at a position (m) with roll, pitch and yaw (rad)."""
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), vector(x, y, z))


@cache
def scara_pair(payload=True):
    """Chain of the paper: two SCARA arms with hinges that hold a rod, d = 5."""
    arms = [
        osc.Arm.from_urdf(
            robots.urdf_path(f"scara_{side}"),
            name=side,
            tip="tool",
            base=placed(x, -0.40),
            passive_joints=["hinge"],
            wrist_sensor="wrist_sensor",
        )
        for side, x in (("left", -0.35), ("right", 0.35))
    ]
    grasps = [placed(0.15), placed(0.15, rpy=(0, 0, np.pi))]
    return osc.ClosedChain(arms, grasps, osc.RigidObject(ROD) if payload else None)


def panda_arm(name="arm", base=None, **how):
    """Panda with a wrist sensor; `how` has further arguments of `Arm.from_urdf`."""
    urdf, _ = robots.find_robot("panda")
    how = {"tip": "panda_hand_tcp", "wrist_sensor": "panda_hand"} | how
    return osc.Arm.from_urdf(urdf, name=name, base=base, **how)


@cache
def panda_pair():
    """Chain of two Pandas, redundant arms, that hold a rod, d = 6."""
    arms = [
        panda_arm("left", placed(-0.55), damping=0.0),  # oracles have no damping
        panda_arm("right", placed(0.55, rpy=(0, 0, np.pi)), damping=0.0),
    ]
    grasps = [
        placed(x, rpy=(np.pi, 0.0, yaw)).inverse() for x, yaw in ((-0.15, 0.0), (0.15, np.pi))
    ]
    return osc.ClosedChain(arms, grasps, osc.RigidObject(ROD))


def holding_panda(arm):
    """Chain of one arm that holds a rod, d = 6."""
    return osc.ClosedChain([arm], [placed(0.02, 0.01, 0.08)], osc.RigidObject(ROD))


@cache
def one_panda():
    """Chain of one Panda that holds a rod; always the same object."""
    return holding_panda(panda_arm(damping=0.0))


SCARA_Q = vector(1.84, -1.63, 0.12, -0.21, 0.0, 1.30, 1.63, 0.12, 0.21, 0.0)
PANDA_Q = vector(0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78)


def random_state(chain, rng):
    """Random joint positions and velocities (n,) with closed loops (about 1 m/s and 3 rad/s)."""
    if chain is one_panda():
        q = PANDA_Q + rng.uniform(-0.6, 0.6, 7)
        return (q, rng.standard_normal(7))
    while True:
        shift = rng.uniform(-1, 1, 3)
        if chain.nq == 10:
            rpy = (0.0, *rng.uniform(-0.5, 0.5, 2))
            X = placed(0.1 * shift[0], 0.1 * shift[1], 0.2 + 0.03 * shift[2], rpy)
            guess = SCARA_Q
        else:
            X = placed(*(0.08 * shift + [0, 0, 0.45]), rpy=rng.uniform(-0.3, 0.3, 3))
            guess = np.append(PANDA_Q, PANDA_Q) + rng.uniform(-0.3, 0.3, 14)
        try:
            q = close(chain, reach(chain, guess, X))
        except osc.ModelError:
            continue  # out of reach: draw again
        return (q, consistent(chain, q, rng.standard_normal(chain.nq)))


def posed(chain, rng):
    """Joint positions and velocities of `random_state`, and the pose of the object."""
    q, v = random_state(chain, rng)
    return (q, v, chain.state(q, v).X_WO)


def velocity_at(V, p):
    """Velocity (3,) of the point p (3,), relative to the reference point of the twist V (6,)."""
    return V[:3] + np.cross(V[3:], p)


def object_poses(chain):
    """Pose of the object by each arm, without displacements of grasps, at the chain's positions."""
    grasps = zip(chain.tip_poses(), chain.grasps, strict=True)
    return [tip * grasp.X_TO for tip, grasp in grasps]


def consistent(chain, q, v, N=None):
    """Velocity (n,) nearest to v that keeps the loops, and contacts with normals N (6, r)."""
    pin.computeAllTerms(chain.model, chain.data, q, v)
    N = np.zeros((6, 0)) if N is None else N
    A = constraint_rows(chain, object_poses(chain)[0].translation, N)
    for _ in range(3):
        v = v - inverse_rows(chain, A, np.array(chain.data.M))[0] @ (A @ v)
    return v


def random_faces(X_WO, r, rng):
    """Pairs of r vertices on faces with random normals, in contact at the object's pose X_WO."""
    pairs = []
    for i in range(r):
        vertex = rng.uniform(-0.3, 0.3, 3)
        normal = rng.standard_normal(3)
        pairs.append(osc.VertexOnFace(vertex, X_WO.act(vertex), normal, name=f"contact{i}"))
    return pairs


def contact_of(pairs, state):
    """Contact of all pairs together in a state of the chain."""
    return osc.Contact.stack([pair.contact(state.X_WO, state.V_O) for pair in pairs])


def sliding(pairs, X_WO, V_O, V_c, touched, slip):
    """List p from O (3,), normal n (3,) and direction of slip s (3,) of each contact point.

    With the commanded tangential velocity v_c, its difference e from the measured one and
    w = (v_0² + 0.03v_c²)/(v_0² + 0.03v_c² + e²), s = v/√(v² + v_0²(1 − 0.95w)²), and
    v = (1 − w) v_t + w v_c.

    Args:
        pairs: pairs with a point of contact each.
        X_WO, V_O: pose and twist of the object.
        V_c: (6,) its commanded twist, as far as the contacts permit it.
        touched: motion of the touched bodies, or None.
        slip: v_0 (m/s).
    """
    out = []
    for i, pair in enumerate(pairs):
        face = () if touched is None else (pin.SE3(np.array(touched.X_WE[i])), touched.V_E[i])
        p = pair.points_of_contact(X_WO, *face[:1])[:, 0] - X_WO.translation
        n = pair.contact(X_WO, V_O, *face).N[:3, 0]
        v_t, v_c = (
            velocity_at(Bodies.at_O(X_WO, V, *face).V_rel, p) @ (np.eye(3) - np.outer(n, n))
            for V in (V_O, V_c)
        )
        certain = slip**2 + 0.03 * v_c @ v_c
        w = certain / (certain + np.sum((v_c - v_t) ** 2))
        v = (1.0 - w) * v_t + w * v_c
        out.append((p, n, v / np.sqrt(v @ v + (slip * (1.0 - 0.95 * w)) ** 2)))
    return out


def in_contact(chain, rng, r):
    """Random state in contact with r faces: state, contact, pairs, q and v."""
    while True:
        q, v = random_state(chain, rng)
        free = chain.state(q, v)
        pairs = random_faces(free.X_WO, r, rng)
        try:
            require_reachable(free, contact_of(pairs, free))
        except osc.ContactError:
            continue
        v = consistent(chain, q, v, contact_of(pairs, free).N)
        state = chain.state(q, v)
        return (state, contact_of(pairs, state), pairs, q, v)


def touched_of(rows):
    """Measured motion of bodies, from rows (contacts, 28) of X_WE, V_E and A_E."""
    X_WE, V_E, A_E = np.split(np.array(rows), (16, 22), axis=1)
    return osc.interface.Touched(X_WE.reshape(-1, 4, 4), V_E, A_E)


def with_motors(chain, tau_max):
    """Copy of a chain with other torque limits (n_a,) (N m, N)."""
    parts = (chain.arms, chain.grasps, chain.payload)
    how = {"rank_tolerance": chain.rank_tolerance, "angle_tolerance": chain.angle_tolerance}
    out = osc.ClosedChain(*parts, **how)
    out.tau_max = np.asarray(tau_max, dtype=float)
    return out


def rigid_plant(q, chain, pairs=(), dt=1e-3):
    """Exact plant of a chain with contact pairs, at rest at q (n,)."""
    plant = RigidPlant(chain, pairs, dt)
    plant.reset(q)
    return plant


def without_contacts(case, **how):
    """Exact plant of a case without contacts, and a controller with the arguments `how`."""
    controller = osc.Controller(case.chain, (), case.gains, posture=case.posture, **how)
    return (rigid_plant(case.measurement.q, case.chain), controller)


def strong(chain):
    """Copy of a chain with 10⁴ times the torque limits, which are never reached."""
    return with_motors(chain, 1e4 * chain.tau_max)


def commanded(chain, pairs, q, v, a_u, alpha_u, squeeze=5.0, **how):
    """Run a tick of the law that commands a_u (6,), spatial, and α_u (r,).

    Args:
        chain, pairs: of the controller.
        q, v: (n,) measured state.
        squeeze: desired (N).
        **how: further arguments of the controller.

    Returns:
        The controller after the tick, and its torques.
    """
    laws = osc.Laws(force=lambda *_: alpha_u, motion=lambda reference, X, V: a_u + product(V))
    # the states are not part of a motion, and the oracles have no friction
    settings = {"safety": UNLIMITED, "joint_friction": False, "laws": laws, "reading": "filter"}
    how = settings | how
    controller = osc.Controller(strong(chain), pairs, **how)
    desired = osc.Reference(pin.SE3.Identity(), alpha_d=alpha_u, squeeze_d=squeeze)
    tau = controller.tick(unloaded(q, v, len(chain.arms)), desired)
    fine = (osc.Status.OK, osc.Status.DEGRADED)
    assert controller.status in fine, controller.reason
    return (controller, tau)
