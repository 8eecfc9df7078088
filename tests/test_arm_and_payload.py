"""One arm's operational-space terms, the held object and the environment, each by a second route.

Arms: eq. 13 says Λ a + μ + p = f whenever M q̈ + h = Jᵀf and a = J q̈ + γ; with fewer joints than
six this holds on range(J) only, and that is all that is asked of it. Drift: Pinocchio's
acceleration pass and finite differences. Wrist and object: recursive Newton–Euler. The law's own
function is asked, on random numbers and within `ClosedChain.state`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from arm_door import terms_of
from urdf_numbers import element, written_inertia

from osc_contact import robots
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.chain_model import columns_at, outboard_links
from osc_contact.dynamics.chain_state import ArmTerms, ChainState
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Environment
from osc_contact.dynamics.payload import RigidObject
from osc_contact.errors import InvalidInputError, ModelError

SEEDS = range(4)
FINE = 1e-9  # rank tolerance under which random arms lose no direction
GRAVITY = np.array([0.3, -0.2, -9.81])


# Arms made of random numbers ----------------------------------------------------------------------


@dataclass(frozen=True)
class Numbers:
    """What the law needs to know of an arm."""

    J: np.ndarray
    gamma: np.ndarray
    M: np.ndarray
    h: np.ndarray
    g: np.ndarray
    Lambda_o: np.ndarray
    tolerance: float = FINE

    @classmethod
    def random(cls, seed: int, n: int, rank: int | None = None) -> Numbers:
        rng = np.random.default_rng([seed, n])
        J = rng.normal(size=(6, n))
        if rank is not None:
            J = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, n))
        X = rng.normal(size=(n, n))
        M = X @ X.T + 0.3 * np.eye(n)
        return cls(
            J, rng.normal(size=6), M, rng.normal(size=n), rng.normal(size=n), body(seed).matrix()
        )

    @property
    def terms(self) -> ArmTerms:
        return terms_of(self.J, self.gamma, self.M, self.h, self.g, self.Lambda_o, self.tolerance)

    def moved(self, X: np.ndarray, X_f: np.ndarray) -> Numbers:
        """The same arm and object in other coordinates: motions by X, forces by X_f."""
        Lambda_o = X_f @ self.Lambda_o @ np.linalg.inv(X)
        return replace(
            self, J=X @ self.J, gamma=X @ self.gamma, Lambda_o=0.5 * (Lambda_o + Lambda_o.T)
        )


def body(seed: int) -> pin.Inertia:
    """A body of 0.5 to 5 kg about 0.3 m across, its centre of mass off the origin."""
    rng = np.random.default_rng([seed, 1])
    points = rng.normal(size=(8, 3)) * 0.15
    mass = rng.uniform(0.5, 5.0)
    spread = points - points.mean(axis=0)
    second_moments = mass / 8 * spread.T @ spread
    tensor = np.trace(second_moments) * np.eye(3) - second_moments
    return pin.Inertia(mass, points.mean(axis=0) + rng.normal(size=3) * 0.1, tensor)


def in_range(terms: ArmTerms, seed: int, k: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Random motions S of the tip and joint motions W that make them, J W = S."""
    W = np.random.default_rng([seed, 2]).normal(size=(terms.J.shape[1], k))
    return terms.J @ W, W


def close(got: np.ndarray, want: np.ndarray, tolerance: float = 1e-8) -> None:
    got, want = np.asarray(got), np.asarray(want)
    assert got.shape == want.shape
    scale = max(1.0, np.abs(want).max(initial=0.0))
    np.testing.assert_allclose(got, want, rtol=0, atol=tolerance * scale)


