"""The law against the NumPy law of `readable`: the same torques, integrals and verdicts.

States, references and wrenches are random; every kind of pair, body, chain and metric takes part.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from grasp_rigs import random_case
from pair_kinds import KINDS, touching
from readable.controller import ReadableController
from readable.force import outboard_mobility
from readable.phases import ContactPhases
from rigs import one_panda, panda_pair, placed, random_faces, random_state, scara_pair

import osc_contact as osc
from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.control.controller import Controller
from osc_contact.control.force import ForceGains
from osc_contact.control.friction import Friction
from osc_contact.control.motion import MotionGains
from osc_contact.dynamics.environment import Environment
from osc_contact.dynamics.front_end import require_pinocchio_agrees
from osc_contact.dynamics.rail import Cart, Conveyor
from osc_contact.interface import Measurement, Reference, Touched
from osc_contact.law.layout import records
from osc_contact.law.tables import CHAIN, JOINT
from osc_contact.scenarios import list_scenarios

GAINS = osc.Gains(MotionGains(400, 40, 2000), ForceGains(30, 5))
TOLERANCE = 1e-12
UNLIMITED = osc.SafetySettings.motors_only()  # states that follow one another are no motion


def twins(chain, pairs, **how):
    fast = Controller(chain, pairs, GAINS, safety=UNLIMITED, **how)
    return fast, readable_of(fast)


def readable_of(controller):
    """The same controller in plain NumPy, which has no brake and lets no steps of force in."""
    c, life = controller, None
    assert not (c.gains.force.brake or c.gains.force.rise), "gains that the NumPy law does not know"
    if c.life is not None:
        pushing = np.array([pushes_only(pair) for pair in c.contacts])
        owners = np.array(c._records.row.pairs.owners)
        life = ContactPhases(c.life, owners, pushing, c.dt, c.engaged)
    return ReadableController(
        c.chain, c.contacts, c.gains, dt=c.dt, B=c.B, bodies=c.bodies, posture=c.posture,
        engaged=c.engaged, friction=c.friction, life=life, reading=c.reading,
    )  # fmt: skip


def disturb(rng, *controllers):
    """The same random tare, bias and integrals in all of them."""
    tare, bias, error = rng.normal(size=6), rng.normal(size=6), 0.01 * rng.normal(size=6)
    for c in controllers:
        c.f_tare, c.f_bias, c.motion_law.integral = tare, bias, error.copy()


def inputs(chain, q, v, rng, columns, touched=None):
    X = chain.state(q, v).X_WO * pin.exp6(pin.Motion(0.02 * rng.normal(size=6)))
    wrenches = 10 * rng.normal(size=(len(chain.arms), 6))
    alpha_d = rng.uniform(5, 20, columns)
    squeeze = 5.0 if len(chain.arms) < 3 else 0.0  # more than two are the readable path's
    reference = Reference(X, 0.1 * rng.normal(size=6), rng.normal(size=6), alpha_d, squeeze)
    return Measurement(q, v, wrenches, touched), reference


def near_singular(state):
    """Whether some arm moves the object with 1/0.5² times the inertia of arm and object, or more:
    from 1/0.3² on commands fade, and the kernels' bound of it errs on the safe side."""
    phi = np.linalg.inv(state.reference)
    for arm, full in zip(state.arms, state.full_ranks, strict=True):
        ratio = np.sort(np.linalg.eigvals(arm.Lambda @ phi).real)[::-1]
        if ratio[0] > 4.0 or arm.rank < min(full, arm.N.shape[1]):
            return True
    return False


def agree(fast, slow, measurement, reference, tolerance=TOLERANCE):
    got = fast.tick(measurement, reference)
    want = slow.tick(measurement, reference)
    assert slow.status is not osc.Status.HELD, slow.reason
    size = np.abs(want).max()
    assert fast.status is slow.status, (fast.reason, slow.reason)
    if slow.status is osc.Status.SATURATED:
        tolerance = max(tolerance, 1e-7)
    if slow.status is osc.Status.DEGRADED:
        tolerance = max(tolerance, 1e-8)  # both lose digits as 1/χ²
    np.testing.assert_allclose(got, want, rtol=0, atol=tolerance * size)
    for a, b in (
        (fast.motion_law.integral, slow.motion_law.integral),
        (fast.force_law.integral, slow.force_law.integral),
    ):
        atol = 10 * tolerance * np.abs(b).max(initial=1e-3)
        np.testing.assert_allclose(a, b, rtol=0, atol=atol)
    return want


