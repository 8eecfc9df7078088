"""Plans: stages, motions in what contacts permit, conditions, failures, a person's side."""

import numpy as np
import pinocchio as pin
from complaints import invalid_input
from numpy.testing import assert_allclose
from pytest import approx, fixture
from samples import parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.control.status import Phase, SafetyState
from osc_contact.plan import ends, motions, permitted
from osc_contact.plan import plan as plan_module
from osc_contact.plan.plan import Outcome
from osc_contact.plan.sensed import Sensed
from osc_contact.spatial import pose_error

UP = np.array([0.0, 0.0, 1.0])


@fixture(scope="module")
def rig():
    """A block on a board, in MuJoCo."""
    return rig_of("ur5_wipe")


def corners(rig):
    """Three corners of the block's lower face on the board."""
    board = rig.pairs[0]
    X = rig.state.X_WO
    places = np.array([[74, 54, -30], [74, -54, -30], [-74, 0, -30]]) / 1e3
    return [
        osc.VertexOnFace(place, X.act(place), board.face_normal, name=f"corner {k}")
        for k, place in enumerate(places)
    ]


def controller_of(rig, **options):
    options = {"life": osc.PhaseSettings(), "posture": rig.q_start} | options
    return osc.Controller(rig.chain, corners(rig), **options)


def press(name="press", force=8.0, until=None, **options):
    given = {f"corner {k}": force for k in range(3)}
    return osc.Stage(name, given, until=until or ends.after(0.1), **{"within": 2.0, **options})


def run(rig, plan, controller=None, **options):
    plant = rig.plant()
    controller = controller or controller_of(rig)
    recorder = osc.Recorder(controller)
    osc.run_loop(plant, controller, plan, recorder=recorder, **options)
    return recorder.recording()


def sensed(X=None, N=None, wrench=(0.0,) * 6):
    X = X or pin.SE3.Identity()
    N = np.zeros((6, 0)) if N is None else N
    return Sensed(X, np.zeros(6), X, np.array(wrench), {}, {}, X, N)


# --- motions ------------------------------------------------------------------------------------


def travelled(motion, ticks, dt=1e-3, **signals):
    """Poses that a motion without contacts commands, tick by tick."""
    now = sensed(**signals)
    course = motion.begin(now)
    poses = [now.aim]
    finished = None
    for k in range(ticks):
        demand = course(now, dt)
        V, misfit = permitted.permitted_twist(now.N, demand)
        assert_allclose(misfit, 0.0, atol=1e-9)
        now.aim = pin.SE3(pin.exp3(dt * V[3:]) @ now.aim.rotation, now.aim.translation + dt * V[:3])
        now.V_D = V
        poses.append(now.aim)
        if demand.finished and finished is None:
            finished = k
    return poses, finished


def test_along_ends_at_its_distance():
    poses, finished = travelled(motions.along([3, 0, 4], 0.05, 0.02), 800)
    assert_allclose(poses[-1].translation, [0.012, 0.0, 0.016], atol=2e-5)
    assert finished is not None
    speeds = np.diff([norm for X in poses if (norm := np.linalg.norm(X.translation)) > 0.0]) / 1e-3
    assert speeds.max() == approx(0.05, abs=1e-6)


def test_along_in_the_axes_of_the_object():
    R = pin.exp3(np.array([0.3, -0.2, 0.5]))
    poses, _ = travelled(motions.along([0, 1, 0], 0.01, axes="object"), 100, X=pin.SE3(R, 0 * UP))
    assert_allclose(poses[-1].translation, 1e-3 * R[:, 1], atol=1e-12)


def test_turns_end_at_their_angles():
    poses, finished = travelled(motions.about([0, 0, 2], 0.5, 0.3), 1500)
    assert finished is not None
    assert_allclose(pin.log3(poses[-1].rotation), [0, 0, 0.3], atol=2e-4)
    goal = np.array([0.6, 0.0, 0.8])
    poses, finished = travelled(motions.turn_to([0, 0, 1], goal, 1.0), 2000)
    assert finished is not None
    assert_allclose(poses[-1].rotation[:, 2], goal, atol=2e-4)


