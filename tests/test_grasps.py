"""Chains of any arms with any grasps, against one full system of equations (grasp_oracle.py)."""

import numpy as np
import pinocchio as pin
from grasp_oracle import ClosedLoop
from grasp_rigs import KINDS, grasp_of, random_case, slip_of
from numpy.linalg import cholesky, norm, svd
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark, raises
from rigs import contact_of, largest, random_faces, refused, rig_of, shift
from samples import first
from test_decoupling import commanded

import osc_contact as osc
from osc_contact.dynamics.assembly import close, object_pose, reach
from osc_contact.dynamics.grasp import GRASPS, moved, register_grasp
from osc_contact.plants.rigid import RigidPlant
from osc_contact.scenarios.bodies import GRASP_TYPES

ARMS = ("scara", "ur5", "panda", "2R", "3R")
NOTHING = osc.Contact(np.zeros((6, 0)))
RTOL = 1e-9


def miss(got, want, least=1.0):
    """Largest difference over the largest element, or over 1 (m/s², rad/s², N) if that is more."""
    return largest(got - want) / max(largest(want), least)


def draw(rng, arms=ARMS, kinds=KINDS, least=1, most=4, **options):
    n = rng.integers(least, most + 1)
    return random_case(list(rng.choice(arms, n)), list(rng.choice(kinds, n)), rng, **options)


def touching(case, rng, most=2):
    """Faces on which this chain can push in earnest, none if it cannot."""
    still = case.chain.state(case.q, np.zeros(case.chain.nq), case.X_WO, np.zeros(6))
    pairs = random_faces(case.X_WO, min(most, still.d), rng)
    if pairs:
        N = contact_of(pairs, still).N
        felt = svd(cholesky(still.metric).T @ still.S)[0][:, : still.d]
        N = felt.T @ np.linalg.solve(cholesky(still.metric), N)
        if svd(N)[1][-1] < 0.05 * norm(N):
            return [], NOTHING.N
    return pairs, contact_of(pairs, still).N


def moving(case, pairs, N, rng):
    """(q̇, V_O, state, contact) at a random velocity that keeps grasps and contacts."""
    v, V = case.moving(rng, N)
    state = case.chain.state(case.q, v, case.X_WO, V)
    return v, V, state, contact_of(pairs, state)


def forces(case, tau):
    out = np.zeros(case.chain.nq)
    out[case.chain.actuated] = tau
    return out


def any_torques(case, rng):
    return rng.standard_normal(case.chain.n_a) * 20.0


def solved(case, v, V, tau, contact=NOTHING):
    """The full system's answer."""
    return case.system(v, V).solve(forces(case, tau), contact.N, contact.n_gamma)


BARE = [(arm,) for arm in ARMS for _ in range(4)]  # nothing held
EIGHT = ("scara", "ur5", "panda", "3R", "panda", "ur5", "ur5", "panda")
GRIPS = ("ball", "hinge", "rigid", "ball", "cylinder", "slide", "ball", "hinge")


def many_cases(rng):
    """Random chains of 1 to 4 arms with any grasps, of eight arms, and bare tips."""
    yield from (draw(rng) for _ in range(40))
    yield from (random_case(EIGHT, GRIPS, rng) for _ in range(2))
    yield from (random_case(arm, ["rigid"], rng, body=None) for arm in BARE)


def test_motion_and_contact_forces_agree_with_the_full_system():
    """Eqs. 13–20: grasps that turn, slide and hold."""
    rng = default_rng(1)
    seen = {"unactuated": 0, "untold": 0, "contacts": 0, "d": set()}
    for case in many_cases(rng):
        for _ in range(3):
            pairs, N = touching(case, rng)
            v, V, state, contact = moving(case, pairs, N, rng)
            tau = any_torques(case, rng)
            oracle = solved(case, v, V, tau, contact)
            assert oracle.residual < 1e-9
            got = osc.contact_response(state, contact, tau=tau)
            assert miss(got.acceleration, oracle.a_object) < RTOL
            assert miss(got.alpha, oracle.alpha) < RTOL
            seen["unactuated"] += state.unactuated.shape[1] > 0
            seen["contacts"] += contact.r > 0
            seen["d"].add(state.d)
            try:
                told = case.chain.state(case.q, v)
            except osc.ModelError as error:
                assert "do not determine where the object is" in str(error)
                seen["untold"] += 1
            else:
                assert largest(told.X_WO.homogeneous - case.X_WO.homogeneous) < 1e-10
                assert largest(told.V_O - V) < 1e-9
    assert min(seen["unactuated"], seen["untold"], seen["contacts"]) > 10, seen
    assert seen["d"] == set(range(7))