def accelerated_alike(fast, slow, tolerance=TOLERANCE):
    """The commanded joint accelerations of the last tick; the kernels' are worked out with it."""
    got, want = fast.joint_acceleration(), slow.joint_acceleration()
    np.testing.assert_allclose(got, want, rtol=0, atol=10 * tolerance * np.abs(want).max())


@pytest.mark.parametrize("B", ["object", "chain", "matrix"])
@pytest.mark.parametrize("rig", [scara_pair, panda_pair, one_panda])
def test_random_states_and_faces(rig, B):
    """r = 0 … d faces on random chains, three metrics."""
    chain, rng = rig(), np.random.default_rng(30)
    if B == "matrix":
        A = rng.normal(size=(6, 6))
        B = A @ A.T + np.eye(6)
    for r in range(6 if chain.nq == 10 else 7):
        done = 0
        while done < 3:
            q, v = random_state(chain, rng)
            pairs = random_faces(chain.state(q, v).X_WO, r, rng)
            fast, slow = twins(chain, pairs, B=B, posture=q + 0.1 * rng.normal(size=chain.nq))
            disturb(rng, fast, slow)
            measurement, reference = inputs(chain, q, v, rng, r)
            slow.tick(measurement, reference)
            if slow.status is osc.Status.HELD:
                continue  # the arms cannot push there
            slow.motion_law.integral = fast.motion_law.integral.copy()
            slow.force_law.integral, slow.more_friction = np.zeros(0), 0.0
            # five or six random faces are nearly dependent: both paths lose digits
            tolerance = TOLERANCE if r < 5 else 1e-10
            agree(fast, slow, measurement, reference, tolerance)
            agree(fast, slow, measurement, reference, tolerance)
            accelerated_alike(fast, slow, tolerance)
            done += 1


def test_grasps_that_permit_motions():
    """Hinges, balls and rigid grasps of two or three arms, the leader anywhere or nowhere."""
    rng, leaders = np.random.default_rng(36), set()
    while len(leaders) < 4:
        count = rng.integers(2, 4)
        arms = list(rng.choice(["ur5", "panda"], count))
        kinds = list(rng.choice(["rigid", "hinge", "ball"], count, p=[0.3, 0.35, 0.35]))
        case = random_case(arms, kinds, rng)
        chain = osc.ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
        try:
            state = chain.state(case.q, np.zeros(chain.nq))
        except osc.ModelError:  # two balls, or a ball on the axis of a hinge
            continue
        leaders.add(chain.leader)
        pairs = random_faces(state.X_WO, 2, rng)
        fast, slow = twins(chain, pairs, posture=case.q)
        disturb(rng, fast, slow)
        for _ in range(5):
            q = case.q + 1e-4 * rng.normal(size=chain.nq)
            # loops that do not quite close leave more digits to the order of sums
            agree(fast, slow, *inputs(chain, q, rng.normal(size=chain.nq), rng, 2), 1e-9)
            accelerated_alike(fast, slow, 1e-9)
    assert leaders == {None, 0, 1, 2}


@pytest.mark.parametrize(
    "arms, kinds, squeeze",
    [
        (["ur5", "ur5"], ["rigid", "slide"], 5.0),
        (["ur5", "panda"], ["slide", "slide"], 5.0),  # the grasps alone fix the object
        (["scara", "ur5"], ["hinge", "rigid"], 5.0),  # a gripper with a joint beyond its sensor
        (["scara", "panda"], ["hinge", "ball"], 5.0),
        (["ur5", "ur5", "ur5"], ["rigid", "rigid", "rigid"], 5.0),
        (["ur5", "panda", "ur5"], ["rigid", "hinge", "ball"], np.array([3.0, -2.0, 5.0])),
        (["scara", "ur5", "ur5"], ["hinge", "ball", "rigid"], 4.0),
        (["panda", "panda", "panda", "panda"], ["rigid"] * 4, 4.0),
    ],
)
def test_other_grasps_and_internal_forces(arms, kinds, squeeze):
    """Slides, jointed grippers, bar forces; near singular postures and weak motors as they come."""
    rng, done = np.random.default_rng(37), 0
    while done < 6:
        case = random_case(arms, kinds, rng)
        chain = osc.ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
        try:
            state = chain.state(case.q, np.zeros(chain.nq))
        except osc.ModelError:  # the grasps do not fix the object
            continue
        if any(lost.chi < 0.1 for lost in state.singular_directions):
            continue  # both lose digits as 1/χ²
        fast, slow = twins(chain, random_faces(state.X_WO, 2, rng), posture=case.q)
        for _ in range(2):
            q, v = case.q + 1e-4 * rng.normal(size=chain.nq), 0.3 * rng.normal(size=chain.nq)
            measurement, reference = inputs(chain, q, v, rng, 2)
            agree(fast, slow, measurement, replace(reference, squeeze_d=squeeze), 1e-9)
            accelerated_alike(fast, slow, 1e-9)
            if fast.status is not osc.Status.HELD:
                found = fast.result().squeeze
                np.testing.assert_allclose(found, slow.result().squeeze, atol=1e-6)
        done += 1