@pytest.mark.parametrize("n", [6, 7])
@pytest.mark.parametrize("seed", SEEDS)
def test_six_joints_and_more_give_the_textbook_terms(seed: int, n: int) -> None:
    arm = Numbers.random(seed, n)
    t, M_inv = arm.terms, np.linalg.inv(arm.M)
    Lambda = np.linalg.inv(arm.J @ M_inv @ arm.J.T)
    J_bar = M_inv @ arm.J.T @ Lambda
    close(t.Phi, arm.J @ M_inv @ arm.J.T)
    close(t.Lambda, Lambda)
    close(t.J_bar, J_bar)
    close(t.mu, J_bar.T @ (arm.h - arm.g) - Lambda @ arm.gamma)
    close(t.p, J_bar.T @ arm.g)
    assert t.C.shape == (6, 0) and t.rank == 6
    close(arm.J @ t.J_bar, np.eye(6))
    for kept in ("J", "gamma", "M"):
        np.testing.assert_array_equal(getattr(t, kept), getattr(arm, kept))


@pytest.mark.parametrize("n", range(1, 9))
@pytest.mark.parametrize("seed", SEEDS)
def test_equation_13_holds_for_every_motion_the_arm_can_make(seed: int, n: int) -> None:
    arm = Numbers.random(seed, n)
    t = arm.terms
    f = np.random.default_rng([seed, 3]).normal(size=6)
    qdd = np.linalg.solve(arm.M, arm.J.T @ f - arm.h)
    a = arm.J @ qdd + arm.gamma
    S, _ = in_range(t, seed)
    close(S.T @ (t.Lambda @ a + t.mu + t.p), S.T @ f)


@pytest.mark.parametrize("n", range(1, 9))
@pytest.mark.parametrize("seed", SEEDS)
def test_terms_on_the_range_of_J(seed: int, n: int) -> None:
    arm = Numbers.random(seed, n)
    t, rank = arm.terms, min(n, 6)
    S, W = in_range(t, seed)
    assert t.C.shape == (6, 6 - rank)
    assert np.abs(t.C.T @ arm.J).max(initial=0.0) < 1e-12 * (1 + np.abs(t.C).max(initial=0.0))
    assert np.linalg.matrix_rank(t.C) == 6 - rank
    close(t.Phi, arm.J @ np.linalg.solve(arm.M, arm.J.T))
    close(arm.J @ t.J_bar @ S, S)
    if n <= 6:  # one joint motion per tip motion
        close(t.J_bar @ S, W)
        close(S.T @ t.Lambda @ S, W.T @ arm.M @ W)
        close(S.T @ t.p, W.T @ arm.g)
    close(t.Phi @ t.Lambda @ t.Phi, t.Phi)
    assert t.rank == rank


@pytest.mark.parametrize(("n", "rank"), [(6, 5), (7, 5), (6, 3), (4, 3)])
@pytest.mark.parametrize("seed", SEEDS)
def test_singular_postures_lose_the_directions_J_loses(seed: int, n: int, rank: int) -> None:
    arm = replace(Numbers.random(seed, n, rank), tolerance=1e-6)
    t = arm.terms
    assert t.C.shape == (6, 6 - rank)
    assert np.abs(t.C.T @ arm.J).max() < 1e-9
    S, _ = in_range(t, seed, 3)
    close(arm.J @ t.J_bar @ S, S)
    close(t.Phi @ t.Lambda @ t.Phi, t.Phi)
    assert np.linalg.matrix_rank(t.Lambda, rtol=1e-9) == rank


def frame_change(seed: int) -> tuple[np.ndarray, np.ndarray]:
    pin.seed(seed)
    X = pin.SE3.Random()
    return X.toActionMatrix(), X.toDualActionMatrix()


def millimetres(_: int) -> tuple[np.ndarray, np.ndarray]:
    """m → mm with joint units and joules kept: forces in J/mm."""
    return np.diag([1e3] * 3 + [1.0] * 3), np.diag([1e-3] * 3 + [1.0] * 3)