@mark.parametrize("bend", [0.0, 1e-3, 1e-2])
def test_near_and_in_singular_postures(bend):
    """Elbows all but straight, and straight: where such velocities can go on, they agree."""
    rng = default_rng(2)
    compared = 0
    for _ in range(30):
        case = draw(rng, bends=[bend] * 4, angle=1e-7)
        v, V, state, _ = moving(case, [], NOTHING.N, rng)
        tau = any_torques(case, rng)
        oracle = solved(case, v, V, tau)
        if oracle.residual > 1e-9:  # straight arms: no acceleration keeps these loops closed
            assert bend == 0.0
            continue
        compared += 1
        got = osc.contact_response(state, NOTHING, tau=tau)
        assert miss(got.acceleration, oracle.a_object) < RTOL
    assert compared >= 25


def driven(rng, count, **options):
    """Chains that a controller may drive."""
    found = 0
    while found < count:
        case = draw(rng, **options)
        state = case.chain.state(case.q, np.zeros(case.chain.nq), case.X_WO, np.zeros(6))
        redundant = any(
            arm.passive_joints and arm.model.nv > grasp.N.shape[1]
            for arm, grasp in zip(case.chain.arms, case.chain.grasps, strict=True)
        )
        if state.unactuated.shape[1] == 0 and state.d > 0 and not redundant:
            found += 1
            yield case


def plant_at(case, pairs, dt, v, V):
    """The exact plant in motion."""
    plant = RigidPlant(case.chain, pairs, dt)
    plant.q = case.q
    plant.v = v
    plant._X = case.X_WO
    plant._V = V
    return plant


@mark.parametrize("kinds", [("slide", "plane"), ("cylinder", "plane")])
def test_two_grasps_that_pass_on_no_squeeze(kinds):
    """The force along the line between the tips is decided by f_S: there is nothing to command.

    Seeds 3 and 45: near singular postures rounding leaves a pivot for the squeeze, on some kernels.
    """
    for seed in (0, 1, 2, 3, 45):
        rng = default_rng(seed)
        case = random_case(["ur5", "ur5"], kinds, rng)
        v, V, _, contact = moving(case, (), np.zeros((6, 0)), rng)
        asked = case.chain, (), case.q, v, rng.standard_normal(6), np.zeros(0), "object"
        controller, tau = commanded(*asked, 5.0)
        assert controller.status is not osc.Status.HELD, controller.reason
        s = controller.signals
        oracle = solved(case, v, V, tau, contact)
        assert miss(oracle.a_object, s.state.S @ s.eta_c + s.state.sigma) < 1e-8
        assert_array_equal(tau, commanded(*asked, 0.0)[1])


def test_exact_plant_agrees():
    rng = default_rng(4)
    exact = 0
    for case in driven(rng, 20):
        pairs, N = touching(case, rng)
        v, V, _, contact = moving(case, pairs, N, rng)
        plant = plant_at(case, pairs, 1e-3, v, V)
        tau = any_torques(case, rng)
        _, a, alpha = plant.accelerations(tau)
        oracle = solved(case, v, V, tau, contact)
        assert miss(a, oracle.a_object) < RTOL
        assert miss(alpha, oracle.alpha) < RTOL
        exact += contact.r > 0
    assert exact > 7


def test_rigid_and_ball_grasps_agree_with_pinocchio_constraint_dynamics():
    """Pinocchio's own solver: a free-flying object, 6-row welds, 3-row points."""
    rng = default_rng(5)
    for _ in range(30):
        case = draw(rng, kinds=("rigid", "ball"), arms=("ur5", "panda", "scara"))
        v, V, state, _ = moving(case, [], NOTHING.N, rng)
        tau = any_torques(case, rng)
        want = ClosedLoop(case.chain).acceleration(case.q, v, case.X_WO, V, tau)
        got = osc.contact_response(state, NOTHING, tau=tau)
        assert miss(got.acceleration, want) < 1e-8