def test_to_a_pose_and_through_points():
    goal = pin.SE3(pin.exp3(np.array([0.2, 0.1, 0.0])), np.array([0.02, -0.01, 0.005]))
    poses, finished = travelled(motions.to(goal, 0.05, 0.5), 2000)
    assert finished is not None
    assert_allclose(pose_error(goal, poses[-1]), 0.0, atol=2e-4)
    points = np.array([[0, 10, 0], [10, 10, 0], [10, 0, 0]]) / 1e3
    poses, finished = travelled(motions.through(points, 0.02), 2500)
    assert finished is not None
    way = np.array([X.translation for X in poses])
    for point in points:
        assert np.linalg.norm(way - point, axis=1).min() < 5e-5


def test_a_raster_has_lines_beside_one_another():
    motion = motions.raster([1, 0, 0], [0, 1, 0], 0.02, 0.01, 0.005, 0.05)
    poses, finished = travelled(motion, 3000)
    way = np.array([X.translation for X in poses])
    assert finished is not None
    assert_allclose(way.max(axis=0), [0.02, 0.01, 0.0], atol=1e-4)
    assert way[:, 0].min() > -1e-4


def test_a_spiral_leaves_its_pitch_between_turns():
    poses, finished = travelled(motions.spiral(UP, 2e-3, 0.01, 5e-3), 8000)
    way = np.array([X.translation for X in poses])[: finished + 1]
    r = np.linalg.norm(way, axis=1)
    assert_allclose(way[:, 2], 0.0, atol=1e-12)
    assert r.max() == approx(5e-3, abs=2e-5)
    angle = np.unwrap(np.arctan2(way[10:, 1], way[10:, 0]))
    turns = np.abs(angle - angle[0]) / (2 * np.pi)
    assert_allclose(np.diff(np.interp([1, 2], turns, r[10:])), 2e-3, atol=5e-5)


def test_rocking_returns():
    poses, finished = travelled(motions.rock([1, 0, 0], 0.05, 2.0, cycles=3), 1600)
    angles = np.array([pin.log3(X.rotation)[0] for X in poses])
    assert finished == approx(1500, abs=2)
    assert_allclose([angles.max(), angles.min(), angles[-1]], [0.05, -0.05, 0.0], atol=1e-3)


@parametrize("force, share", [(0.0, 1.0), (4.0, 0.5), (8.0, 0.0), (80.0, -0.5), (-3.0, 1.0)])
def test_a_motion_yields_to_a_force(force, share):
    motion = motions.along([0, 0, -1], 0.01, yields=8.0)
    now = sensed(wrench=[0, 0, -force, 0, 0, 0])  # of the object on what it touches
    demand = motion.begin(now)(now, 1e-3)
    assert demand.values == approx(0.01 * share)


