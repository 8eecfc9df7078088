"""Arms from files, the links beyond their sensors, the held object and the environment.

The terms of arms are judged in `test_chain_state.py`.
"""

import numpy as np
import pinocchio as pin
from complaints import model_error
from numpy.linalg import inv
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from rigs import largest, panda_arm, refused, shift
from robot_numbers import element, written_inertia
from samples import parametrize

from osc_contact import robots
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.chain_state import RigidObject
from osc_contact.dynamics.closed_chain import outboard_links
from osc_contact.dynamics.environment import Environment

SEEDS = range(4)
GRAVITY = np.array([0.3, -0.2, -9.81])


def body(seed):
    """A body of 0.5 to 5 kg about 0.3 m across, its centre of mass off the origin."""
    rng = default_rng([seed, 1])
    points = rng.standard_normal((8, 3)) * 0.15
    mass = rng.uniform(0.5, 5.0)
    spread = points - points.mean(axis=0)
    second_moments = mass / 8 * spread.T @ spread
    tensor = np.trace(second_moments) * np.eye(3) - second_moments
    return pin.Inertia(mass, points.mean(axis=0) + rng.standard_normal(3) * 0.1, tensor)


def close(got, want, tolerance=1e-8):
    got = np.asarray(got)
    want = np.asarray(want)
    assert got.shape == want.shape
    assert_allclose(got, want, rtol=0, atol=tolerance * max(1.0, largest(want)))


def motion(model, seed):
    rng = default_rng([seed, 6])
    return rng.uniform(-1, 1, size=model.nq), rng.standard_normal(model.nv)


# Arms from files ----------------------------------------------------------------------------------


def scara(**options):
    return Arm.from_urdf(robots.urdf_path("scara_left.urdf"), name="left", tip="tool", **options)


def test_fingers_are_locked_and_the_arm_stays():
    whole = robots.load_model(robots.find_robot("panda")[0])
    arm = panda_arm()
    assert list(arm.model.names)[1:] == [f"panda_joint{i}" for i in range(1, 8)]
    assert pin.computeTotalMass(arm.model) == approx(pin.computeTotalMass(whole))
    q, v = motion(arm.model, 0)
    fingers = whole.nq - 7
    data = arm.model.createData()
    data_whole = whole.createData()
    close(
        pin.rnea(arm.model, data, q, v, v),
        pin.rnea(whole, data_whole, *(np.append(x, np.zeros(fingers)) for x in (q, v, v)))[:7],
    )


def test_a_joint_can_be_held_at_a_given_position():
    arm = scara(locked={"joint3": 0.12})
    whole = scara()
    assert list(arm.model.names)[1:] == ["joint1", "joint2", "joint4", "hinge"]
    q = np.array([0.3, -0.7, 0.2, 0.1])
    tips = []
    for model, at in ((arm.model, q), (whole.model, np.insert(q, 2, 0.12))):
        data = model.createData()
        pin.framesForwardKinematics(model, data, at)
        tips.append(data.oMf[model.getFrameId("tool")].homogeneous)
    close(tips[0], tips[1], 1e-12)


def test_mass_factor_scales_the_joint_space_dynamics():
    one = scara()
    heavy = scara(mass_factor=1.25)
    q, v = motion(one.model, 1)
    for law in (pin.crba, lambda m, d, q: pin.rnea(m, d, q, v, v)):
        results = [law(arm.model, arm.model.createData(), q) for arm in (heavy, one)]
        close(results[0], 1.25 * results[1], 1e-12)
    sensor, tip = (one.model.getFrameId(name) for name in ("wrist_sensor", "tool"))
    weighed = [outboard_links(arm.model, sensor, tip) for arm in (heavy, one)]
    for a, b in zip(*weighed, strict=True):
        assert a.inertia.mass == approx(1.25 * b.inertia.mass)


@parametrize(
    ("options", "message"),
    [
        ({"tip": "tol"}, "tol"),
        ({"passive_joints": ["wrist"]}, "no moving joint called 'wrist'"),
        ({"locked": {"elbow": 0.1}}, "no moving joint called 'elbow'"),
        ({"wrist_sensor": "wrist"}, "wrist"),
        ({"locked": {"hinge": 0.0}, "passive_joints": ["hinge"]}, "'hinge'"),
        ({"tip": "base_link"}, "no joint moves the tip frame 'base_link'"),
    ],
)
def test_impossible_arms_are_refused(options, message):
    with model_error(message):
        Arm.from_urdf(
            robots.urdf_path("scara_left.urdf"), name="left", **{"tip": "tool", **options}
        )


# What hangs beyond the wrist sensor ---------------------------------------------------------------


@parametrize("sensor", ["wrist_sensor", "wrist_sensor_joint"])
def test_outboard_links_of_the_scara(sensor):
    """Gripper base with joint 4, finger with the hinge; the flange is inboard of the sensor."""
    arm = scara()
    base, finger = outboard_links(
        arm.model, arm.model.getFrameId(sensor), arm.model.getFrameId("tool")
    )
    assert [arm.model.names[link.joint] for link in (base, finger)] == ["joint4", "hinge"]
    assert (base.inertia.mass, finger.inertia.mass) == approx((0.35, 0.15))
    mounted = shift([0.0, 0.0, -0.02]).act(written_inertia(element("scara_left", "wrist_sensor")))
    close(base.inertia.matrix(), mounted.matrix(), 1e-12)
    own = written_inertia(element("scara_left", "finger"))
    close(finger.inertia.matrix(), own.matrix(), 1e-12)


