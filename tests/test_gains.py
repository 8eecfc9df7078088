"""Gains that serve every mass: what they are, what the law makes of them, and what it brings."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import invalid_input, refusals, scenario_error
from kkt_oracle import held
from pytest import approx
from rigs import (
    PANDA_Q,
    assert_near,
    contact_of,
    largest,
    one_panda,
    placed,
    pose_at,
    random_faces,
    random_state,
    rig_of,
    terms_at,
    ticked,
    unit,
    unloaded,
    vector,
)
from samples import chosen, first, parametrize
from scenario_runs import run_of

import osc_contact as osc
from benchmarks.cases import POINT
from benchmarks.random_tasks import draw
from osc_contact import robots

DT = 1e-3
K = 10 * np.pi  # 1/s: 5 Hz
ARMATURE = "arms.{}.armature={}"


# What they are ------------------------------------------------------------------------------------


def test_gains_of_holds_at_zero_force_follow_from_those_of_the_task():
    """Brake at least 2 K_i, integral at most a twelfth of it; none without a brake."""
    gains = osc.ForceGains()
    assert (gains.hold_brake, gains.hold_integral) == (approx(2 * K), approx(K / 6))
    given = osc.ForceGains(integral=4, damping=0, brake=60)
    assert (given.hold_brake, given.hold_integral) == (60.0, 4.0)
    plain = osc.ForceGains(integral=30, damping=5)
    assert (plain.hold_brake, plain.hold_integral) == (0.0, 30.0)


def test_gains_in_words_and_the_numbers_they_stand_for():
    motion = osc.MotionGains(frequency=2.0, damping_ratio=0.5, integral_time=0.25)
    assert motion.stiffness == approx((4 * np.pi) ** 2)
    assert motion.damping == approx(4 * np.pi)
    assert motion.integral == approx(4 * motion.stiffness)
    assert osc.MotionGains(motion.stiffness, motion.damping).frequency == approx(2.0)
    assert osc.MotionGains() == osc.MotionGains(400, 40, 0)
    force = osc.ForceGains(bandwidth=3.0, damping_ratio=0.6)
    assert force.integral == approx(6 * np.pi) and force.damping == 0.0
    assert force.brake == approx(2 * 0.6 * 6 * np.pi) and force.rise == 0.25
    assert osc.ForceGains() == osc.ForceGains(bandwidth=5.0, damping_ratio=0.7, rise=0.25)
    plain = osc.ForceGains(30, 100)
    assert (plain.integral, plain.damping, plain.brake, plain.rise) == (30, 100, 0, 0)
    assert force.replaced(rise=0.0).brake == force.brake
    assert motion.replaced(integral_time=None).stiffness == motion.stiffness


@parametrize(
    "gains, frequency, integral_time",
    [
        ("{}", 4.0, 0.2),
        ("{motion: {damping_ratio: 0.7}}", 4.0, 0.2),
        ("{motion: {frequency: 3 Hz}}", 3.0, 0.2),
        ("{motion: {integral_time: 1 s}}", 4.0, 1.0),
        ("{motion: {stiffness: 900, damping: 60}}", 30.0 / (2.0 * np.pi), np.inf),
    ],
)
def test_a_tare_has_other_defaults_of_the_motion_loop(gains, frequency, integral_time):
    """A faster loop with an integral; keys that are given stay."""
    with_tare = rig_of("panda_dome", f"gains={gains}", "tare={}").gains.motion
    assert (with_tare.frequency, with_tare.integral_time) == (approx(frequency), integral_time)
    without = rig_of("panda_dome", "gains={}").gains.motion
    assert (without.frequency, without.integral_time) == (approx(10.0 / np.pi), np.inf)


@parametrize(
    "gains, bandwidth, damping_ratio",
    [
        ("{}", 2.0, 1.5),
        ("{force: {rise: 0.1 s}}", 2.0, 1.5),
        ("{force: {bandwidth: 5 Hz}}", 5.0, 0.7),
        ("{force: {damping_ratio: 1}}", 5.0, 1.0),
        ("{force: {integral: 30, damping: 60}}", 15.0 / np.pi, 0.0),
    ],
)
def test_a_tare_has_other_defaults_of_the_force_loop(gains, bandwidth, damping_ratio):
    """Less integral and more damping, unless one of the two is given."""
    with_tare = rig_of("panda_dome", f"gains={gains}", "tare={}").gains.force
    assert (with_tare.bandwidth, with_tare.damping_ratio) == (approx(bandwidth), damping_ratio)
    without = rig_of("panda_dome", "gains={}").gains.force
    assert (without.bandwidth, without.damping_ratio) == (5.0, 0.7)


test_gains_of_both_kinds_and_impossible_ones_are_refused = refusals(
    invalid_input,
    {
        "bandwidth beside integral": lambda: osc.ForceGains(integral=30, bandwidth=5),
        "damping_ratio beside damping": lambda: osc.ForceGains(damping=3, damping_ratio=1),
        "integral: must be >= 0; got -1": lambda: osc.ForceGains(integral=-1.0),
        "damping: expected a plain number; got nan": lambda: osc.ForceGains(30.0, np.nan),
        "stability margin": lambda: osc.Controller(
            one_panda(), [], osc.Gains(force=osc.ForceGains(1000.0))
        ),
        "bandwidth: must be > 0; got -1": lambda: osc.ForceGains(bandwidth=-1),
        "rise: expected a time.*got inf": lambda: osc.ForceGains(rise=np.inf),
        "frequency beside stiffness": lambda: osc.MotionGains(stiffness=30, frequency=5),
        "frequency: must be > 0; got 0": lambda: osc.MotionGains(frequency=0),
        "raise integral_time": lambda: osc.MotionGains(frequency=5, integral_time=0.01),
    },
)


def test_scenarios_take_both_kinds_and_name_the_others():
    scenario = osc.load_scenario("ur5_wipe", ["gains={}"])
    assert rig_of(scenario).gains == osc.Gains()
    own = "gains={motion: {frequency: 4 Hz, damping_ratio: 0.8}, force: {bandwidth: 3 Hz}}"
    gains = rig_of("ur5_wipe", own).gains
    assert gains.motion == osc.MotionGains(frequency=4, damping_ratio=0.8)
    assert gains.force == osc.ForceGains(bandwidth=3)
    assert osc.Scenario.from_dict(scenario.as_dict()) == scenario
    for sets, words in {
        "gains.force.bandwidth=3 Hz": "--set 'gains.force={bandwidth: 5 Hz}'",
        "gains.motion.frequency=3 Hz": "--set 'gains.motion={frequency: 5 Hz}'",
        "gains.motion={stiffness: 400}": "stiffness .* and damping .* together",
        "gains.force={damping: 4}": "damping .* goes with integral",
    }.items():
        with scenario_error(words.replace("{", r"\{")):
            osc.load_scenario("two_contact_rod", [sets])


# What the law makes of them -----------------------------------------------------------------------


def test_the_brake_decelerates_the_contact_whatever_the_mass():
    """The acceleration of a full system of equations changes by −κ NᵀV along N."""
    chain = one_panda()
    rng = np.random.default_rng(5)
    kappa = 44.0
    for mass in (0.1, 1.0, 6.0):
        body = pin.Inertia(mass, vector(0.01, 0.02, 0.0), 0.02 * mass * np.eye(3))
        holding = osc.ClosedChain(chain.arms, chain.grasps, osc.RigidObject(body))
        q, v = random_state(chain, rng)
        v *= 0.01
        state = holding.state(q, v)
        pairs = random_faces(state.X_WO, 2, rng)
        measurement = unloaded(q, v)
        reference = osc.Reference(state.X_WO, alpha_d=np.zeros(2))
        found = []
        for brake in (kappa, 0.0):
            gains = osc.Gains(osc.MotionGains(), osc.ForceGains(0.0, brake=brake))
            one = osc.Controller(holding, pairs, gains, posture=q, reading="filter")
            tau = ticked(one, measurement, reference)
            found.append(held(holding, q, v).answer(tau).a_object)
        N = contact_of(pairs, state).N
        assert_near(N.T @ np.subtract(*found), -kappa * N.T @ state.V_O, atol=1e-9, rtol=1e-8)


def test_other_gains_continue_while_a_step_is_made():
    """Half way up, to gains that know no rise: the force commanded does not jump."""
    changes = ["gains={}", "plant.type=rigid", "plant.step=1 ms", "motion=[]"]
    rig = rig_of("two_contact_rod", *changes)
    plant = rig.plant()
    controller = rig.controller()
    reference = replace(rig.references.at(0.0), alpha_d=vector(20.0, 15.0))
    commanded = []
    for k in range(400):
        if k == 125:
            controller = controller.with_gains(osc.Gains(force=osc.ForceGains(K)))
        plant.command(controller.tick(plant.measure(), reference), DT)
        commanded.append(controller.signals.alpha_u)
    change = np.abs(np.diff(commanded, axis=0)).max(axis=1)
    assert change.max() < 1.05 * change[:124].max()
    assert_near(commanded[-1], [20.0, 15.0], atol=0.05)


# What it brings: MuJoCo, default gains ------------------------------------------------------------


def pressed(scenario, step_of, value=10.0):
    """Each contact pressed with 10 N at rest; one with 5 N more at 0.5 s."""
    forces = {name: [{"type": "constant", "value": value}] for name in scenario.force}
    forces[step_of].append({"type": "step", "value": 5.0, "start": 0.5})
    return run_of(scenario.replaced(force=forces, motion=[], gains={}, duration=1.0))


def overshoots(run):
    """Relative overshoots of first contact and step, and effect of the step on other forces (N)."""
    commanded = run["alpha_cmd"]
    k = int(np.searchsorted(run["t"], 0.5 - 1e-9))
    over = run["alpha_true"] - commanded
    stepped = commanded[k] - commanded[k - 1] > 1.0
    return (
        (over[:k] / commanded[0]).max(),
        over[k:, stepped].max() / 5.0,
        largest(over[k:, ~stepped]),
    )


def one_arm(robot, tip, posture, push, armature):
    """An arm alone, a rod in its hand, the end of which is pressed against a face."""
    arm = osc.Arm.from_urdf(robots.find_robot(robot)[0], name="arm", tip=tip)
    grasp = placed(z=0.29, rpy=(0, -np.pi / 2, 0))
    X = pose_at(arm.model, np.array(posture), tip) * grasp
    push = unit(np.array(push))
    at = X.act(vector(0.29, 0.0, 0.0)) + 0.01 * push

    def pose(X):
        return {"xyz": X.translation, "rpy": pin.rpy.matrixToRpy(X.rotation)}

    arm = {"name": "arm", "urdf": f"example-robot-data:{robot}", "tip": tip, "wrist_sensor": tip}
    (nose,) = POINT["contacts"]
    face = nose["face"] | {"point": at, "normal": -push}
    changes = {
        "arms": [arm | {"posture": posture, "armature": armature}],
        "object": {"urdf": "rod.urdf", "pose": pose(X)},
        "grasps": {"arm": pose(grasp)},
        "contacts": [nose | {"vertex": [0.29, 0, 0], "radius": 0.01, "face": face}],
        "motion": [],
    }
    return osc.Scenario.from_dict(POINT | changes)


DOWN = [0.2, 0.1, -1.0]
UR10 = ("ur10", "tool0", [0, -1.4, 1.9, -1.9, -1.57, 0.3], DOWN)
TALOS = ("talos_left_arm", "gripper_left_base_link")
ARMS = {
    "0.5 kg": ("kinova", "j2s6s200_end_effector", [0, 2.9, 1.3, 4.2, 1.4, 0], DOWN, 0.0),
    "1.5 kg": (*TALOS, [0.3, 0.2, -1.5, 0.3, 0.3, 0.1], [-1, 0, -0.3], 0.0),
    "4.6 kg": (*UR10, 0.0),
    "40 kg": (*UR10, 10.0),
}


@parametrize("mass", chosen(ARMS, "0.5 kg", "40 kg"))
def test_first_contact_and_steps_overshoot_little_whatever_the_mass(mass):
    assert np.max(overshoots(pressed(one_arm(*ARMS[mass]), "nose"))[:2]) < 0.2


STRETCHED = {
    "0.0001": ([0.6, 0.01, -0.15, 0.85, -0.1, -0.1], [-0.3, 0.16, 0.94]),
    "0.002": ([0.15, 0.06, -0.05, 0.37, 0.0, 0.04], [0.15, -0.05, 0.99]),
    "0.012": ([0.15, 0.32, -0.19, 0.13, 0.33, 0.08], [0.18, -0.45, 0.87]),
    "overloaded": ([0.74, 0.79, -0.49, 0.69, 0.41, -0.26], [0.18, -0.96, 0.22]),
}


@parametrize("chi", STRETCHED)
def test_near_singular_contact_is_made_softly_and_kept_or_the_run_is_refused(chi):
    """Talos' arm without joint friction; the last posture's weight is above a motor's limit."""
    data = one_arm(*TALOS, *STRETCHED[chi], 0.0).as_dict()
    data["arms"][0] |= {"friction": 0.0, "damping": 0.0}
    scenario = osc.Scenario.from_dict(data)
    if chi == "overloaded":
        with scenario_error(r"arm_left_2_joint needs 24\.3\d N m .*limit of 22"):
            run_of(scenario)
        return
    state = rig_of(scenario).state
    assert min(lost.chi for lost in state.singular_directions) < 1.3 * float(chi)
    run = pressed(scenario, "nose")
    assert np.max(overshoots(run)[:2]) < 0.2
    assert run["alpha_true"][run["t"] > 0.3].min() > 9.5