def in_millimetres(case):
    """The same chain, every length in mm."""

    def stretched(X):
        return pin.SE3(X.rotation, 1e3 * X.translation)

    def body(I):
        return pin.Inertia(I.mass, 1e3 * I.lever, 1e6 * I.inertia)

    arms = []
    grasps = []
    q = []
    for arm, grasp, s in zip(case.chain.arms, case.chain.grasps, case.chain.slices, strict=True):
        model = arm.model.copy()
        sliding = ["P" in joint.shortname() for joint in list(model.joints)[1:]]
        for j in range(1, model.njoints):
            model.jointPlacements[j] = stretched(model.jointPlacements[j])
            model.inertias[j] = body(model.inertias[j])
        for frame in model.frames:
            frame.placement = stretched(frame.placement)
            frame.inertia = body(frame.inertia)
        model.armature = np.where(sliding, 1.0, 1e6) * model.armature
        base = stretched(arm.base)
        arms.append(
            osc.Arm(arm.name, model, arm.tip, base, arm.passive_joints, arm.wrist_sensor, {})
        )
        grasps.append(osc.Grasp(stretched(grasp.X_TO), np.vstack((grasp.T[:3], grasp.T[3:]))))
        q.append(np.where(sliding, 1e3, 1.0) * case.q[s])
    payload = osc.RigidObject(body(case.chain.payload.inertia))
    chain = osc.ClosedChain(arms, grasps, payload, allow_unactuated=True)
    chain.model.gravity = pin.Motion(1e3 * chain.model.gravity.linear, np.zeros(3))
    return chain, np.concatenate(q), stretched(case.X_WO)


def test_units_do_not_matter():
    """Metres or millimetres: the same Φ₀, motion, contact force and unactuated motions."""
    rng = default_rng(6)
    k = np.array([1e3] * 3 + [1.0] * 3)
    for _ in range(20):
        case = draw(rng)
        pairs, N = touching(case, rng)
        v, V, state, contact = moving(case, pairs, N, rng)
        chain, q, X_WO = in_millimetres(case)
        scale = q / np.where(case.q == 0.0, 1.0, case.q)
        mm = chain.state(q, scale * v, X_WO, k * V)
        assert (mm.d, mm.unactuated.shape) == (state.d, state.unactuated.shape)
        per_wrench = np.array([1e-3] * 3 + [1e-6] * 3)
        assert miss(mm.Phi / np.outer(k, per_wrench), state.Phi, least=1e-9) < RTOL
        N_mm = np.vstack((contact.N[:3], 1e3 * contact.N[3:]))
        n_mm = 1e3 * contact.n_gamma
        tau = rng.standard_normal(chain.n_a) * 20.0
        tau_mm = np.where(scale[chain.actuated] == 1.0, 1e6, 1e3) * tau
        got = osc.contact_response(mm, osc.Contact(N_mm, n_mm), tau=tau_mm)
        want = osc.contact_response(state, contact, tau=tau)
        assert miss(got.acceleration / k, want.acceleration) < RTOL
        assert miss(got.alpha / 1e3, want.alpha) < RTOL


def test_a_rod_between_two_balls_spins_about_their_line():
    """No motor drives it, no joint measures it: both are said."""
    case = random_case(["ur5", "ur5"], ["ball", "ball"], default_rng(7))
    chain = case.chain
    still = np.zeros(12)
    with raises(osc.ModelError, match="do not determine where the object is"):
        chain.state(case.q, still)
    state = chain.state(case.q, still, case.X_WO, np.zeros(6))
    assert (state.d, state.unactuated.shape) == (6, (6, 1))
    spin = pin.Motion(state.unactuated[:, 0])
    for point in state.grasp_points:  # at rest
        there = shift(point - state.X_WO.translation)
        assert largest(there.actInv(spin).linear) < 1e-9 * largest(spin.angular)
    strict = osc.ClosedChain(chain.arms, chain.grasps, chain.payload)
    with raises(osc.ModelError, match="no motor drives"):
        strict.state(case.q, still, case.X_WO, np.zeros(6))
    controller = osc.Controller(strict, [])
    controller.tick(osc.Measurement(case.q, still, np.zeros((2, 6))), osc.Reference(case.X_WO))
    assert controller.status is osc.Status.HELD and "do not determine" in controller.reason