@pytest.mark.parametrize("change", [frame_change, millimetres])
@pytest.mark.parametrize(("n", "rank"), [(5, None), (6, None), (7, None), (7, 5)])
@pytest.mark.parametrize("seed", SEEDS)
def test_terms_transform_as_their_kind(seed: int, n: int, rank: int | None, change: object) -> None:
    assert callable(change)
    arm = replace(Numbers.random(seed, n, rank), tolerance=1e-6)
    X, X_f = change(seed)
    X_inv, X_f_inv = np.linalg.inv(X), np.linalg.inv(X_f)
    old, new = arm.terms, arm.moved(X, X_f).terms
    assert new.rank == old.rank
    close(X_inv @ new.Phi @ X_f, old.Phi)
    close(X_f_inv @ new.Lambda @ X, old.Lambda)
    close(new.J_bar @ X, old.J_bar)
    close(X_f_inv @ new.mu, old.mu)
    close(X_f_inv @ new.p, old.p)
    assert new.C.shape == old.C.shape
    assert np.abs((X_f_inv @ new.C).T @ arm.J).max(initial=0.0) < 1e-9


@pytest.mark.parametrize("locked_mass_ratio", [1e3, 1e5, 1e7, 1e9])
def test_tolerance_is_a_ratio_of_inertias(locked_mass_ratio: float) -> None:
    """A gantry whose z axis carries a heavy motor: locked once it outweighs the object 1/tol²."""
    M = np.diag([1.0, 1.0, 2.0 * locked_mass_ratio])
    arm = Numbers(
        np.eye(6)[:, :3], np.zeros(6), M, np.zeros(3), np.zeros(3), 2.0 * np.eye(6), tolerance=1e-3
    )
    t = arm.terms
    assert t.C.shape[1] == (3 if locked_mass_ratio < 1e6 else 4)


# Drift --------------------------------------------------------------------------------------------