@pytest.mark.parametrize("name", list_scenarios())
def test_every_packaged_scenario(name):
    """Random displacements and velocities around the start."""
    rig = osc.build_rig(osc.load_scenario(name))
    rng = np.random.default_rng(31)
    gains = rig.gains
    if gains.force.brake or gains.force.rise:  # tests/test_gains.py, test_law_steps.py: oracles
        damping = gains.force.damping or 100.0
        gains = replace(gains, force=ForceGains(gains.force.integral, damping))
    fast = rig.controller().with_gains(gains).with_safety(UNLIMITED)
    slow = readable_of(fast)
    measurement, reference = rig.at_start(rig.plant().measure()), rig.references.at(0.3)
    n = rig.model.nq
    phased = fast.life is not None
    for engaged in (False, True, False):
        fast.engaged = slow.engaged = engaged
        if phased:  # what is learnt is handed over in the state of the tick, not of the last one
            fast.motion_law.integral = slow.motion_law.integral = np.zeros(6)
        for _ in range(20):
            q = measurement.q + 1e-3 * rng.normal(size=n)
            moved = replace(measurement, q=q, v=0.1 * rng.normal(size=n))
            agree(fast, slow, moved, reference)
            accelerated_alike(fast, slow)


def pairs_of_every_kind(X, rng):
    """Pairs of each kind, alone and beside others, touching at pose X of the object."""
    seed = int(rng.integers(1 << 30))
    found = {name: [touching(name, X, seed, per_metre=0.1)] for name in KINDS}
    found["vertex, saddle and sphere"] = [
        touching(name, X, seed + i, per_metre=0.1)
        for i, name in enumerate(("vertex_on_face", "point_on_a_saddle", "sphere_on_plane"))
    ]
    return found


def motion_of(rng, contacts):
    """Bodies displaced by some centimetres and turned by some tenths of a radian."""
    spread = np.repeat([0.05, 0.3], 3)
    X = np.array([pin.exp6(spread * rng.normal(size=6)).homogeneous for _ in range(contacts)])
    X = X.reshape(contacts, 4, 4)
    A = rng.normal(size=(contacts, 6))
    return Touched(X, rng.normal(size=(contacts, 6)), A)


class Wall:
    """A body of the user's own: yields along one wrench."""

    def environment(self, X_WE, V_E, A_E, O):  # noqa: E741
        u = np.array([0.3, -0.2, 0.9, 0.1, 0.2, -0.1])
        return Environment(np.outer(u, u), 0.1 * u, V_E)


@pytest.mark.parametrize("body", [None, "conveyor", "cart", "own"])
def test_every_pair_and_body(body):
    """Fixed and moving environments; a GapFunctions pair is evaluated by Python code."""
    bodies = {"conveyor": Conveyor(), "cart": Cart([1, 2, 3], 5.0, 100, 3, 2), "own": Wall()}
    chain, rng = panda_pair(), np.random.default_rng(32)
    for _ in range(2):
        q, v = random_state(chain, rng)
        for kind, pairs in pairs_of_every_kind(chain.state(q, v).X_WO, rng).items():
            how = {} if body is None else {"bodies": [bodies[body]] * len(pairs)}
            fast, slow = twins(chain, pairs, **how)
            disturb(rng, fast, slow)
            columns = sum(len(pair.gaps(pin.SE3.Identity())) for pair in pairs)
            for touched in (None, motion_of(rng, len(pairs)), None):
                measurement, reference = inputs(chain, q, v, rng, columns, touched)
                # gap functions are differentiated numerically, at poses that differ by rounding
                by_gaps = any(isinstance(pair, osc.GapFunctions) for pair in pairs)
                tolerance = 1e-9 if by_gaps else 1e-11
                try:
                    agree(fast, slow, measurement, reference, tolerance)
                except AssertionError as error:
                    raise AssertionError(f"{kind}, touched={touched is not None}") from error