def test_loops_close_and_tips_are_reached():
    """From a few centimetres and tenths of a radian away; grasps then hold to rounding."""
    rng = default_rng(9)
    done = 0
    for case in driven(rng, 15, arms=("ur5", "panda"), kinds=("rigid", "hinge", "ball"), least=2):
        chain = case.chain
        try:
            q = close(chain, case.q + rng.uniform(-0.05, 0.05, chain.nq))
        except osc.ModelError:  # arms at the border of their reach
            continue
        X = object_pose(chain, q)
        for grasp, tip in zip(chain.grasps, chain.tip_poses(), strict=True):
            assert largest(grasp.miss(tip, X)) < 1e-12
        start = case.q + rng.uniform(-0.1, 0.1, chain.nq)
        q = reach(chain, start, case.X_WO, tolerance=1e-12)
        pin.forwardKinematics(chain.model, chain.data, q)
        for grasp, tip in zip(chain.grasps, chain.tip_poses(), strict=True):
            assert largest(grasp.miss(tip, case.X_WO)) < 1e-9
        done += 1
    assert done >= 12


def test_a_grasp_keeps_its_motions_and_nothing_else():
    """miss = 0 over the whole group; its rate is Nᵀ(V_O − V_tip) there."""
    rng = default_rng(10)
    for kind in KINDS:
        X_TO = pin.SE3.Random()
        axis = rng.standard_normal(3)
        X_WT = pin.SE3.Random()
        grasp = grasp_of(kind, X_TO, axis)
        grasp = osc.Grasp.rigid(grasp) if isinstance(grasp, pin.SE3) else grasp
        assert grasp.kind == (kind if kind in ("rigid", "hinge", "ball") else "other")
        X_WO = X_WT * slip_of(kind, axis, rng) * X_TO
        assert largest(grasp.miss(X_WT, X_WO)) < 1e-14
        V = rng.standard_normal(6)
        h = 1e-6
        O = X_WO.translation
        rate = (grasp.miss(X_WT, moved(X_WO, h * V)) - grasp.miss(X_WT, moved(X_WO, -h * V))) / 2
        want = grasp.wrenches_at(X_WT, O).T @ V
        assert_allclose(rate / h, want, atol=1e-8 * largest(want))


@mark.parametrize(
    "make, words",
    [
        (lambda X: osc.Grasp(X, np.eye(6)[:, 3:5]), "group of motions"),
        (lambda X: osc.Grasp(X, np.eye(6)[:, [0, 4]]), "group of motions"),
        (lambda X: osc.Grasp(X, np.eye(6)[:, [3, 3]]), "dependent"),
        (lambda X: osc.Grasp(X, np.zeros((6, 1))), "column is zero"),
        (lambda X: osc.Grasp(X, np.full((6, 1), np.nan)), "nan"),
        (lambda X: osc.Grasp(X, np.ones((3, 1))), "shape"),
        (lambda X: osc.Grasp.hinge(X, [0, 0, 0]), "give a direction"),
        (lambda X: osc.Grasp(np.eye(4)), "pin.SE3"),
    ],
)
def test_what_is_no_grasp_is_refused(make, words):
    with refused(words):
        make(pin.SE3.Identity())


def test_an_object_without_mass_needs_rigid_grasps():
    arm = random_case(["ur5"], ["rigid"], default_rng(11)).chain.arms[0]
    with raises(osc.ModelError, match="without mass"):
        osc.ClosedChain([arm], [osc.Grasp.ball(pin.SE3.Identity())])


HANDS = [
    "{xyz: [0.12, 0, 0], rpy: [180 deg, 0, 0]%s}",
    "{xyz: [0.12, 0, 0], rpy: [180 deg, 0, 180 deg]%s}",
]
HOW = {"rigid": "", "hinge": ", type: hinge, axis: [0, 1, 0]", "ball": ", type: ball"}


@mark.parametrize(
    "kinds", first([("ball", "hinge"), ("rigid", "hinge"), ("rigid", "ball"), ("hinge", "hinge")])
)
def test_mujoco_holds_the_object_the_same_way(kinds):
    """Joints and equality constraints of MuJoCo against N of the grasps, 0.2 s under control."""
    sets = [
        f"grasps.{side}={hand % HOW[kind]}"
        for side, hand, kind in zip(("left", "right"), HANDS, kinds, strict=True)
    ]
    at_once = "gains.force.rise=0 s"  # the forces are judged after 0.2 s
    rig = rig_of("dual_panda_rod", at_once, *sets)
    assert tuple(grasp.kind for grasp in rig.chain.grasps) == kinds
    plant = rig.plant()
    controller = rig.controller()
    started = plant.truth().X_WO
    assert_allclose(started.homogeneous, rig.state().X_WO.homogeneous, atol=1e-12)
    for k in range(200):
        plant.command(controller.tick(plant.measure(), rig.references.at(1e-3 * k)), 1e-3)
    q = plant.measure().q
    truth = plant.truth()
    X = object_pose(rig.chain, q)
    assert norm(X.translation - started.translation) > 1e-4  # it moves
    for grasp, tip in zip(rig.chain.grasps, rig.chain.tip_poses(), strict=True):
        assert largest(grasp.miss(tip, X)) < 2e-5
    assert_allclose(truth.X_WO.homogeneous, X.homogeneous, atol=1e-4)
    assert truth.closed.all() and controller.status is osc.Status.OK
    assert_allclose(truth.alpha, rig.references.at(0.199).alpha_d, rtol=0.01)


