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
"""States drawn at random are no motion: no limits but those of motors."""


def largest(x):
    """The largest absolute element, 0 of none."""
    return np.abs(x).max(initial=0.0)


def within(x, limit):
    """Whether the size of every element is."""
    return (np.abs(x) <= limit).all()


def miss(got, expected):
    """Largest difference over the largest element, or over 1 (m/s², rad/s², N) if that is more."""
    return largest(got - expected) / max(largest(expected), 1.0)


def assert_near(got, expected, *, atol=0.0, rtol=1e-7, name=""):
    """Assert |got − expected| ≤ atol + rtol |expected| element by element.

    Args:
        got, expected: arrays, or nested lists of numbers. name: shown where they differ.
    """
    assert_allclose(got, expected, rtol=rtol, atol=atol, err_msg=name)


def assert_close(got, expected, *, tolerance=1e-8, name=""):
    """Assert |got − expected| ≤ tolerance max(1, largest |expected|) element by element.

    Args:
        got, expected: arrays, or nested lists of numbers. name: shown where they differ.
    """
    assert_allclose(
        got, expected, rtol=0, atol=tolerance * max(1.0, largest(expected)), err_msg=name
    )


def vector(*numbers):
    return np.array(numbers, dtype=float)


def unit(x):
    return x / np.linalg.norm(x)


def direction(rng):
    return unit(rng.standard_normal(3))


def any_rotation(rng):
    return pin.exp3(rng.standard_normal(3))


def pose_of(rng):
    return pin.SE3(any_rotation(rng), rng.standard_normal(3))


def shift(p):
    """A pose that turns nothing."""
    return pin.SE3(np.eye(3), np.array(p, dtype=float))


def rotated(R):
    """A pose that moves nothing."""
    return pin.SE3(R, np.zeros(3))


def displacement(start, end):
    """(6,) from one pose to another: of the origin, and turned, in world axes."""
    turn = pin.log3(end.rotation @ start.rotation.T)
    return np.append(end.translation - start.translation, turn)


def data_at(model, q, *rates):
    """Pinocchio's data with the poses of all frames, at q and, if given, v and a."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, *rates)
    pin.updateFramePlacements(model, data)
    return data


def pose_at(model, q, frame):
    """Pose of a frame at q."""
    return data_at(model, q).oMf[model.getFrameId(frame)]


def terms_at(model, q, v):
    """Likewise while no joint accelerates, with M, h, gravity and Jacobians."""
    data = data_at(model, q, v, np.zeros(model.nv))
    pin.computeAllTerms(model, data, q, v)
    return data


def product(V):
    """(6,) of a twist: classical less spatial acceleration."""
    return np.append(np.cross(V[3:], V[:3]), np.zeros(3))


def ticked(controller, *given):
    """Torques of a tick that is computed within all limits."""
    tau = controller.tick(*given)
    assert controller.status is osc.Status.OK, controller.reason
    return tau


def assert_derivatives(at, t, h, *atol):
    """V_D of a reference is the rate of its pose, A_D that of V_D; the reference at t."""
    before, now, after = (at(t + step) for step in (-h, 0.0, h))
    assert_allclose(now.V_D, displacement(before.X_WD, after.X_WD) / (2 * h), atol=atol[0])
    assert_allclose(now.A_D, (after.V_D - before.V_D) / (2 * h), atol=atol[1])
    return now


def held_tick(controller, words, *given):
    """Torques of a tick that is not computed, for a reason with these words."""
    tau = controller.tick(*given)
    assert controller.status is osc.Status.HELD and words in controller.reason, controller.reason
    return tau


def unloaded(q, v, arms=1):
    """Readings of wrists that feel nothing."""
    return osc.Measurement(q, v, np.zeros((arms, 6)))


ROD = pin.Inertia(1.5, vector(0.01, -0.004, 0.006), np.diag([2e-3, 0.045, 0.044]))
"""A rod whose centre of mass is off its axis, so that no term of the maths vanishes."""


def placed(x=0.0, y=0.0, z=0.0, rpy=(0.0, 0.0, 0.0)):
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), vector(x, y, z))


@cache
def scara_pair(payload=True):
    """d = 5: the paper's rig."""
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
    urdf, _ = robots.find_robot("panda")
    how = {"tip": "panda_hand_tcp", "wrist_sensor": "panda_hand"} | how
    return osc.Arm.from_urdf(urdf, name=name, base=base, **how)


@cache
def panda_pair():
    """d = 6, redundant arms."""
    arms = [
        panda_arm("left", placed(-0.55), damping=0.0),  # oracles know none
        panda_arm("right", placed(0.55, rpy=(0, 0, np.pi)), damping=0.0),
    ]
    grasps = [
        placed(x, rpy=(np.pi, 0.0, yaw)).inverse() for x, yaw in ((-0.15, 0.0), (0.15, np.pi))
    ]
    return osc.ClosedChain(arms, grasps, osc.RigidObject(ROD))