def test_different_bodies_at_different_contacts():
    chain, rng = panda_pair(), np.random.default_rng(33)
    q, v = random_state(chain, rng)
    pairs = random_faces(chain.state(q, v).X_WO, 4, rng)
    cart = Cart([0, 1, 2], 3.0, 50.0)
    fast, slow = twins(chain, pairs, bodies=[cart, None, cart, Conveyor()])
    measurement, reference = inputs(chain, q, v, rng, 4, motion_of(rng, 4))
    agree(fast, slow, measurement, reference, 1e-11)


def off_their_faces(X, r, rng):
    """Vertices somewhat above or below their faces: friction acts where the face is."""
    pairs = random_faces(X, r, rng)
    return [replace(p, point=p.point + 0.01 * rng.normal(size=3), radius=0.005) for p in pairs]


@pytest.mark.parametrize("body", [None, "conveyor", "cart", "own", "many"])
@pytest.mark.parametrize("rig", [scara_pair, panda_pair])
def test_friction(rig, body):
    """Sliding vertices on faces that rest, move or yield, on one body or on several."""
    bodies = {"conveyor": Conveyor(), "cart": Cart([1, 2, 3], 5.0, 100, 3, 2), "own": Wall()}
    chain, rng, done = rig(), np.random.default_rng(38), 0
    while done < 4:
        q, v = random_state(chain, rng)
        pairs = off_their_faces(chain.state(q, v).X_WO, 3, rng)
        on = [bodies.get(body)] * 3
        if body == "many":
            on = [bodies["cart"], bodies["own"], bodies["cart"]]
        how = {"bodies": on, "B": ["object", "chain"][done % 2]}
        fast, slow = twins(chain, pairs, friction=Friction(0.4, 0.01), **how)
        disturb(rng, fast, slow)
        for touched in (None, motion_of(rng, 3), None):
            measurement, reference = inputs(chain, q, v, rng, 3, touched)
            agree(fast, slow, measurement, reference, 1e-11)
            accelerated_alike(fast, slow, 1e-11)
        blind = Controller(chain, pairs, GAINS, safety=UNLIMITED, **how)
        blind.motion_law.integral = slow.motion_law.integral
        assert np.abs(blind.tick(measurement, reference) - slow.last_torques()).max() > 1e-2
        D = slow.last_signals(), fast.result().mobility
        want = outboard_mobility(
            D[0].state, D[0].contact, D[0].environment, D[0].friction_wrenches
        )[0]
        np.testing.assert_allclose(D[1], want, rtol=0, atol=1e-10 * np.abs(want).max())
        done += 1


def test_friction_with_motors_that_are_too_weak():
    strong, rng, done = scara_pair(), np.random.default_rng(39), 0
    chain = osc.ClosedChain(strong.arms, strong.grasps, strong.payload)
    chain.tau_max = 0.3 * strong.tau_max
    while done < 5:
        q, v = random_state(chain, rng)
        pairs = random_faces(chain.state(q, v).X_WO, 2, rng)
        fast, slow = twins(chain, pairs, friction=Friction(0.4))
        agree(fast, slow, *inputs(chain, q, v, rng, 2))
        done += slow.status is osc.Status.SATURATED


def test_dependent_contacts():
    """A table on four and on eight legs, three of them independent."""
    chain, rng = panda_pair(), np.random.default_rng(34)
    for legs in (4, 8):
        q, v = random_state(chain, rng)
        X = chain.state(q, v).X_WO
        n = X.rotation @ np.array([0.0, 0.0, 1.0])
        spots = np.column_stack((rng.uniform(-0.2, 0.2, (legs, 2)), np.full(legs, -0.05)))
        pairs = [osc.VertexOnFace(p, X.act(p), n, name=f"leg{i}") for i, p in enumerate(spots)]
        fast, slow = twins(chain, pairs)
        measurement, reference = inputs(chain, q, v, rng, legs)
        agree(fast, slow, measurement, reference)


