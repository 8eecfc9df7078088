"""Arms from files, the links beyond their sensors, the held object and the environment.

The terms of arms are judged in `test_chain_state.py`.
"""

import numpy as np
import pinocchio as pin
from complaints import model_error
from numpy.linalg import inv
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from rigs import assert_close, panda_arm, placed, pose_at, refused, vector
from robot_numbers import element, written_inertia
from samples import aligned, parametrize

import osc_contact as osc
from osc_contact import robots
from osc_contact.dynamics.merged_model import outboard_links


def motion(model, seed):
    rng = default_rng([seed, 6])
    return (rng.uniform(-1, 1, model.nq), rng.standard_normal(model.nv))


# Arms from files ----------------------------------------------------------------------------------


def scara(**options):
    how = {"name": "left", "tip": "tool"} | options
    return osc.Arm.from_urdf(robots.urdf_path("scara_left"), **how)


def test_locked_joints_stay_where_they_are_held():
    """Fingers of the Panda, which need no word, and a joint of the SCARA."""
    panda = robots.load_model(robots.find_robot("panda")[0])
    fingers = {f"panda_finger_joint{k}": 0.0 for k in (1, 2)}
    lifted = {"joint3": 0.12}
    for whole, arm, held, tip in (
        (panda, panda_arm(), fingers, "panda_hand_tcp"),
        (scara().model, scara(locked=lifted), lifted, "tool"),
    ):
        joints = [whole.getJointId(name) for name in held]
        q = pin.neutral(whole)
        q[[whole.joints[joint].idx_q for joint in joints]] = list(held.values())
        found = []
        for model in (arm.model, pin.buildReducedModel(whole, joints, q)):
            q, v = motion(model, 0)
            tau = pin.rnea(model, model.createData(), q, v, v)
            X = pose_at(model, q, tip).homogeneous
            found.append([*tau, *X.ravel()])
        assert list(model.names) == list(arm.model.names)
        assert_close(*found, tolerance=1e-12)


def test_mass_factor_scales_the_joint_space_dynamics():
    models = [scara(mass_factor=factor).model for factor in (1.25, 1.0)]
    q, v = motion(models[1], 1)
    heavy, one = (pin.rnea(model, model.createData(), q, v, v) for model in models)
    assert_close(heavy, 1.25 * one, tolerance=1e-12)
    ends = [[model.getFrameId(name) for name in ("wrist_sensor", "tool")] for model in models]
    weighed = [outboard_links(model, *end) for model, end in aligned(models, ends)]
    heavy, one = ([link.inertia.mass for link in links] for links in weighed)
    assert_close(heavy, 1.25 * np.array(one))


@parametrize(
    "message, options",
    {
        "tol": {"tip": "tol"},
        "no frame ''": {"tip": ""},
        "no moving joint called 'universe'": {"passive_joints": ["universe"]},
        "no moving joint called 'wrist'": {"passive_joints": ["wrist"]},
        "no moving joint called 'elbow'": {"locked": {"elbow": 0.1}},
        "wrist": {"wrist_sensor": "wrist"},
        "'hinge'": {"locked": {"hinge": 0.0}, "passive_joints": ["hinge"]},
        "no joint moves the tip frame 'base_link'": {"tip": "base_link"},
    },
)
def test_impossible_arms_are_refused(options, message):
    with model_error(message):
        scara(**options)


# What hangs beyond the wrist sensor ---------------------------------------------------------------


@parametrize("sensor", ["wrist_sensor", "wrist_sensor_joint"])
def test_outboard_links_of_the_scara(sensor):
    """Gripper base with joint 4, finger with the hinge; the flange is inboard of the sensor."""
    model = scara().model
    links = outboard_links(model, model.getFrameId(sensor), model.getFrameId("tool"))
    assert [model.names[link.joint] for link in links] == ["joint4", "hinge"]
    sensor, own = (
        written_inertia(element("scara_left", link)) for link in ("wrist_sensor", "finger")
    )
    mounted = placed(0.0, 0.0, -0.02).act(sensor)
    assert_close(
        [link.inertia.matrix() for link in links], [mounted.matrix(), own.matrix()], tolerance=1e-12
    )