def holding_panda(arm):
    """d = 6, one redundant arm."""
    return osc.ClosedChain([arm], [placed(0.02, 0.01, 0.08)], osc.RigidObject(ROD))


@cache
def one_panda():
    return holding_panda(panda_arm(damping=0.0))


SCARA_Q = vector(1.84, -1.63, 0.12, -0.21, 0.0, 1.30, 1.63, 0.12, 0.21, 0.0)
PANDA_Q = vector(0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78)


def random_state(chain, rng):
    """(q, v) with closed loops, random pose and random velocity (up to 1 m/s and 3 rad/s)."""
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
    """(q, v, pose of the object) of such a state."""
    q, v = random_state(chain, rng)
    return (q, v, chain.state(q, v).X_WO)


def velocity_at(V, p):
    """(3,) of the point p, from where the twist V (6,) is given."""
    return V[:3] + np.cross(V[3:], p)


def object_poses(chain):
    """Pose of the object by each arm, its grasp at zero, at the positions set last."""
    grasps = zip(chain.tip_poses(), chain.grasps, strict=True)
    return [tip * grasp.X_TO for tip, grasp in grasps]


def consistent(chain, q, v, N=None):
    """The nearest velocity that keeps the loops closed (and the contacts, if N is given)."""
    pin.computeAllTerms(chain.model, chain.data, q, v)
    N = np.zeros((6, 0)) if N is None else N
    A = constraint_rows(chain, object_poses(chain)[0].translation, N)
    for _ in range(3):
        v = v - inverse_rows(chain, A, np.array(chain.data.M))[0] @ (A @ v)
    return v


def random_faces(X_WO, r, rng):
    """r vertices on faces with random (skew) normals, touching at pose X_WO."""
    pairs = []
    for i in range(r):
        vertex = rng.uniform(-0.3, 0.3, 3)
        normal = rng.standard_normal(3)
        pairs.append(osc.VertexOnFace(vertex, X_WO.act(vertex), normal, name=f"contact{i}"))
    return pairs


def contact_of(pairs, state):
    return osc.Contact.stack([pair.contact(state.X_WO, state.V_O) for pair in pairs])


def sliding(pairs, X_WO, V_O, touched, slip):
    """Point p from O, normal, and s = v_t / √(v_t² + v_0²) of each point of contact."""
    out = []
    for i, pair in enumerate(pairs):
        face = () if touched is None else (pin.SE3(np.array(touched.X_WE[i])), touched.V_E[i])
        p = pair.points_of_contact(X_WO, *face[:1])[:, 0] - X_WO.translation
        n = pair.contact(X_WO, V_O, *face).N[:3, 0]
        v = velocity_at(Bodies.at_O(X_WO, V_O, *face).V_rel, p)
        v = v - n * (n @ v)
        out.append((p, n, v / np.sqrt(v @ v + slip**2)))
    return out


def in_contact(chain, rng, r):
    """A random state in contact: (state, contact, pairs, q, v)."""
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
    """Copy of a chain with other motors."""
    parts = (chain.arms, chain.grasps, chain.payload)
    how = {"rank_tolerance": chain.rank_tolerance, "angle_tolerance": chain.angle_tolerance}
    out = osc.ClosedChain(*parts, **how)
    out.tau_max = np.asarray(tau_max, dtype=float)
    return out


def rigid_plant(q, chain, pairs=(), dt=1e-3):
    """The exact plant, at rest."""
    plant = RigidPlant(chain, pairs, dt)
    plant.reset(q)
    return plant


def without_contacts(case, **how):
    """The exact plant of a case whose object touches nothing, and a controller."""
    controller = osc.Controller(case.chain, (), case.gains, posture=case.posture, **how)
    return (rigid_plant(case.measurement.q, case.chain), controller)


def strong(chain):
    """Copy of a chain with motors in the same proportions that never reach their limits."""
    return with_motors(chain, 1e4 * chain.tau_max)


def commanded(chain, pairs, q, v, a_u, alpha_u, squeeze=5.0, **how):
    """The controller after a tick of the law that commands a_u (6,), spatial, and α_u; torques."""
    laws = osc.Laws(force=lambda *_: alpha_u, motion=lambda reference, X, V: a_u + product(V))
    # states out of any motion; what the oracles answer is without friction
    settings = {"safety": UNLIMITED, "joint_friction": False, "laws": laws, "reading": "filter"}
    how = settings | how
    controller = osc.Controller(strong(chain), pairs, **how)
    desired = osc.Reference(pin.SE3.Identity(), alpha_d=alpha_u, squeeze_d=squeeze)
    tau = controller.tick(unloaded(q, v, len(chain.arms)), desired)
    fine = (osc.Status.OK, osc.Status.DEGRADED)
    assert controller.status in fine, controller.reason
    return (controller, tau)
