"""Chains of any arms with any grasps, against one full system of equations (kkt_oracle.py)."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import model_error, scenario_error
from grasp_rigs import KINDS, grasp_of, random_case, slip_of
from kkt_oracle import pressed
from numpy.linalg import cholesky, norm, solve, svd
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from rigs import (
    UNLIMITED,
    assert_near,
    commanded,
    contact_of,
    held_tick,
    largest,
    miss,
    placed,
    random_faces,
    refused,
    rig_of,
    rotated,
    shift,
    ticked,
    unloaded,
    vector,
)
from samples import aligned, first, parametrize
from scenario_runs import first_inputs

import osc_contact as osc
from osc_contact.dynamics.assembly import close, object_pose, reach
from osc_contact.dynamics.grasp import GRASPS, moved, register_grasp
from osc_contact.lab.plants.rigid import RigidPlant
from osc_contact.settings.control import PostureTask

ARMS = ("scara", "ur5", "panda", "2R", "3R")
NOTHING = osc.Contact(np.zeros((6, 0)))
RTOL = 1e-9


def draw(rng, arms=ARMS, kinds=KINDS, least=1, most=4, **options):
    n = rng.integers(least, most + 1)
    return random_case(list(rng.choice(arms, n)), list(rng.choice(kinds, n)), rng, **options)


def touching(case, rng, most=2):
    """Faces on which this chain can push in earnest, none if it cannot."""
    still = case.at_rest()
    pairs = random_faces(case.X_WO, min(most, still.d), rng)
    root = cholesky(still.metric)
    felt = svd(root.T @ still.S)[0][:, : still.d].T @ solve(root, contact_of(pairs, still).N)
    return pairs if pairs and svd(felt)[1][-1] > 0.05 * norm(felt) else []


def moving(case, pairs, rng, size=1.0):
    """The whole, in motion that keeps grasps and contacts, and its state and contact; torques."""
    whole = pressed(case, pairs)
    whole.move(rng)
    whole.at(size * whole.v, size * whole.V)
    state = case.chain.state(case.q, whole.v, case.X_WO, whole.V)
    return (whole, state, contact_of(pairs, state), rng.standard_normal(case.chain.n_a) * 20.0)


EIGHT = ("scara", "ur5", "panda", "3R", "panda", "ur5", "ur5", "panda")
GRIPS = ("ball", "hinge", "rigid", "ball", "cylinder", "slide", "ball", "hinge")


def many_cases(rng):
    """Random chains of 1 to 4 arms with any grasps, of eight arms, and bare tips."""
    yield from (draw(rng) for _ in range(40))
    yield from (random_case(EIGHT, GRIPS, rng) for _ in range(2))
    yield from (random_case([arm], ["rigid"], rng, body=None) for arm in ARMS for _ in range(4))


@parametrize("bend", [None, 0.0, 1e-3, 1e-2])
def test_motion_and_contact_forces_agree_with_the_full_system(bend):
    """Eqs. 13–20 and the exact plant, for grasps that turn, slide and hold.

    `bend`: elbows all but straight, and straight: where such velocities can last, they agree.
    """
    rng = default_rng(1 if bend is None else 2)
    seen = {"unactuated": 0, "contacts": 0, "compared": 0, "d": set()}
    how = {} if bend is None else {"bends": [bend] * 4, "angle": 1e-7}
    for case in many_cases(rng) if bend is None else (draw(rng, **how) for _ in range(30)):
        for _ in range(3 if bend is None else 1):
            pairs = touching(case, rng) if bend is None else []
            whole, state, contact, tau = moving(case, pairs, rng)
            oracle = whole.answer(tau, exact=False)
            if oracle.residual > 1e-9:  # straight arms: no acceleration keeps these loops closed
                assert bend == 0.0
                continue
            got = osc.contact_response(state, contact, tau=tau)
            assert miss(got.acceleration, oracle.a_object) < RTOL
            assert miss(got.alpha, oracle.alpha) < RTOL
            seen["compared"] += 1
            seen["unactuated"] += state.unactuated.shape[1] > 0
            seen["contacts"] += contact.r > 0
            seen["d"].add(state.d)
            if bend is None and case.chain.payload is not None:
                _, a, alpha = plant_at(whole, 1e-3).accelerations(tau)
                assert miss(a, oracle.a_object) < RTOL and miss(alpha, oracle.alpha) < RTOL
    assert seen["compared"] >= 25
    if bend is None:
        assert min(seen["unactuated"], seen["contacts"]) > 10, seen
        assert seen["d"] == set(range(7))


def by_constraint_dynamics(whole, tau):
    """Spatial acceleration (6,) of the object by Pinocchio: free flyer, welds, points of balls."""
    chain = whole.case.chain
    X_WO = whole.case.X_WO
    to_object = rotated(X_WO.rotation.T).action  # turns a twist into its axes
    model = chain.model.copy()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), placed(), "object")
    model.appendBodyToJoint(joint, chain.payload.inertia, placed())
    ties = []
    for arm, grasp in aligned(chain.arms, chain.grasps):
        tip = model.frames[model.getFrameId(f"{arm.name}/{arm.tip}")]
        kind = pin.ContactType.CONTACT_6D if grasp.is_rigid else pin.ContactType.CONTACT_3D
        ends = (tip.parentJoint, tip.placement, joint, grasp.X_TO.inverse())
        ties.append(pin.RigidConstraintModel(kind, model, *ends, pin.LOCAL))
    states = [tie.createData() for tie in ties]
    data = model.createData()
    pin.initConstraintDynamics(model, data, ties, states)
    q = np.append(whole.case.q, pin.SE3ToXYZQUAT(X_WO))
    v = np.append(whole.v, to_object @ whole.V)
    force = np.zeros(model.nv)
    force[chain.actuated] = tau
    settings = pin.ProximalSettings(1e-13, 1e-10, 50)
    a = pin.constraintDynamics(model, data, q, v, force, ties, states, settings)
    return to_object.T @ a[-6:]


def test_rigid_and_ball_grasps_agree_with_pinocchio_constraint_dynamics():
    """The full system itself, which judges all else here."""
    rng = default_rng(5)
    for _ in range(30):
        case = draw(rng, kinds=("rigid", "ball"), arms=("ur5", "panda", "scara"))
        whole, _, _, tau = moving(case, [], rng)
        assert miss(whole.answer(tau).a_object, by_constraint_dynamics(whole, tau)) < 1e-8


def driven(rng, count, **options):
    """Chains that a controller may drive."""
    found = 0
    while found < count:
        case = draw(rng, **options)
        state = case.at_rest()
        redundant = any(
            arm.passive_joints and arm.model.nv > grasp.N.shape[1]
            for arm, grasp in aligned(case.chain.arms, case.chain.grasps)
        )
        if state.unactuated.shape[1] == 0 and state.d > 0 and not redundant:
            found += 1
            yield case


def plant_at(whole, dt):
    """The exact plant in this motion."""
    plant = RigidPlant(whole.case.chain, [c.pair for c in whole.contacts], dt)
    plant.q = whole.case.q
    plant.v = whole.v
    plant._X = whole.case.X_WO
    plant._V = whole.V
    return plant


@parametrize("kinds", [("slide", "plane"), ("cylinder", "plane")])
def test_two_grasps_that_pass_on_no_squeeze(kinds):
    """The force along the line between the tips is decided by f_S: there is nothing to command.

    Seeds 3 and 45: near singular postures rounding leaves a pivot for the squeeze, on some kernels.
    """
    for seed in (0, 1, 2, 3, 45):
        rng = default_rng(seed)
        case = random_case(["ur5", "ur5"], kinds, rng)
        whole = moving(case, (), rng)[0]
        given = (case.chain, (), case.q, whole.v, rng.standard_normal(6), np.zeros(0))
        controller, tau = commanded(*given, 5.0)
        assert controller.status is not osc.Status.HELD, controller.reason
        s = controller.signals
        expected = s.state.S @ s.eta_c + s.state.sigma
        assert miss(whole.answer(tau).a_object, expected) < 1e-8
        assert_array_equal(tau, commanded(*given, 0.0)[1])


def test_a_rod_between_two_balls_spins_about_their_line():
    """No motor drives it, no joint measures it: both are reported."""
    case = random_case(["ur5", "ur5"], ["ball", "ball"], default_rng(7))
    chain = case.chain
    still = np.zeros(12)
    with model_error("do not determine where the object is"):
        chain.state(case.q, still)
    state = case.at_rest()
    assert (state.d, state.unactuated.shape) == (6, (6, 1))
    spin = pin.Motion(state.unactuated[:, 0])
    for point in state.grasp_points:  # at rest
        there = shift(point - state.X_WO.translation)
        assert largest(there.actInv(spin).linear) < 1e-9 * largest(spin.angular)
    strict = osc.ClosedChain(chain.arms, chain.grasps, chain.payload)
    with model_error("no motor drives"):
        replace(case, chain=strict).at_rest()
    controller = osc.Controller(strict, [])
    held_tick(controller, "do not determine", unloaded(case.q, still, 2), osc.Reference(case.X_WO))


def assert_held(chain, X, tolerance):
    """The object at X misses no tip by more, where `chain.data` has them."""
    for grasp, tip in aligned(chain.grasps, chain.tip_poses()):
        assert largest(grasp.miss(tip, X)) < tolerance


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
        assert_held(chain, object_pose(chain, q), 1e-12)
        q = reach(chain, case.q + rng.uniform(-0.1, 0.1, chain.nq), case.X_WO, tolerance=1e-12)
        pin.forwardKinematics(chain.model, chain.data, q)
        assert_held(chain, case.X_WO, 1e-9)
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
        rate = (grasp.miss(X_WT, moved(X_WO, h * V)) - grasp.miss(X_WT, moved(X_WO, -h * V))) / 2
        expected = grasp.wrenches_at(X_WT, X_WO.translation).T @ V
        assert_near(rate / h, expected, atol=1e-8 * largest(expected))


@parametrize(
    "T, words",
    [
        (np.eye(6)[:, 3:5], "group of motions"),
        (np.eye(6)[:, [0, 4]], "group of motions"),
        (np.eye(6)[:, [3, 3]], "dependent"),
        (np.zeros((6, 1)), "column is zero"),
        (np.full((6, 1), np.nan), "nan"),
        (np.ones((3, 1)), "shape"),
    ],
)
def test_what_is_no_grasp_is_refused(T, words):
    X = placed()
    with refused(words):
        osc.Grasp(X, T)
    with refused("give a direction"):
        osc.Grasp.hinge(X, [0, 0, 0])
    with refused("pin.SE3"):
        osc.Grasp(np.eye(4))


def test_an_object_without_mass_needs_rigid_grasps():
    arm = random_case(["ur5"], ["rigid"], default_rng(11)).chain.arms[0]
    with model_error("without mass"):
        osc.ClosedChain([arm], [osc.Grasp.ball(placed())])


HANDS = [
    "{xyz: [0.12, 0, 0], rpy: [180 deg, 0, 0]%s}",
    "{xyz: [0.12, 0, 0], rpy: [180 deg, 0, 180 deg]%s}",
]
HOW = {"rigid": "", "hinge": ", type: hinge, axis: [0, 1, 0]", "ball": ", type: ball"}


@parametrize(
    "kinds", first([("ball", "hinge"), ("rigid", "hinge"), ("rigid", "ball"), ("hinge", "hinge")])
)
def test_mujoco_holds_the_object_the_same_way(kinds):
    """Joints and equality constraints of MuJoCo against N of the grasps, 0.2 s under control."""
    sets = [
        f"grasps.{side}={hand % HOW[kind]}"
        for side, hand, kind in aligned(("left", "right"), HANDS, kinds)
    ]
    at_once = "gains.force.rise=0 s"  # the forces are judged after 0.2 s
    rig = rig_of("dual_panda_rod", at_once, *sets)
    assert tuple(grasp.kind for grasp in rig.chain.grasps) == kinds
    plant = rig.plant()
    controller = rig.controller()
    started = plant.truth().X_WO
    assert_near(started.homogeneous, rig.state.X_WO.homogeneous, atol=1e-12)
    osc.run_loop(plant, controller, rig.references.each(200, 1e-3))
    q = plant.measure().q
    truth = plant.truth()
    X = object_pose(rig.chain, q)
    assert norm(X.translation - started.translation) > 1e-4  # it moves
    assert_held(rig.chain, X, 2e-5)
    assert_near(truth.X_WO.homogeneous, X.homogeneous, atol=1e-4)
    assert truth.closed.all() and controller.status is osc.Status.OK
    assert_near(truth.alpha, rig.references.at(0.199).alpha_d, rtol=0.01)


@parametrize(
    "how, words",
    {
        "{type: hinge}": "a hinge needs an axis",
        "{type: ball, axis: [0, 0, 1]}": "a ball grasp has no axis",
        "{type: glue}": "'rigid', 'hinge' or 'ball'",
        "{type: hinge, axis: [0, 0, 0]}": "whose length is 0",
    },
)
def test_scenarios_refuse_half_a_grasp(how, words):
    with scenario_error(words):
        osc.load_scenario("dual_panda_rod", [f"grasps.left={how}"])


def test_a_grasp_that_registers_itself_has_a_name_in_scenarios(monkeypatch):
    monkeypatch.setitem(GRASPS, "slide", None)  # taken out again after the test

    def slide(X_TO, axis):
        return osc.Grasp(X_TO, np.append(axis, np.zeros(3))[:, None])

    register_grasp("slide", slide, axis=True)
    hand = HANDS[0] % ", type: slide, axis: [0, 2, 0]"
    rig = rig_of("dual_panda_rod", *[f"grasps.left={hand}", "plant.type=rigid"])
    assert_array_equal(rig.chain.grasps[0].T[:, 0], [0, 1, 0, 0, 0, 0])
    ticked(rig.controller(), *first_inputs(rig))


def test_exact_plant_steps_an_object_that_no_arm_leads():
    """The object is a separate body there: a short step changes its twist as in the oracle."""
    rng = default_rng(12)
    dt = 1e-6
    for case in driven(rng, 8, arms=("ur5", "panda"), kinds=("hinge", "ball"), least=2, most=3):
        whole, _, _, tau = moving(case, [], rng, 5.0)
        plant = plant_at(whole, dt)
        plant.command(tau, dt)
        assert miss((plant._V - whole.V) / dt, whole.answer(tau).a) < 1e-3
        expected = moved(case.X_WO, 0.5 * dt * (whole.V + plant._V))
        assert_near(plant._X.homogeneous, expected.homogeneous, atol=1e-10)
        assert plant.truth().X_WO == plant._X


# Motions that a grasp leaves to an arm alone ------------------------------------------------------

IDLE = {
    "SCARA on a slide": (["scara", "ur5"], ["slide", "rigid"], 0, [1, 12, 14]),
    "four joints in a plane": (["4R"], ["rigid"], 0, [5, 6, 7]),
    "UR5 on a ball beside four joints in a plane": (["ur5", "4R"], ["ball", "rigid"], 1, [8, 9]),
}


@parametrize("name", IDLE)
def test_idle_motions_obey_the_posture_task(name):
    """Accelerations by the full system of equations; gravity acts on idle joints too."""
    arms, kinds, which, seeds = IDLE[name]
    for seed in seeds:
        rng = default_rng(seed)
        case = random_case(arms, kinds, rng)
        chain = osc.ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
        whole = moving(case, [], rng, 0.1)[0]
        rest = case.q + 0.05 * rng.standard_normal(chain.nq)
        controller = osc.Controller(chain, [], posture=rest)
        measured = unloaded(case.q, whole.v, len(arms))
        tau = controller.tick(measured, osc.Reference(case.X_WO, whole.V))
        assert controller.status in (osc.Status.OK, osc.Status.DEGRADED), controller.reason
        assert controller.lost_directions == () or "SCARA" not in name, "no singular posture"
        s = chain.slices[which]
        arm = chain.state(case.q, whole.v).arms[which]
        idle = svd(arm.N.T @ arm.J)[2][arm.rank :] @ arm.M
        assert len(idle) == arm.J.shape[1] - arm.rank > 0
        task = PostureTask()
        expected = task.stiffness * (rest - case.q)[s] - task.retreat_damping * whole.v[s]
        assert_near(idle @ whole.answer(tau).qdd[s], idle @ expected, atol=1e-7)


def test_an_arm_whose_idle_motion_no_motor_drives_still_moves_the_object():
    """A passive joint that swings by itself: nothing holds it, and nothing is held up by it."""
    case = random_case(["4R"], ["rigid"], default_rng(3))
    loose = replace(case.chain.arms[0], passive_joints=("joint1",))
    chain = osc.ClosedChain([loose], case.chain.grasps, case.chain.payload)
    A_D = vector(0.1, -0.2, 0.3, 0.1, 0.2, -0.1)
    controller = osc.Controller(chain, [], posture=case.q)
    tau = ticked(controller, unloaded(case.q, np.zeros(4)), osc.Reference(case.X_WO, A_D=A_D))
    found = pressed(case, ()).answer(np.insert(tau, 1, 0.0))
    s = controller.signals
    assert_near(found.a_object, s.state.S @ s.eta_c + s.state.sigma, atol=1e-8)


# Contact forces out of wrist readings, fig. 5 -----------------------------------------------------


@parametrize("arm", ["panda", "ur5", "2R", "3R", "4R"])
def test_forces_at_a_tip_that_holds_nothing(arm):
    """Inertial forces beyond the sensor are removed for any permitted motions of the tip."""
    rng = default_rng(27)
    seen = 0
    for _ in range(12):
        case = random_case([arm], ["rigid"], rng, body=None)
        pairs = touching(case, rng)
        state = pressed(case, pairs)
        state.move(rng)
        truth = state.answer(20.0 * rng.standard_normal(case.chain.n_a))
        controller = osc.Controller(case.chain, pairs, safety=UNLIMITED, reading="filter")
        reference = osc.Reference(placed(), alpha_d=np.zeros(len(pairs)))
        controller.tick(osc.Measurement(case.q, state.v, state.readings(truth)), reference)
        assert controller.status is not osc.Status.HELD, controller.reason
        assert miss(controller.result().alpha_meas, truth.alpha) < 1e-7
        seen += len(pairs)
    assert seen > 8