def random_arm(seed: int, n: int = 7) -> pin.Model:
    """A serial arm with revolute and prismatic joints about random axes, nothing aligned."""
    rng = np.random.default_rng([seed, 5])
    pin.seed(seed)
    model, joint = pin.Model(), 0
    for i in range(n):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        kind = pin.JointModelPrismaticUnaligned if i in (2, 5) else pin.JointModelRevoluteUnaligned
        X = pin.SE3.Random()
        X.translation = 0.4 * X.translation
        joint = model.addJoint(joint, kind(axis), X, f"joint{i}")
        model.appendBodyToJoint(joint, body(seed + i), pin.SE3.Identity())
    tip = pin.SE3.Random()
    model.addFrame(pin.Frame("tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    return model


def motion(model: pin.Model, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([seed, 6])
    return rng.uniform(-1, 1, size=model.nq), rng.normal(size=model.nv)


def at_tip(model: pin.Model, q: np.ndarray, v: np.ndarray) -> ChainState:
    """The arm by itself: its tip is the object."""
    return ClosedChain([Arm.from_urdf(model, name="arm", tip="tip")]).state(q, v)


def tip_columns(model: pin.Model, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian columns of the tip at its own origin, world axes, and that origin."""
    data = model.createData()
    J = np.array(pin.computeJointJacobians(model, data, q))
    pin.updateFramePlacements(model, data)
    O = data.oMf[model.getFrameId("tip")].translation.copy()  # noqa: E741
    return columns_at(J, O), O


@pytest.mark.parametrize("seed", SEEDS)
def test_columns_at_are_pinocchios_frame_jacobian(seed: int) -> None:
    model = random_arm(seed)
    q, _ = motion(model, seed)
    data = model.createData()
    J = pin.computeFrameJacobian(model, data, q, model.getFrameId("tip"), pin.LOCAL_WORLD_ALIGNED)
    close(tip_columns(model, q)[0], J, 1e-13)


@pytest.mark.parametrize("seed", SEEDS)
def test_drift_is_pinocchios_spatial_acceleration_without_joint_acceleration(seed: int) -> None:
    model = random_arm(seed)
    q, v = motion(model, seed)
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.updateFramePlacements(model, data)
    at = (model, data, model.getFrameId("tip"), pin.LOCAL_WORLD_ALIGNED)
    gamma = at_tip(model, q, v).arms[0].gamma
    close(gamma, pin.getFrameAcceleration(*at).vector, 1e-12)
    classical = pin.getFrameClassicalAcceleration(*at).vector
    assert np.abs(gamma - classical).max() > 1e-2  # the two kinds differ by ω × v


def test_one_joint_does_not_drift() -> None:
    state = at_tip(random_arm(0, 1), np.array([0.3]), np.array([2.0]))
    np.testing.assert_array_equal(state.arms[0].gamma, np.zeros(6))


# Arms from files ----------------------------------------------------------------------------------


def scara(**options: object) -> Arm:
    return Arm.from_urdf(robots.urdf_path("scara_left.urdf"), name="left", tip="tool", **options)


def panda(**options: object) -> Arm:
    file, _ = robots.find_robot("panda")
    return Arm.from_urdf(file, name="panda", tip="panda_hand_tcp", **options)


def test_fingers_are_locked_and_the_arm_stays() -> None:
    whole = robots.load_model(robots.find_robot("panda")[0])
    arm = panda()
    assert list(arm.model.names)[1:] == [f"panda_joint{i}" for i in range(1, 8)]
    assert pin.computeTotalMass(arm.model) == pytest.approx(pin.computeTotalMass(whole))
    q, v = motion(arm.model, 0)
    fingers = whole.nq - 7
    data, data_whole = arm.model.createData(), whole.createData()
    close(
        pin.rnea(arm.model, data, q, v, v),
        pin.rnea(whole, data_whole, *(np.append(x, np.zeros(fingers)) for x in (q, v, v)))[:7],
    )


def test_a_joint_can_be_held_where_it_is_told() -> None:
    arm, whole = scara(locked={"joint3": 0.12}), scara()
    assert list(arm.model.names)[1:] == ["joint1", "joint2", "joint4", "hinge"]
    q = np.array([0.3, -0.7, 0.2, 0.1])
    tips = []
    for model, at in ((arm.model, q), (whole.model, np.insert(q, 2, 0.12))):
        data = model.createData()
        pin.framesForwardKinematics(model, data, at)
        tips.append(data.oMf[model.getFrameId("tool")].homogeneous)
    close(tips[0], tips[1], 1e-12)


def test_mass_factor_scales_the_joint_space_dynamics() -> None:
    one, heavy = scara(), scara(mass_factor=1.25)
    q, v = motion(one.model, 1)
    for law in (pin.crba, lambda m, d, q: pin.rnea(m, d, q, v, v)):
        results = [law(arm.model, arm.model.createData(), q) for arm in (heavy, one)]
        close(results[0], 1.25 * results[1], 1e-12)
    sensor, tip = (one.model.getFrameId(name) for name in ("wrist_sensor", "tool"))
    weighed = [outboard_links(arm.model, sensor, tip) for arm in (heavy, one)]
    for a, b in zip(*weighed, strict=True):
        assert a.inertia.mass == pytest.approx(1.25 * b.inertia.mass)


@pytest.mark.parametrize(
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
def test_impossible_arms_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Arm.from_urdf(
            robots.urdf_path("scara_left.urdf"), name="left", **{"tip": "tool", **options}
        )


# What hangs beyond the wrist sensor ---------------------------------------------------------------


@pytest.mark.parametrize("sensor", ["wrist_sensor", "wrist_sensor_joint"])
def test_outboard_links_of_the_scara(sensor: str) -> None:
    """Gripper base with joint 4, finger with the hinge; the flange is inboard of the sensor."""
    arm = scara()
    base, finger = outboard_links(
        arm.model, arm.model.getFrameId(sensor), arm.model.getFrameId("tool")
    )
    assert [arm.model.names[link.joint] for link in (base, finger)] == ["joint4", "hinge"]
    assert (base.inertia.mass, finger.inertia.mass) == pytest.approx((0.35, 0.15))
    mounted = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.02])).act(
        written_inertia(element("scara_left", "wrist_sensor"))
    )
    close(base.inertia.matrix(), mounted.matrix(), 1e-12)
    own = written_inertia(element("scara_left", "finger"))
    close(finger.inertia.matrix(), own.matrix(), 1e-12)


@pytest.mark.parametrize("sensor", ["panda_link8", "panda_hand"])
def test_outboard_links_of_the_panda(sensor: str) -> None:
    """Hand and locked fingers: everything on joint 7 but its own link."""
    arm, (file, _) = panda(), robots.find_robot("panda")
    model = arm.model
    (hand,) = outboard_links(model, model.getFrameId(sensor), model.getFrameId("panda_hand_tcp"))
    assert model.names[hand.joint] == "panda_joint7"
    assert hand.inertia.mass == pytest.approx(0.73 + 2 * 0.015)
    rest = model.inertias[hand.joint].matrix() - hand.inertia.matrix()
    close(rest, written_inertia(element(file, "panda_link7")).matrix(), 1e-12)


def test_outboard_links_survive_the_merging_of_arms() -> None:
    merged = pin.appendModel(scara().model, panda().model, 0, pin.SE3.Identity())
    found = outboard_links(merged, merged.getFrameId("wrist_sensor"), merged.getFrameId("tool"))
    assert [link.inertia.mass for link in found] == pytest.approx([0.35, 0.15])
    tip = merged.getFrameId("panda_hand_tcp")
    (hand,) = outboard_links(merged, merged.getFrameId("panda_hand"), tip)
    assert hand.inertia.mass == pytest.approx(0.76)


@pytest.mark.parametrize(("make", "sensor"), [(scara, "wrist_sensor"), (panda, "panda_hand")])
@pytest.mark.parametrize("seed", SEEDS)
def test_outboard_terms_are_what_newton_and_euler_weigh(
    seed: int, make: object, sensor: str
) -> None:
    """Strip the arm of all mass inboard of the sensor; its joint then carries the answer."""
    assert callable(make)
    arm: Arm = make(wrist_sensor=sensor)
    chain = ClosedChain([arm], rank_tolerance=FINE, allow_unactuated=True)
    chain.model.gravity.linear = GRAVITY
    model = arm.model.copy()
    model.gravity.linear = GRAVITY
    tip = model.getFrameId(arm.tip)
    links = outboard_links(model, model.getFrameId(sensor), tip)
    light = model.copy()
    for j in range(model.njoints):
        light.inertias[j] = pin.Inertia.Zero()
    for link in links:
        light.inertias[link.joint] = link.inertia
    rng = np.random.default_rng([seed, 8])
    q, v, qdd = rng.uniform(-1, 1, size=(3, model.nv))
    data = model.createData()
    pin.computeAllTerms(model, data, q, v)
    pin.updateFramePlacements(model, data)
    O = data.oMf[tip].translation  # noqa: E741
    state = chain.state(q, v)
    t = state.arms[0]
    if model.nv > 6:  # only the least-energy joint motion is a function of the object's motion
        qdd = t.J_bar @ (t.J @ qdd)
    weighed = light.createData()
    pin.rnea(light, weighed, q, v, qdd)
    joint = links[0].joint
    X = data.oMi[joint]
    carried = pin.SE3(X.rotation, X.translation - O).act(weighed.f[joint]).vector
    close(state.Lambda_out @ (t.J @ qdd + t.gamma) + state.bias_out, carried, 1e-9)


# The object ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
def test_object_terms_are_newton_euler_of_a_free_body(seed: int) -> None:
    pin.seed(seed)
    inertia, X_WO = body(seed), pin.SE3.Random()
    V, a = np.random.default_rng([seed, 9]).normal(size=(2, 6))
    terms = RigidObject(inertia).terms(X_WO, V, GRAVITY)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    axes = pin.SE3(X_WO.rotation, np.zeros(3))

    def wrench(V: np.ndarray, a: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        model.gravity.linear = gravity
        local = [axes.actInv(pin.Motion(m)).vector for m in (V, a)]
        q = pin.SE3ToXYZQUAT(X_WO)
        tau = pin.rnea(model, model.createData(), q, *local)
        return axes.act(pin.Force(tau)).vector

    zero, still = np.zeros(6), np.zeros(3)
    close(terms.Lambda @ a, wrench(zero, a, still), 1e-12)
    close(terms.mu, wrench(V, zero, still), 1e-12)
    close(terms.p, wrench(zero, zero, GRAVITY), 1e-12)
    close(terms.Lambda @ a + terms.mu + terms.p, wrench(V, a, GRAVITY), 1e-12)


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_scaled_object_keeps_its_shape(factor: float) -> None:
    held = RigidObject(body(0))
    scaled = held.scaled(factor)
    close(scaled.inertia.matrix(), factor * held.inertia.matrix(), 1e-13)
    np.testing.assert_array_equal(scaled.inertia.lever, held.inertia.lever)


@pytest.mark.parametrize(
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
def test_impossible_objects_are_refused(mass: float, principal: list[float], message: str) -> None:
    tensor = np.diag(principal)
    if np.isfinite(tensor).all():
        turn = pin.exp3(np.array([0.3, -0.4, 0.5]))
        tensor = turn @ tensor @ turn.T
    inertia = pin.Inertia.Zero()
    inertia.mass, inertia.inertia = mass, 0.5 * (tensor + tensor.T)
    with pytest.raises(ModelError, match=message):
        RigidObject(inertia)


def test_lever_with_nan_is_refused_and_thin_rods_are_not() -> None:
    inertia = body(0)
    inertia.lever = np.array([0.0, np.nan, 0.0])
    with pytest.raises(ModelError, match="NaN or inf"):
        RigidObject(inertia)
    RigidObject(pin.Inertia(1.0, np.zeros(3), np.diag([1e-9, 1.0, 1.0])))
    RigidObject(pin.Inertia(1.0, np.ones(3), np.diag([1.0, 1.0, 2.0])))  # a flat disc
    for factor in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ModelError, match=f"factor {factor}"):
            RigidObject(body(0)).scaled(factor)


# The environment ----------------------------------------------------------------------------------


def test_fixed_environment_is_all_zero() -> None:
    for fixed in (Environment.fixed(), Environment()):
        assert not (fixed.Phi_e.any() or fixed.b_e.any() or fixed.V_e.any())


@pytest.mark.parametrize("seed", range(24))
def test_any_mobility_a_mechanism_can_have_is_accepted(seed: int) -> None:
    """Φ = X J M⁻¹Jᵀ Xᵀ of rank 1 to 6, given at another point, with its rounding errors."""
    rng = np.random.default_rng([seed, 11])
    turns = rng.integers(0, 4, size=3) * np.pi / 2 if seed % 2 else rng.uniform(-3, 3, size=3)
    X = pin.SE3(pin.rpy.rpyToMatrix(turns), rng.integers(-9, 9, size=3) / 10).toActionMatrix()
    k = seed % 6 + 1
    J = rng.normal(size=(6, k)) * 10 ** rng.uniform(-1, 1, size=k)
    if seed % 3 == 0:  # axes along the coordinates: whole rows are nothing but rounding
        J = np.eye(6)[:, rng.permutation(6)[:k]] * 10 ** rng.uniform(-1, 1, size=k)
    Phi = np.linalg.inv(X) @ (X @ (J @ J.T) @ X.T) @ np.linalg.inv(X).T
    np.testing.assert_array_equal(Environment(Phi).Phi_e, Phi)


def test_impossible_environments_are_refused() -> None:
    held = np.linalg.inv(body(0).matrix())
    Environment(held, np.ones(6), np.ones(6))
    skewed = held.copy()
    skewed[0, 4] += 1e-6 * held[4, 4]
    with pytest.raises(InvalidInputError, match="not symmetric"):
        Environment(skewed)
    for wrong in (
        -held,
        np.diag([1.0, 1, 1, 1, 1, -1e-3]),
        np.diag([0.0, 0, 0, 0, 0, -1.0]),
        np.eye(6) + 2 * (np.eye(6, k=3) + np.eye(6, k=-3)),
        np.eye(6, k=3) + np.eye(6, k=-3),
    ):
        with pytest.raises(InvalidInputError, match="not positive semidefinite"):
            Environment(wrong)
    with pytest.raises(InvalidInputError, match=r"Phi_e: expected shape \(6, 6\)"):
        Environment(np.zeros(6))  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="b_e: element"):
        Environment(b_e=np.full(6, np.nan))
    with pytest.raises(InvalidInputError, match=r"V_e: expected shape \(6\), got \(3,\)"):
        Environment(V_e=np.zeros(3))