def test_nothing_held_and_one_arm():
    chain = osc.ClosedChain(panda_pair().arms[:1])
    rng = np.random.default_rng(35)
    q = random_state(one_panda(), rng)[0]
    fast, slow = twins(chain, [])
    agree(fast, slow, *inputs(chain, q, rng.normal(size=7), rng, 0))


def test_an_arm_that_locks_more_than_its_joints_say():
    """A planar arm of four parallel hinges (rank 3) decides by singular values."""
    model = pin.Model()
    joint, X = 0, pin.SE3.Identity()
    for i in range(4):
        joint = model.addJoint(joint, pin.JointModelRZ(), X, f"hinge{i}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(0.5, 0.05), placed(0.1))
        X = placed(0.2)
    model.upperEffortLimit[:] = 50.0
    model.addFrame(pin.Frame("wrist", joint, 0, placed(0.05), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("tip", joint, 0, placed(0.2), pin.FrameType.OP_FRAME))
    arm = osc.Arm.from_urdf(model, name="arm", tip="tip")
    body = osc.RigidObject(pin.Inertia(1.0, np.array([0.02, 0.01, 0.0]), 0.01 * np.eye(3)))
    chain, rng = osc.ClosedChain([arm], payload=body), np.random.default_rng(36)
    assert chain.state(np.full(4, 0.5), np.zeros(4)).d == 3
    fast, slow = twins(chain, [])
    for _ in range(5):
        q, v = np.array([0.3, 0.6, 0.7, 0.8]) + 0.2 * rng.normal(size=4), rng.normal(size=4)
        agree(fast, slow, *inputs(chain, q, v, rng, 0))


def test_signals_are_those_of_the_numpy_law_and_stay():
    rng = np.random.default_rng(37)
    rig = osc.build_rig(osc.load_scenario("two_contact_rod", ["gains.force.rise=0 s"]))
    fast = rig.controller().with_safety(UNLIMITED)
    slow = readable_of(fast)
    disturb(rng, fast, slow)
    measurement, reference = rig.plant().measure(), rig.references.at(0.0)
    for _ in range(3):
        agree(fast, slow, measurement, reference)
    fast.f_tare, fast.engaged = np.ones(6), False  # what comes after does not change the past
    a, b = fast.last_signals(), slow.last_signals()
    for name in ("f_meas", "f_c_meas", "alpha_meas", "alpha_u", "a_u", "tau", "q", "wrenches"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-9)
    assert not fast.engaged and (fast.f_tare == 1.0).all()
    found, state = fast.result(), b.state
    np.testing.assert_allclose(found.f_meas, b.f_meas, atol=1e-9)
    np.testing.assert_allclose(found.bias_out, state.bias_out, atol=1e-9)
    np.testing.assert_allclose(found.f_c, b.f_c_meas, atol=1e-8)
    np.testing.assert_allclose(found.alpha_meas, b.alpha_meas, atol=1e-8)
    np.testing.assert_allclose(found.V_O, state.V_O, atol=1e-12)
    np.testing.assert_allclose(found.X_WO, state.X_WO.homogeneous, atol=1e-12)
    Omega_m = b.contact.motion_projection(np.linalg.inv(state.metric))
    np.testing.assert_allclose(found.free_error, Omega_m @ found.error, atol=1e-12)
    assert found.squeeze == pytest.approx(b.squeeze_d)


def test_odd_but_right_inputs_are_understood():
    """Lists, integers, strided and read-only arrays."""
    rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
    fast = rig.controller()
    measurement, reference = rig.plant().measure(), rig.references.at(0.0)
    want = rig.controller().tick(measurement, reference)
    strided = np.repeat(measurement.q, 2)[::2]
    frozen = measurement.v.copy()
    frozen.flags.writeable = False
    for change in (
        replace(measurement, q=strided),
        replace(measurement, v=frozen),
        replace(measurement, wrenches=measurement.wrenches.tolist()),
    ):
        fast = rig.controller()
        np.testing.assert_allclose(fast.tick(change, reference), want, atol=1e-9)
        assert fast.status is osc.Status.OK, fast.reason
    fast = rig.controller()
    fast.tick(measurement, replace(reference, squeeze_d=5))
    assert fast.status is osc.Status.OK, fast.reason


COUNT_ALLOCATIONS = """
import sys
import numpy as np
import osc_contact as osc
from numba.core.runtime import rtsys

rig = osc.build_rig(osc.load_scenario("two_contact_rod_friction"))
from benchmarks.cases import repeatable
controller, measurement = repeatable(rig.controller()), rig.plant().measure()
reference = rig.references.at(0.0)
for _ in range(100):
    controller.tick(measurement, reference)
assert controller.status is osc.Status.OK, controller.reason
from benchmarks.law import kernel_call
call = kernel_call(controller, measurement, reference)
start = rtsys.get_allocation_stats()
call()
end = rtsys.get_allocation_stats()
assert end.alloc == start.alloc, end.alloc - start.alloc
before = sys.getallocatedblocks()
for _ in range(100_000):
    controller.tick(measurement, reference)
    controller.motion_law.integral = np.zeros(6)
    controller.force_law.integral = np.zeros(0)
after = sys.getallocatedblocks()
assert controller.status is osc.Status.OK, controller.reason
assert abs(after - before) < 50, after - before
print("still")
"""


def run_python(*words, **environment):
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=500,
        env={**os.environ, **environment},
    )  # fmt: skip


def test_a_hundred_thousand_ticks_allocate_nothing():
    """The kernel makes not even the handle numba usually makes of each array handed over."""
    done = run_python("-c", COUNT_ALLOCATIONS, NUMBA_NRT_STATS="1")
    assert done.returncode == 0 and done.stdout == "still\n", done.stderr[-2000:]


@pytest.mark.parametrize("how", ["NUMBA_DISABLE_JIT", "NUMBA_BOUNDSCHECK"])
def test_the_same_without_compilation_and_with_checked_bounds(how, tmp_path):
    few = "every_packaged or different_bodies or dependent or locks_more or nothing_held"
    words = ("-m", "pytest", "-q", "-k", few, "-p", "no:cacheprovider", __file__)
    if os.environ.get(how):
        return  # this is that run
    done = run_python(*words, **{how: "1", "NUMBA_CACHE_DIR": str(tmp_path)})
    assert done.returncode == 0, done.stdout[-3000:]
    assert " passed" in done.stdout


def test_the_front_end_is_pinocchios_and_a_foreign_model_is_refused():
    """J, M and h on random states; joints about and along any axis; armature; a wrong model."""
    pin.seed(41)
    model, joint, X = pin.Model(), 0, placed(0.1, 0.2, 0.3, (0.3, -0.2, 0.5))
    axis = np.array([0.3, -0.5, 0.8])
    axis /= np.linalg.norm(axis)
    kinds = [pin.JointModelRX(), pin.JointModelPY(), pin.JointModelRevoluteUnaligned(*axis),
             pin.JointModelPrismaticUnaligned(*axis), pin.JointModelRY(), pin.JointModelRZ(),
             pin.JointModelPZ()]  # fmt: skip
    rng = np.random.default_rng(41)
    for i, kind in enumerate(kinds):
        joint = model.addJoint(joint, kind, X, f"joint{i}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
        X = pin.SE3.Random()
    model.upperEffortLimit[:] = 50.0
    model.addFrame(pin.Frame("tip", joint, 0, placed(0.2), pin.FrameType.OP_FRAME))
    body = osc.RigidObject(pin.Inertia(1.0, np.array([0.02, 0.01, 0.0]), 0.01 * np.eye(3)))
    chain = osc.ClosedChain([osc.Arm.from_urdf(model, name="arm", tip="tip")], payload=body)
    fast, slow = twins(chain, [])
    for _ in range(5):
        q, v = rng.uniform(-1, 1, 7), rng.normal(size=7)
        agree(fast, slow, *inputs(chain, q, v, rng, 0), 1e-10)
    row = chain.law_row(led=False).copy()
    require_pinocchio_agrees(chain, row)
    head = records(row, 0, 1, CHAIN)[0]
    records(row, int(head.joints_at), 7, JOINT).link[3][0] *= 1.0 + 1e-6
    with pytest.raises(osc.ModelError, match="differs from Pinocchio"):
        require_pinocchio_agrees(chain, row)


@pytest.mark.parametrize("seed", [1, 12, 14])
def test_an_arm_that_its_grasp_leaves_idle_motions_is_in_no_singular_posture(seed):
    case = random_case(["scara", "ur5"], ["slide", "rigid"], np.random.default_rng(seed))
    chain = osc.ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
    controller = Controller(chain, [], posture=case.q)
    measurement = Measurement(case.q, np.zeros(chain.nq), np.zeros((2, 6)))
    controller.tick(measurement, Reference(case.X_WO))
    assert controller.status is osc.Status.OK and controller.lost_directions == ()