HEAVY = [ARMATURE.format(side, 2) for side in ("left", "right")]
STEPS = [("two_contact_rod", HEAVY, "left_end"), ("three_arm_plate", [], "post_1")]
STEPS += [("two_contact_rod", [], "left_end"), ("scara_peg", [], "wall_x")]


@parametrize("case", first(STEPS))
def test_a_step_of_one_force_hardly_moves_the_others(case):
    name, changes, step_of = case
    assert np.max(overshoots(pressed(osc.load_scenario(name, changes), step_of))) < 0.2


@parametrize("armature", first([0.5, 0.0], 1))
def test_a_wiping_arm_does_not_ring_with_heavy_rotors(armature):
    """Rocking of the cloth meets 470 kg at its corners then."""
    run = run_of("ur5_wipe", ARMATURE.format("ur5", armature), "gains={}", "duration=1.6 s")
    t = run["t"]
    error = run["alpha_true"] - run["alpha_cmd"]
    assert (error[t < 0.5] / run["alpha_cmd"][0]).max() < 0.2
    assert np.sqrt(np.mean(error[t > 1.0] ** 2)) < 0.01 * 8.0


# Speed limits -------------------------------------------------------------------------------------


@parametrize("seed", range(6))
def test_errors_of_the_pose_are_corrected_within_speed_limits(seed):
    """At rest the feedback K_p J̄e of a joint is at most 2 K_d times 0.9 of its speed limit.

    J̄ = M⁻¹Jᵀ(JM⁻¹Jᵀ)⁻¹ is that of Pinocchio's M and J.
    """
    rng = np.random.default_rng(seed)
    chain = one_panda()
    model = chain.arms[0].model
    gains = osc.MotionGains(frequency=rng.uniform(1.0, 8.0))
    q = random_state(chain, rng)[0]
    zero = np.zeros(7)
    X_WO = chain.state(q, zero).X_WO
    terms = terms_at(model, q, zero)
    frame = model.getFrameId(chain.arms[0].tip)
    J = pin.getFrameJacobian(model, terms, frame, pin.LOCAL_WORLD_ALIGNED)
    lever = X_WO.translation - terms.oMf[frame].translation
    J[:3] -= pin.skew(lever) @ J[3:]
    M_inv = np.linalg.inv(np.triu(terms.M) + np.triu(terms.M, 1).T)
    J_bar = M_inv @ J.T @ np.linalg.inv(J @ M_inv @ J.T)
    e = 10.0 ** rng.uniform(-2.0, 0.5) * unit(rng.standard_normal(6))
    X_WD = pin.SE3(pin.exp3(e[3:]) @ X_WO.rotation, X_WO.translation + e[:3])
    controller = osc.Controller(chain, [], gains=osc.Gains(gains))
    controller.tick(osc.Measurement(q, zero, np.zeros((1, 6))), osc.Reference(X_WD))
    change = gains.stiffness / gains.damping * np.abs(J_bar @ e)
    share = min(1.0, 2.0 * 0.9 / (change / model.velocityLimit).max())
    assert_near(controller.result().a_u, share * gains.stiffness * e, rtol=1e-8)