@parametrize("sensor", ["panda_link8", "panda_hand"])
def test_outboard_links_of_the_panda(sensor):
    """Hand and locked fingers: everything on joint 7 but its own link."""
    model = panda_arm().model
    tip = model.getFrameId("panda_hand_tcp")
    (hand,) = outboard_links(model, model.getFrameId(sensor), tip)
    assert outboard_links(model, tip, tip) == []  # the hand is before the tip
    assert model.names[hand.joint] == "panda_joint7"
    link7 = written_inertia(element(robots.find_robot("panda")[0], "panda_link7"))
    assert_close(
        hand.inertia.matrix(), model.inertias[hand.joint].matrix() - link7.matrix(), tolerance=1e-12
    )


# The object ---------------------------------------------------------------------------------------


FLAT = [1.0, 1.0, 2.0]  #: of a disc, which is possible


@parametrize(
    "mass, principal, message",
    [
        (0.0, FLAT, "object of mass 0 kg"),
        (-1.0, FLAT, "object of mass -1 kg"),
        (1.0, [0.0, 0.0, 0.0], "all must be positive"),
        (1.0, [0.0, 1.0, 1.0], "all must be positive"),
        (1.0, [-0.1, 1.0, 1.0], "all must be positive"),
        (1.0, [1.0, 1.0, 2.1], "cannot exist"),
        (np.nan, FLAT, "NaN or inf"),
        (np.inf, FLAT, "NaN or inf"),
    ],
)
def test_impossible_objects_are_refused(mass, principal, message):
    turn = pin.exp3(vector(0.3, -0.4, 0.5))
    inertia = pin.Inertia.Zero()
    inertia.mass = mass
    inertia.inertia = turn @ np.diag(principal) @ turn.T
    with model_error(message):
        osc.RigidObject(inertia)


@parametrize("principal", [FLAT, [1e-9, 1.0, 1.0]])
def test_flat_and_thin_objects_are_possible_and_keep_their_shape_when_scaled(principal):
    held = osc.RigidObject(pin.Inertia(2.0, np.ones(3), np.diag(principal)))
    assert_close(held.scaled(0.5).inertia.matrix(), 0.5 * held.inertia.matrix(), tolerance=1e-13)
    for factor in (0.0, -1.0, np.nan, np.inf):
        with model_error(f"factor {factor}"):
            held.scaled(factor)


# The environment ----------------------------------------------------------------------------------


@parametrize("seed", range(24))
def test_any_mobility_a_mechanism_can_have_is_accepted(seed):
    """Φ = X J M⁻¹Jᵀ Xᵀ of rank 1 to 6, given at another point, with its rounding errors."""
    rng = default_rng([seed, 11])
    turns = rng.integers(0, 4, 3) * np.pi / 2 if seed % 2 else rng.uniform(-3, 3, 3)
    X = pin.SE3(pin.rpy.rpyToMatrix(turns), rng.integers(-9, 9, 3) / 10).toActionMatrix()
    k = seed % 6 + 1
    J = rng.standard_normal((6, k)) * 10 ** rng.uniform(-1, 1, k)
    if seed % 3 == 0:  # axes along the coordinates: whole rows are nothing but rounding
        J = np.eye(6)[:, rng.permutation(6)[:k]] * 10 ** rng.uniform(-1, 1, k)
    Phi = inv(X) @ (X @ (J @ J.T) @ X.T) @ inv(X).T
    assert_array_equal(osc.Environment(Phi).Phi_e, Phi)


def test_impossible_environments_are_refused():
    held = inv(pin.Inertia(2.0, np.full(3, 0.1), 0.1 * np.eye(3)).matrix())
    osc.Environment(held, np.ones(6), np.ones(6))
    skewed = held.copy()
    skewed[0, 4] += 1e-6 * held[4, 4]
    with refused("not symmetric"):
        osc.Environment(skewed)
    for wrong in (
        -held,
        np.diag([1.0, 1, 1, 1, 1, -1e-3]),
        np.eye(6) + 2 * (np.eye(6, k=3) + np.eye(6, k=-3)),
        np.eye(6, k=3) + np.eye(6, k=-3),
    ):
        with refused("not positive semidefinite"):
            osc.Environment(wrong)