@parametrize("sensor", ["panda_link8", "panda_hand"])
def test_outboard_links_of_the_panda(sensor):
    """Hand and locked fingers: everything on joint 7 but its own link."""
    arm = panda_arm()
    (file, _) = robots.find_robot("panda")
    model = arm.model
    (hand,) = outboard_links(model, model.getFrameId(sensor), model.getFrameId("panda_hand_tcp"))
    assert model.names[hand.joint] == "panda_joint7"
    assert hand.inertia.mass == approx(0.73 + 2 * 0.015)
    rest = model.inertias[hand.joint].matrix() - hand.inertia.matrix()
    close(rest, written_inertia(element(file, "panda_link7")).matrix(), 1e-12)


# The object ---------------------------------------------------------------------------------------


@parametrize("seed", SEEDS)
def test_object_terms_are_newton_euler_of_a_free_body(seed):
    pin.seed(seed)
    inertia = body(seed)
    X_WO = pin.SE3.Random()
    V, a = default_rng([seed, 9]).standard_normal((2, 6))
    terms = RigidObject(inertia).terms(X_WO, V, GRAVITY)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    axes = pin.SE3(X_WO.rotation, np.zeros(3))

    def wrench(V, a, gravity):
        model.gravity.linear = gravity
        local = [axes.actInv(pin.Motion(m)).vector for m in (V, a)]
        tau = pin.rnea(model, model.createData(), pin.SE3ToXYZQUAT(X_WO), *local)
        return axes.act(pin.Force(tau)).vector

    zero = np.zeros(6)
    still = np.zeros(3)
    close(terms.Lambda @ a, wrench(zero, a, still), 1e-12)
    close(terms.mu, wrench(V, zero, still), 1e-12)
    close(terms.p, wrench(zero, zero, GRAVITY), 1e-12)


@parametrize("factor", [0.5, 1.0, 3.0])
def test_scaled_object_keeps_its_shape(factor):
    held = RigidObject(body(0))
    scaled = held.scaled(factor)
    close(scaled.inertia.matrix(), factor * held.inertia.matrix(), 1e-13)
    assert_array_equal(scaled.inertia.lever, held.inertia.lever)


@parametrize(
    ("mass", "principal", "message"),
    [
        (0.0, [1.0, 1.0, 1.0], "object of mass 0 kg"),
        (-1.0, [1.0, 1.0, 1.0], "object of mass -1 kg"),
        (1.0, [0.0, 0.0, 0.0], "all must be positive"),
        (1.0, [0.0, 1.0, 1.0], "all must be positive"),
        (1.0, [-0.1, 1.0, 1.0], "all must be positive"),
        (1.0, [1.0, 1.0, 2.1], "cannot exist"),
        (np.nan, [1.0, 1.0, 1.0], "NaN or inf"),
        (np.inf, [1.0, 1.0, 1.0], "NaN or inf"),
    ],
)
def test_impossible_objects_are_refused(mass, principal, message):
    tensor = np.diag(principal)
    if np.isfinite(tensor).all():
        turn = pin.exp3(np.array([0.3, -0.4, 0.5]))
        tensor = turn @ tensor @ turn.T
    inertia = pin.Inertia.Zero()
    inertia.mass = mass
    inertia.inertia = 0.5 * (tensor + tensor.T)
    with model_error(message):
        RigidObject(inertia)


def test_lever_with_nan_is_refused_and_thin_rods_are_not():
    inertia = body(0)
    inertia.lever = np.array([0.0, np.nan, 0.0])
    with model_error("NaN or inf"):
        RigidObject(inertia)
    RigidObject(pin.Inertia(1.0, np.zeros(3), np.diag([1e-9, 1.0, 1.0])))
    RigidObject(pin.Inertia(1.0, np.ones(3), np.diag([1.0, 1.0, 2.0])))  # a flat disc
    for factor in (0.0, -1.0, np.nan, np.inf):
        with model_error(f"factor {factor}"):
            RigidObject(body(0)).scaled(factor)


# The environment ----------------------------------------------------------------------------------


@parametrize("seed", range(24))
def test_any_mobility_a_mechanism_can_have_is_accepted(seed):
    """Φ = X J M⁻¹Jᵀ Xᵀ of rank 1 to 6, given at another point, with its rounding errors."""
    rng = default_rng([seed, 11])
    turns = rng.integers(0, 4, size=3) * np.pi / 2 if seed % 2 else rng.uniform(-3, 3, size=3)
    X = pin.SE3(pin.rpy.rpyToMatrix(turns), rng.integers(-9, 9, size=3) / 10).toActionMatrix()
    k = seed % 6 + 1
    J = rng.standard_normal((6, k)) * 10 ** rng.uniform(-1, 1, size=k)
    if seed % 3 == 0:  # axes along the coordinates: whole rows are nothing but rounding
        J = np.eye(6)[:, rng.permutation(6)[:k]] * 10 ** rng.uniform(-1, 1, size=k)
    Phi = inv(X) @ (X @ (J @ J.T) @ X.T) @ inv(X).T
    assert_array_equal(Environment(Phi).Phi_e, Phi)


def test_impossible_environments_are_refused():
    held = inv(body(0).matrix())
    Environment(held, np.ones(6), np.ones(6))
    skewed = held.copy()
    skewed[0, 4] += 1e-6 * held[4, 4]
    with refused("not symmetric"):
        Environment(skewed)
    for wrong in (
        -held,
        np.diag([1.0, 1, 1, 1, 1, -1e-3]),
        np.eye(6) + 2 * (np.eye(6, k=3) + np.eye(6, k=-3)),
        np.eye(6, k=3) + np.eye(6, k=-3),
    ):
        with refused("not positive semidefinite"):
            Environment(wrong)