def test_a_motion_law_of_the_users_gets_the_whole_integral_of_the_error():
    """The law that stands in place of the feedback limits speeds by itself, if at all."""
    chain = one_panda()
    gains = osc.Gains(osc.MotionGains(frequency=4.0, integral_time=0.2))
    at_rest = osc.Measurement(PANDA_Q, np.zeros(7), np.zeros((1, 6)))
    X_WO = chain.state(PANDA_Q, np.zeros(7)).X_WO
    far = osc.Reference(pin.SE3(X_WO.rotation, X_WO.translation + [0.0, 2.0, 0.0]))
    parts = {}
    for name, motion in {"own": lambda *_: np.zeros(6), "built in": None}.items():
        controller = osc.Controller(chain, [], gains, dt=DT, laws=osc.Laws(motion=motion))
        controller.tick(at_rest, far)
        parts[name] = controller.motion_integral[1] / (2.0 * DT)
    assert parts["own"] == approx(1.0) and parts["built in"] < 0.5


@parametrize("seed, number", [(550118, 48)])
def test_a_joint_that_friction_has_held_breaks_loose_within_its_speed_limit(
    own_plants, seed, number
):
    """The last joint of this arm is all rotor, and its errors had grown to several times the limit.

    Beyond its limit for 20 ms the arm stopped.
    """
    task = draw(seed, number)
    task = replace(task, changes=[*task.changes, "control.life=off"])
    recording = osc.run(task.load(), seed=number, duration=1.6)
    assert recording.meta["end_state"] == "RUN"


@parametrize("seed, number", [(24101, 22)])
def test_a_light_joint_follows_although_contact_friction_turns_it(own_plants, seed, number):
    """The last link is all rotor; feedback that was as small at rest as near the limit lost it."""
    recording = osc.run(draw(seed, number).load(), seed=number)
    assert osc.metrics(recording)["task"]["word"] == "OK"


@parametrize("seed, number", [(665665, 17)])
def test_a_joint_does_not_break_loose_faster_than_its_encoder_shows(own_plants, seed, number):
    """With twice the feedback at rest its estimated speed was taken for a fault after 2 s."""
    recording = osc.run(draw(seed, number).load(), seed=number, duration=2.5)
    assert recording.meta["end_state"] == "RUN"