@mark.parametrize(
    "how, words",
    [
        ("{type: hinge}", "a hinge needs an axis"),
        ("{type: ball, axis: [0, 0, 1]}", "a ball grasp has no axis"),
        ("{type: glue}", "'rigid', 'hinge' or 'ball'"),
        ("{type: hinge, axis: [0, 0, 0]}", "whose length is 0"),
    ],
)
def test_scenarios_refuse_half_a_grasp(how, words):
    with raises(osc.ScenarioError, match=words):
        osc.load_scenario("dual_panda_rod", [f"grasps.left={how}"])


def test_a_grasp_that_registers_itself_has_a_name_in_scenarios(monkeypatch):
    monkeypatch.setitem(GRASPS, "slide", None)  # both are taken out again after the test
    monkeypatch.setitem(GRASP_TYPES, "slide", None)

    def slide(X_TO, axis):
        return osc.Grasp(X_TO, np.concatenate((axis, np.zeros(3)))[:, None])

    register_grasp("slide", slide, axis=True)
    hand = HANDS[0] % ", type: slide, axis: [0, 2, 0]"
    changes = [f"grasps.left={hand}", "plant.type=rigid"]
    rig = rig_of("dual_panda_rod", *changes)
    assert_array_equal(rig.chain.grasps[0].T[:, 0], [0, 1, 0, 0, 0, 0])
    controller = rig.controller()
    controller.tick(rig.plant().measure(), rig.references.at(0.0))
    assert controller.status is osc.Status.OK, controller.reason


def test_two_balls_in_a_scenario_are_refused_with_the_motion():
    both = ["grasps.left.type=ball", "grasps.right.type=ball"]
    with raises(osc.ModelError, match="do not determine where the object is"):
        rig_of("dual_panda_rod", *both)


def test_exact_plant_steps_an_object_that_no_arm_leads():
    """It is a body of its own there: a short step changes its twist by what the oracle says."""
    rng = default_rng(12)
    dt = 1e-6
    for case in driven(rng, 8, arms=("ur5", "panda"), kinds=("hinge", "ball"), least=2, most=3):
        v, V = (5.0 * x for x in case.moving(rng))
        plant = plant_at(case, [], dt, v, V)
        tau = any_torques(case, rng)
        oracle = solved(case, v, V, tau)
        classical = oracle.a_object + np.concatenate((np.cross(V[3:], V[:3]), np.zeros(3)))
        plant.command(tau, dt)
        assert miss((plant._V - V) / dt, classical) < 1e-3
        want = moved(case.X_WO, 0.5 * dt * (V + plant._V))
        assert_allclose(plant._X.homogeneous, want.homogeneous, atol=1e-10)
        assert plant.truth().X_WO == plant._X


def test_what_an_arm_does_without_the_object_is_held():
    """A six-joint arm turns about its ball without the rod: its posture task stops that."""
    rng = default_rng(13)
    case = next(driven(rng, 1, arms=("ur5",), kinds=("ball",), least=3, most=3))
    chain = case.chain
    X_WO = object_pose(chain, case.q)
    plant = RigidPlant(chain, [], 2e-3)
    plant.reset(case.q)
    state = chain.state(plant.q, np.zeros(18))
    inner = svd(state.arms[0].N.T @ state.arms[0].J)[2][3:]
    plant.v = np.concatenate((inner.T @ [0.3, -0.2, 0.3], np.zeros(12)))
    controller = osc.Controller(chain, [], dt=2e-3, posture=plant.q)
    wanted = osc.Reference(X_WO, np.zeros(6), np.zeros(6), np.zeros(0))
    before = norm(plant.v)
    for _ in range(100):
        plant.command(controller.tick(plant.measure(), wanted), 2e-3)
        assert controller.status is not osc.Status.HELD, controller.reason
    assert norm(plant.v) < 0.3 * before  # damping 10 1/s, 0.2 s
    assert largest(plant.truth().X_WO.translation - X_WO.translation) < 1e-5