def test_motions_are_permitted_by_contacts():
    """A peg that turns about two rims slides along both; no motion is along a direction of N."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        N = rng.standard_normal((6, 3))
        demand = permitted.Demand(rng.standard_normal((2, 6)), rng.standard_normal(2))
        V, misfit = permitted.permitted_twist(N, demand)
        assert_allclose(N.T @ V, 0.0, atol=1e-9)
        assert_allclose(misfit, 0.0, atol=1e-9)


def test_what_contacts_do_not_permit_is_taken_from_the_position():
    """A light body would turn by degrees for each millimetre in its own metric."""
    face = np.array([[0, 0, -1.0, 0.014, -0.014, 0]]).T  # a corner beside the origin
    d = permitted.permitted_displacement(face, np.array([1e-3, 0, 2e-3, 0, 0, 0]))
    assert_allclose(d, [1e-3, 0, 0, 0, 0, 0], atol=1e-12)
    e = np.array([1e-3, 2e-3, 0, 0.01, 0.02, 0.03])
    assert_allclose(permitted.permitted_displacement(face, e)[3:], e[3:], atol=1e-12)
    assert_allclose(face.T @ permitted.permitted_displacement(face, e), 0.0, atol=1e-12)


def test_normals_of_one_face_that_differ_a_little_do_not_turn_shifts():
    """Their permitted shifts contain turns of some mrad/m, which small angles must not use."""
    points = np.array([[74, 54, -30], [74, -54, -30], [-74, 0, -30]]) / 1e3
    tilts = 5e-3 * np.array([[1, 0, 0], [0, 1, 0], [-1, 1, 0]])
    normals = [pin.exp3(w) @ -UP for w in tilts]
    N = np.array([np.append(n, np.cross(p, n)) for p, n in zip(points, normals, strict=True)]).T
    d = permitted.permitted_displacement(N, np.array([0, 0, 0, 1e-4, 1e-4, 0]))
    assert np.abs(d[:3]).max() < 1e-4
    V, _ = permitted.permitted_twist(N, permitted.Demand(np.eye(6)[:2], np.array([0.02, 0.0])))
    assert_allclose(V[:2], [0.02, 0.0], atol=1e-9)
    assert np.abs(V[3:]).max() < 1e-2


def test_a_blocked_motion_is_left_out():
    """Three points on a face, of which rounding leaves 1e-16 of a way along its normal."""
    n = pin.exp3(np.array([0.4, 0.3, 0.0])) @ UP
    points = np.array([[74, 54, -30], [74, -54, -30], [-74, 0, -30]]) / 1e3
    N = np.array([np.concatenate((n, np.cross(p, n))) for p in points]).T
    demand = permitted.Demand(np.append(n, 0 * n)[None], np.ones(1))
    V, misfit = permitted.permitted_twist(N, demand)
    assert_allclose(V, 0.0, atol=1e-9)
    assert_allclose(misfit, -1.0)


def test_what_a_motion_leaves_open_is_not_turned():
    face = np.array([[0, 0, -1.0, 0, 0, 0]]).T  # a point under the origin
    demand = permitted.Demand(np.eye(6)[:1], np.array([0.01]))
    V, _ = permitted.permitted_twist(face, demand)
    assert_allclose(V, [0.01, 0, 0, 0, 0, 0], atol=1e-12)


def test_motions_are_added():
    motion = motions.along([1, 0, 0], 0.01, 1e-3) & motions.about([1, 0, 0], 0.1, 0.05)
    poses, finished = travelled(motion, 2000)
    assert finished is not None
    assert_allclose(pose_error(poses[-1], pin.SE3.Identity()), [1e-3, 0, 0, 0.05, 0, 0], atol=2e-4)


@parametrize(
    "make, words",
    [
        (lambda: motions.along([0, 0, 0], 0.1), "along: direction"),
        (lambda: motions.along([1, 0, 0], -0.1), "along: speed"),
        (lambda: motions.about([1, 0, 0], 0.1, np.nan), "about: angle"),
        (lambda: motions.spiral(UP, 0.0, 0.1, 0.1), "spiral: pitch"),
        (lambda: motions.through([[1, 2]], 0.1), "through: points"),
        (lambda: motions.rock(UP, 0.1, 5.0), "98.7 rad/s², more than 10 rad/s²"),
    ],
)
def test_motions_refuse_numbers_that_are_none(make, words):
    with invalid_input(words):
        make()


# --- conditions ---------------------------------------------------------------------------------


def met(end, series, dt=0.01):
    """Index of the first of some signals at which a condition is met, or None."""
    watch = end.begin(series[0])
    found = [k for k, now in enumerate(series) if watch(now, dt)]
    return found[0] if found else None


def test_conditions_last_without_interruption():
    forces = [9, 9, 9, 0, 9, 9, 9, 9, 9]
    series = [sensed(wrench=[0, 0, -f, 0, 0, 0]) for f in forces]
    pressed = ends.pressed(7.0, -UP)
    assert met(pressed, series) == 0
    assert met(pressed.lasting(0.04), series) == 7
    assert met(pressed.lasting(0.06), series) is None


@parametrize("closed, index", [([0] * 9, 5), ([1] * 9, None), ([0, 0, 0, 1, 0, 0, 0, 0, 0], 5)])
def test_a_contact_that_flickers_is_lost(closed, index):
    """Closed for 10 ms it is not regained; for 60 ms it is."""
    series = []
    for one in closed:
        now = sensed()
        now.phases = {"a": Phase.CLOSED if one else Phase.OPEN}
        series.append(now)
    assert met(ends.lost("a", lasting=0.06), series) == index
    regained = [*series[:3], *[now for now in series if now.phases["a"] == Phase.CLOSED] * 6]
    assert met(ends.lost("a", lasting=0.09), regained) is None


def test_conditions_are_joined():
    series = []
    for k in range(10):
        now = sensed(pin.SE3(np.eye(3), np.array([0, 0, -1e-3 * k])))
        now.t, now.start = 0.01 * k, pin.SE3.Identity()
        series.append(now)
    deep, late = ends.moved(0.004, -UP), ends.after(0.07)
    assert met(deep & late, series) == 7
    assert met(deep | late, series) == 4
    assert met(ends.when(lambda now: now.X.translation[2] < -5.5e-3), series) == 6
    assert (deep & late).words == "moved by 4 mm and after 0.07 s"


def test_a_distance_counts_from_the_end_of_a_stage():
    now = sensed(pin.SE3(np.eye(3), np.array([0.01, 0, 0])))
    now.passed = {"find": pin.SE3.Identity()}
    assert met(ends.moved(0.005, [1, 0, 0], since="find"), [now]) == 0
    assert met(ends.moved(0.005, [1, 0, 0]), [now]) is None
    with invalid_input("has not been passed"):
        met(ends.moved(0.005, since="slide"), [now])


# --- plans --------------------------------------------------------------------------------------


def test_a_plan_presses_slides_and_releases(rig):
    side = rig.pairs[0].face_normal
    across = np.cross(side, [1.0, 0.0, 0.0])
    slide = press(
        "slide", until=ends.finished(), motion=motions.along(across, 0.02, 4e-3), within=3.0
    )
    lift = osc.Stage("lift", {}, motions.along(side, 0.02, 4e-3), until=ends.finished(), within=3.0)
    plan = osc.Plan([press(until=ends.after(0.5)), slide, lift])
    recording = run(rig, plan)
    assert plan.outcome is Outcome.DONE
    assert [verdict.name for verdict in plan.verdicts] == ["press", "slide", "lift"]
    assert plan.verdicts[1].rms < 0.8 and plan.verdicts[1].peak == approx(24.0, abs=3.0)
    at = [event["t"] for event in recording.events if event["event"] == "stage"]
    t = recording["t"]
    sliding = (t > at[1] + 0.05) & (t < at[2])
    assert_allclose(recording["alpha_meas"][sliding], 8.0, atol=0.8)
    moved = recording["pose"][-1, :3] - recording["pose"][0, :3]
    assert across @ moved == approx(4e-3, abs=7e-4)
    assert side @ moved == approx(4e-3, abs=7e-4)


def test_recordings_have_the_stage_of_each_tick(rig):
    plan = osc.Plan([press("one"), press("two")])
    recording = run(rig, plan)
    assert recording.meta["stages"] == ["one", "two"]
    stage = recording["stage"]
    begun = [event["t"] for event in recording.events if event["event"] == "stage"]
    assert_allclose(recording["t"][np.flatnonzero(np.diff(stage))[0] + 1], begun[1], atol=1e-9)
    assert set(stage.tolist()) == {0, 1}


def test_a_stepped_loop_runs_a_plan(rig):
    plan = osc.Plan([press(until=ends.after(0.05))])
    plant = rig.plant()
    with osc.SteppedLoop(controller_of(rig), plan=plan) as loop:
        while not plan.ended:
            plant.command(loop.step(plant.measure()), 1e-3)
        ticks = plan.verdicts[0].duration
        plant.command(loop.step(plant.measure()), 1e-3)  # holds
        with invalid_input("has a plan"):
            loop.step(plant.measure(), osc.Reference(rig.state.X_WO, alpha_d=[8.0] * 3))
    assert ticks == approx(0.05, abs=2e-3)
    with invalid_input("has no plan"):
        osc.SteppedLoop(controller_of(rig)).step(plant.measure())


def test_a_failure_leads_to_the_stage_that_follows_it(rig):
    never = ends.when(lambda now: False, "never")
    stages = [
        press("try", until=never, within=0.05, fails="rest"),
        press("rest", until=ends.after(0.02), then="try"),
    ]
    plan = osc.Plan(stages, tries=2)
    run(rig, plan)
    assert plan.outcome is Outcome.FAILED
    assert plan.reason == "stage 'try': 0.05 s without: never (2 tries)"
    assert [(one.name, one.failed) for one in plan.verdicts] == [
        ("try", True),
        ("rest", False),
        ("try", True),
    ]


def test_a_stage_fails_by_a_condition_of_its_own(rig):
    plan = osc.Plan([press(until=ends.after(1.0), unless=ends.after(0.05))])
    run(rig, plan)
    assert (plan.outcome, plan.reason) == (Outcome.FAILED, "stage 'press': after 0.05 s")


def test_a_force_above_the_largest_is_a_failure(rig):
    plan = osc.Plan([press(until=ends.after(1.0), force=8.0, largest=20.0, within=2.0)])
    with invalid_input("24 N in all, and fails above 20 N"):
        run(rig, plan)
    plan = osc.Plan([press(until=ends.after(1.0), force=8.0, within=2.0)], largest=24.0)
    run(rig, plan)
    assert plan.outcome is Outcome.FAILED
    assert plan.reason.endswith("N, more than 24 N")


def test_a_stage_after_a_large_force_takes_it_back(rig):
    """It was failed by the force of the stage before in its first tick, which ended the plan."""
    fails = press("try", until=ends.after(1.0), force=8.0, within=2.0, fails="release")
    release = osc.Stage("release", {}, until=ends.after(0.4), within=1.0)
    plan = osc.Plan([fails, release], largest=24.0)
    run(rig, plan)
    assert [(one.name, one.failed) for one in plan.verdicts] == [("try", True), ("release", False)]
    assert plan.verdicts[1].peak > 23.0
    assert plan.outcome is Outcome.DONE


def test_a_large_force_that_stays_fails_the_next_stage_too(rig, monkeypatch):
    """It goes to zero within the rise time of 0.25 s; here this is too long."""
    monkeypatch.setattr(plan_module, "RELIEF", 0.05)
    fails = press("try", until=ends.after(1.0), force=8.0, within=2.0, fails="release")
    release = osc.Stage("release", {}, until=ends.after(0.4), within=1.0, largest=5.0)
    plan = osc.Plan([fails, release], largest=24.0)
    run(rig, plan)
    assert plan.outcome is Outcome.FAILED
    assert plan.reason.startswith("stage 'release': ")
    assert plan.verdicts[1].duration == approx(0.05, abs=2e-3)


def test_pause_and_resume(rig):
    slide = press(
        until=ends.moved(3e-3, [1, 0, 0]),
        motion=motions.along([1, 0, 0], 0.01),
        within=1.0,
    )
    plan = osc.Plan([slide])
    plant = rig.plant()
    places = []
    with osc.SteppedLoop(controller_of(rig), plan=plan) as loop:
        for tick in range(1600):
            if tick == 150:
                plan.pause()
            if tick == 1300:  # longer than `within`: the clock stands still
                assert plan.outcome is Outcome.PAUSED
                plan.resume()
            plant.command(loop.step(plant.measure()), 1e-3)
            places.append(rig.chain.state(plant.measure().q).X_WO.translation[0])
    assert plan.outcome is Outcome.DONE
    assert abs(places[1299] - places[500]) < 5e-5
    assert places[-1] - places[0] > 2.9e-3


def test_an_aborted_plan_holds_without_contacts(rig):
    plan = osc.Plan([press(until=ends.after(5.0), within=9.0)])
    controller = controller_of(rig)
    plant = rig.plant()
    with osc.SteppedLoop(controller, plan=plan) as loop:
        for tick in range(800):
            if tick == 300:
                plan.abort("enough")
            plant.command(loop.step(plant.measure()), 1e-3)
    assert (plan.outcome, plan.reason) == (Outcome.ABORTED, "enough")
    assert not controller.active.any()
    assert controller.state is SafetyState.RUN
    with invalid_input("only one that is paused or stopped"):
        plan.resume()


@fixture
def stopped(rig):
    """A plan in its third stage, its plant and loop, after a stop by a dead wrist."""
    stages = [
        press("one", until=ends.after(0.05)),
        press("two", until=ends.after(0.05), reentry=True),
        press("three", until=ends.after(0.5)),
    ]
    plan = osc.Plan(stages)
    plant = rig.plant()
    loop = osc.SteppedLoop(controller_of(rig), plan=plan)
    for tick in range(700):
        read = plant.measure()
        if tick > 200:
            read = osc.Measurement(read.q, read.v, np.full_like(read.wrenches, np.nan))
        plant.command(loop.step(read), 1e-3)
    return plan, plant, loop


def test_after_a_stop_nothing_starts_by_itself(stopped):
    plan, plant, loop = stopped
    assert plan.outcome is Outcome.STOPPED
    assert plan.reason.startswith("stage 'three': ")
    with invalid_input("remove the cause"):
        plan.resume()
    loop.controller.reset()
    for _ in range(100):
        plant.command(loop.step(plant.measure()), 1e-3)
    assert plan.outcome is Outcome.STOPPED
    assert not loop.controller.active.any()


def test_resume_begins_with_the_last_stage_that_may_be_entered_again(stopped):
    plan, plant, loop = stopped
    loop.controller.reset()
    plant.command(loop.step(plant.measure()), 1e-3)
    plan.resume()
    while not plan.ended:
        plant.command(loop.step(plant.measure()), 1e-3)
    assert plan.outcome is Outcome.DONE
    assert [one.name for one in plan.verdicts] == ["one", "two", "three", "two", "three"]


def test_resume_begins_with_the_stage_that_was_entered_last_in_time(rig):
    """A failure leads back to the first stage, in which the wrist dies."""
    stages = [
        press("one", until=ends.after(0.1), reentry=True),
        press("two", until=ends.after(9.0), within=0.05, fails="one", reentry=True),
    ]
    plan = osc.Plan(stages)
    plant = rig.plant()
    loop = osc.SteppedLoop(controller_of(rig), plan=plan)
    for _ in range(2000):
        if len(plan.verdicts) == 2:
            break
        plant.command(loop.step(plant.measure()), 1e-3)
    while plan.outcome is not Outcome.STOPPED:
        read = plant.measure()
        read = osc.Measurement(read.q, read.v, np.full_like(read.wrenches, np.nan))
        plant.command(loop.step(read), 1e-3)
    assert [one.name for one in plan.verdicts] == ["one", "two", "one"]
    loop.controller.reset()
    plan.resume()
    assert plan.stage.name == "one"


def test_resume_needs_a_stage_that_may_be_entered_again(rig):
    plan = osc.Plan([press(until=ends.after(1.0), within=2.0)])
    plant = rig.plant()
    loop = osc.SteppedLoop(controller_of(rig), plan=plan)
    for tick in range(400):
        read = plant.measure()
        if tick > 50:
            read = osc.Measurement(read.q, read.v, np.full((1, 6), np.nan))
        plant.command(loop.step(read), 1e-3)
    assert plan.outcome is Outcome.STOPPED
    loop.controller.reset()
    with invalid_input("reentry=True"):
        plan.resume()


def test_a_loop_ends_after_a_stop(rig):
    """`run_loop` gives the arms a second to rest, and states the stage."""

    class Dead:
        def __init__(self, plant):
            self.plant = plant
            self.command = plant.command
            self.stopped = []
            self.ticks = 0

        def measure(self):
            read = self.plant.measure()
            self.ticks += 1
            if self.ticks < 100:
                return read
            return osc.Measurement(read.q, read.v, np.full((1, 6), np.nan))

        def stop(self, reason=""):
            self.stopped.append(reason)

    robot = Dead(rig.plant())
    plan = osc.Plan([press("long", until=ends.after(9.0), within=10.0)])
    osc.run_loop(robot, controller_of(rig), plan)
    assert plan.outcome is Outcome.STOPPED
    assert robot.stopped[-1].startswith("stage 'long': ")
    assert robot.ticks < 2500


def test_the_wrist_is_zeroed_by_a_stage_that_tares(rig):
    lift = osc.Stage("lift", {}, motions.along(UP, 0.02, 5e-3), until=ends.finished(), within=3.0)
    weigh = osc.Stage("weigh", until=ends.after(0.3), within=1.0, tare=True)
    plan = osc.Plan([lift, weigh])
    controller = controller_of(rig, in_contact=False)

    class Biased:
        def __init__(self, plant):
            self.plant = plant
            self.command, self.stop = plant.command, plant.stop

        def measure(self):
            read = self.plant.measure()
            return osc.Measurement(read.q, read.v, read.wrenches + [0.5, 0, 0, 0, 0, 0])

    osc.run_loop(Biased(rig.plant()), controller, plan, check=False)
    assert plan.outcome is Outcome.DONE
    assert np.linalg.norm(controller.f_tare[:3]) == approx(0.5, abs=0.1)


def test_bodies_are_where_stages_place_them(rig):
    moved = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1e-3]))
    plan = osc.Plan([press("one"), press("two", places={"corner 1": lambda now: moved})])
    plant = rig.plant()
    loop = osc.SteppedLoop(controller_of(rig), plan=plan)
    read = plant.measure()
    assert plan.placed(read) is read
    while not plan.ended:
        plant.command(loop.step(plant.measure()), 1e-3)
    touched = plan.placed(plant.measure()).touched
    assert_allclose(touched.X_WE[1], moved.homogeneous)
    assert_allclose(touched.X_WE[0], np.eye(4))


# --- checks -------------------------------------------------------------------------------------


def stage(name="one", forces=None, **options):
    options = {"until": ends.after(0.1), "within": 1.0} | options
    return osc.Stage(name, forces or {}, **options)


@parametrize(
    "make, words",
    [
        (lambda: osc.Plan([]), "no stages"),
        (lambda: osc.Plan([stage(), stage()]), "several stages are named 'one'"),
        (lambda: osc.Plan([stage(then="on")]), "then='on' does not exist; did you mean 'one'"),
        (lambda: osc.Plan([stage(fails="two")]), "fails='two'"),
        (lambda: stage(until=3.0), "until=3.0"),
        (lambda: stage(motion="along"), "motion='along'"),
        (lambda: stage(within=0.0), "within = 0.0"),
        (lambda: stage(forces={"corner 0": 1.0}, tare=True), "zeroes the wrist"),
    ],
)
def test_plans_are_refused_where_they_are_made(make, words):
    with invalid_input(words):
        make()


@parametrize(
    "one, words",
    [
        (stage(forces={"corner 9": 1.0}), "no contact 'corner 9'; did you mean"),
        (stage(forces={"corner 0": [1.0, 2.0]}), "has 1 columns"),
        (stage(until=ends.made("corner 0")), "ends by contact 'corner 0', which is not active"),
        (stage(unless=ends.lost("corner 0")), "ends by contact 'corner 0', which is not active"),
        (stage(places={"hole": pin.SE3.Identity()}), "no contact 'hole'"),
        (
            stage(
                forces={f"corner {k}": 1.0 for k in range(3)},
                motion=motions.along(UP, 0.01, axes="object"),
            ),
            "permit no velocity of along",
        ),
        (
            stage(
                forces={f"corner {k}": 1.0 for k in range(3)},
                motion=motions.about([1, 0, 0], 0.1, axes="object"),
            ),
            "permit no turn of about",
        ),
    ],
)
def test_plans_are_checked_before_the_first_command(rig, one, words):
    plan = osc.Plan([one])
    with invalid_input(words):
        run(rig, plan)
    assert plan.outcome is Outcome.NEW


def test_forces_above_a_ceiling_are_refused(rig):
    controller = controller_of(rig, safety=osc.SafetySettings(contact_ceiling=7.0))
    with invalid_input("above safety.contact_ceiling = 7 N"):
        run(rig, osc.Plan([press()]), controller)


def test_contacts_of_a_plan():
    plan = osc.Plan([stage(forces={"a": 1.0, "b": 2.0}), stage("two", {"b": 1.0, "c": 0.0})])
    assert plan.contacts == ("a", "b", "c")


def test_a_plan_runs_once(rig):
    plan = osc.Plan([press()])
    run(rig, plan)
    with invalid_input("the plan is done"):
        run(rig, plan)


# --- contact states -----------------------------------------------------------------------------


def recogniser_of(rig):
    """Recogniser of three corners of the block, of which it can touch with none, one or all."""
    pairs = {pair.name: pair for pair in corners(rig)}
    names = {"free": [], "on a corner": ["corner 0"], "flat": list(pairs)}
    return osc.Recogniser(osc.ContactStates(names, pairs, osc.WrenchErrors(position=1e-3)))


def test_a_stage_ends_when_a_state_is_recognised(rig):
    stages = [
        press(until=ends.recognised("flat").lasting(0.1)),
        osc.Stage(
            "lift", {}, motions.along(UP, 0.02, 8e-3), until=ends.recognised("free"), within=2.0
        ),
    ]
    plan = osc.Plan(stages, recogniser=recogniser_of(rig))
    recording = run(rig, plan)
    assert plan.outcome is Outcome.DONE, plan.reason
    assert plan.verdicts[0].ended_by == "flat recognised for 0.1 s"
    assert plan.verdicts[0].unexpected == ""
    times, names = osc.over_recording(recording, recogniser_of(rig))
    pressed = plan.verdicts[0].duration
    assert set(np.array(names)[(times > 0.1) & (times < pressed)]) == {"flat"}
    assert names[-1] == "free"


def test_a_contact_that_the_stage_does_not_assume_is_named(rig):
    """The block is moved into the board without a contact being expected."""
    stages = [
        osc.Stage("rise", {}, motions.along(UP, 0.02, 3e-3), until=ends.finished(), within=2.0),
        osc.Stage(
            "down", {}, motions.along(-UP, 5e-3), until=ends.after(3.0), within=4.0,
            unless=ends.unexpected(),
        ),
    ]  # fmt: skip
    plan = osc.Plan(stages, recogniser=recogniser_of(rig))
    recording = run(rig, plan)
    assert plan.outcome is Outcome.FAILED and "unexpected contact" in plan.reason
    down = plan.verdicts[1]
    assert down.unexpected in ("on a corner", "flat")  # the board is tilted a little
    (event,) = [one for one in recording.events if one["event"] == "unexpected"]
    assert event["state"] == down.unexpected and event["stage"] == "down"
    # noticed within 100 ms of a force of more than 1 N
    force = np.linalg.norm(recording["wrench_meas"][:, :3], axis=1)
    t = np.array(recording["t"])
    began = t[(t > down.begin + 0.2) & (force > 1.0)][0]
    assert 0.0 <= event["t"] - began < 0.1
    # the same contact is permitted where the stage says so
    stages[1] = osc.Stage(
        "down", {}, motions.along(-UP, 5e-3), until=ends.pressed(3.0, -UP), within=4.0,
        unless=ends.unexpected(), may_touch=["corner 0", "corner 1", "corner 2"],
    )  # fmt: skip
    plan = osc.Plan(stages, recogniser=recogniser_of(rig))
    run(rig, plan)
    assert plan.outcome is Outcome.DONE, plan.reason


@parametrize(
    "stage, words",
    [
        ({"until": ends.recognised("flat")}, "give the plan a recogniser"),
        ({"until": ends.after(1.0) | ends.recognised("tilted")}, "no contact state 'tilted'"),
        ({"until": ends.after(1.0), "unless": ends.unexpected()}, "give the plan a recogniser"),
        ({"until": ends.after(1.0), "may_touch": ["rim"]}, "may_touch='rim'"),
    ],
)
def test_conditions_on_contact_states_are_checked(rig, stage, words):
    recogniser = None if "recogniser" in words else recogniser_of(rig)
    plan = osc.Plan([osc.Stage("a", within=2.0, **stage)], recogniser=recogniser)
    with invalid_input(words):
        run(rig, plan)
