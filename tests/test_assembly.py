"""Insertion of a peg: the world, what is drawn for a seed, the judge, and a whole plan."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from command_line import answered, call, done, read_json, refused
from numpy.testing import assert_allclose
from pytest import MonkeyPatch, approx, fixture, raises
from samples import parametrize

import osc_contact as osc
from benchmarks.assembly import summary
from osc_contact.control.status import Phase
from osc_contact.dynamics.assembly import reach
from osc_contact.lab.tasks import pegs
from osc_contact.lab.tasks.insertion import (
    DEPTH,
    LENGTH,
    LOWER,
    PERIOD,
    SECTORS,
    WIDTH,
    Insertion,
    World,
    hole_solids,
)
from osc_contact.lab.tasks.packaged import TASKS, task_content
from osc_contact.lab.tasks.pegs import (
    Inserted,
    controller_of,
    insert,
    peg_plan,
    peg_start,
)
from osc_contact.lab.tasks.two_pin_plan import bar_start, insert_both
from osc_contact.lab.tasks.two_pins import BAR, HALF, TwoPins

PEG = osc.Peg("square", WIDTH)


def task_of(seed=3, shape="square", **options):
    return Insertion(osc.Peg(shape, WIDTH), 2e-4, seed, **options)


@fixture(scope="module")
def robot():
    """Robot that holds its peg above the hole."""
    task = task_of()
    return task.robot(peg_start(task.peg, task.hole))


def test_displacements_are_drawn_by_seed():
    drawn = np.array([task_of(seed).displacement for seed in range(400)])
    most = np.repeat([2e-3, np.radians(2.0)], 3)
    assert (np.abs(drawn) <= most).all()
    assert (np.abs(drawn).max(axis=0) > 0.97 * most).all()
    assert_allclose(drawn[7], task_of(7).displacement)
    told = np.array([task_of(seed).hole.width for seed in range(400)]) - WIDTH
    assert 18e-6 < np.abs(told - 2e-4).max() <= 20e-6


def test_the_plan_is_not_told_where_the_hole_is():
    one, two = task_of(1), task_of(2)
    assert_allclose(one.hole.pose.homogeneous, two.hole.pose.homogeneous)
    apart = one.true_hole.pose.translation - one.hole.pose.translation
    assert_allclose(apart, one.displacement[:3])
    masses = [task.model.arms[0].model.inertias[3].mass for task in (one, two)]
    assert masses[0] != masses[1]


def test_the_peg_begins_where_it_was_put(robot):
    """Encoders of 18 bits place it within some hundredths of a millimetre."""
    task = robot.task
    X = robot.chain.state(robot.measure().q).X_WO
    assert_allclose(X.translation, peg_start(PEG, task.hole).translation, atol=5e-5)
    seen = task.true_hole.pose * robot.in_hole()
    assert_allclose(seen.homogeneous, X.homogeneous, atol=5e-5)


def test_sensors_err_as_stated():
    task = task_of(world=World(force_noise=0.2, torque_noise=0.01))
    robot = task.robot(peg_start(task.peg, task.hole))
    model = robot.chain.model
    tau = pin.computeGeneralizedGravity(model, model.createData(), robot.q_start)
    read = []
    for _ in range(400):
        robot.command(tau, PERIOD)
        read.append(robot.measure().wrenches[0])
    noise = np.std(read, axis=0)
    assert_allclose(noise[:3], 0.2, rtol=0.2)
    assert_allclose(noise[3:], 0.01, rtol=0.2)
    assert robot.largest_sum == robot.mean_sum == 0.0  # it is in the air


@parametrize("shape", ["square", "round"])
def test_the_hole_is_as_wide_and_as_deep_as_stated(shape):
    """A peg that is put into it upright touches nothing; one 0.15 mm aside touches a wall."""
    for aside, touched in ((0.0, False), (1.5e-4, True)):
        task = task_of(shape=shape, offset=0.0, tilt=0.0)
        place = pin.SE3(np.eye(3), np.array([aside, 0.0, 0.5 * DEPTH]))
        robot = task.robot(task.true_hole.pose * place)
        robot.command(np.zeros(robot.chain.n_a), PERIOD)
        assert (np.abs(robot.contact_forces()).max(initial=0.0) > 1.0) == touched


def test_square_pegs_are_inserted():
    """At least two of three; one may lean by little more than the clearance permits."""
    results = [insert(task_of(seed)) for seed in range(3)]
    assert sum(result.success for result in results) >= 2, results
    for result in results:
        assert result.reason == ""
        assert result.depth == approx(DEPTH, abs=1e-3)
        assert result.tries <= 3
        assert 8.0 < result.largest_sum < 60.0
        assert 3.0 < result.mean_sum < 0.7 * result.largest_sum


def test_a_round_peg_is_upright_in_the_mouth_at_the_first_try():
    """It finds face and rim, and turns upright there. On the way in it may jam, a known limit."""
    task = task_of(3000, "round")
    plan = peg_plan(task.peg, task.hole)
    robot = task.robot(peg_start(task.peg, task.hole))
    with osc.SteppedLoop(controller_of(task, plan, robot), plan=plan) as loop:
        while plan.stage.name != "insert" and not plan.ended:
            robot.command(loop.step(robot.measure()), PERIOD)
    X = robot.in_hole()
    assert [verdict.failed for verdict in plan.verdicts] == [False] * 6
    assert 3e-3 < X.translation[2] < 13e-3
    assert np.arccos(X.rotation[2, 2]) < np.radians(3.5)  # the hole's axis is up to 2.8 degrees off
    assert robot.largest_sum < 60.0


def test_contacts_of_the_plan_are_those_of_the_controller(robot):
    task = robot.task
    plan = peg_plan(task.peg, task.hole)
    controller = controller_of(task, plan, robot)
    assert [pair.name for pair in controller.contacts] == list(plan.contacts)
    plan.begin(controller, robot.measure())  # which checks it
    assert plan.stage.name == "weigh"


def test_a_tip_slides_on_one_box_of_a_round_hole():
    """Beside the line on which tips slide, boxes are lower, so that no edge of a side stops one."""
    _, *around = hole_solids(task_of(shape="round").true_hole)
    tops = np.array([box.centre[2] - 0.5 * box.edges[2] for box in around])
    angles = np.array([box.turn for box in around])
    on_axis = np.abs(np.sin(2.0 * angles)) < 1e-9
    assert_allclose(tops[on_axis], 0.0, atol=1e-15)
    assert_allclose(tops[~on_axis], LOWER, atol=1e-15)
    assert on_axis.sum() == 4 and len(around) == SECTORS


def overlap(peg, box, n):
    """Overlap (m) of a round peg and a box along a direction from the peg into the box.

    Args:
        peg: pose of the peg, in the frame of the block.
        box: solid of the block.
        n: (3,) direction, in the frame of the block.
    """
    along = peg.rotation.T @ n
    rim = 0.5 * WIDTH * np.hypot(along[0], along[1]) - min(LENGTH * along[2], 0.0)
    half = 0.5 * np.abs(pin.exp3(np.array([0.0, 0.0, box.turn])).T @ n) @ box.edges
    return n @ (peg.translation - box.centre) + rim + half


@parametrize("place", ["face", "rims"])
def test_depths_of_contacts_are_overlaps_along_their_normals(place):
    """The tip is round, and sinks in by some micrometres at most, or lies on several rims."""
    task = task_of(shape="round")
    robot = task.robot(peg_start(task.peg, task.hole))
    plant, hole = robot.plant, task.true_hole.pose
    model, contacts = plant.model, plant.data.contact
    (tip,) = np.flatnonzero(model.geom_bodyid == plant.object_body)
    first = np.flatnonzero(model.geom_bodyid == model.body("face0/root").id)[0]
    boxes = hole_solids(task.true_hole)
    rng = np.random.default_rng(0)
    for _ in range(100):
        if place == "face":
            depth = 10.0 ** rng.uniform(-8.0, -5.5)
            lowest = np.array([0.011 + rng.uniform(0, 2e-3), rng.uniform(-2e-3, 2e-3), depth])
            turn = pin.exp3(np.array([0.0, -rng.uniform(0.1, 0.2), 0.0]))
        else:
            lowest = np.array([7.393e-3, 3.0e-3, 6.82e-4]) + rng.uniform(-2e-5, 2e-5, 3)
            turn = pin.exp3(np.array([0.026, -0.172, -0.009]) + rng.uniform(-1e-3, 1e-3, 3))
        point = turn.T @ [0.0, 0.0, 1.0] * [1.0, 1.0, 0.0]
        point *= 0.5 * WIDTH / np.linalg.norm(point)
        placed = hole * pin.SE3(turn, lowest - turn @ point)
        plant.reset(reach(robot.chain, task.scene.posture, placed))
        peg = hole.actInv(pin.SE3(plant.poses()[0]))
        for pair, depth, frame in zip(contacts.geom, -contacts.dist, contacts.frame, strict=True):
            box = boxes[pair.sum() - tip - first]
            n = hole.rotation.T @ frame[:3] * (1.0 if pair[0] == tip else -1.0)
            assert overlap(peg, box, n) == approx(depth, abs=1e-8), n
            if place == "face":
                assert n[2] == approx(1.0, abs=1e-4)
        assert len(contacts.dist) >= (1 if place == "face" else 2)


# --- two arms, two pins ---------------------------------------------------------------------------


def test_two_arms_hold_the_bar_where_it_was_put():
    task = TwoPins(5)
    robot = task.robot(bar_start(task))
    assert_allclose(robot.pose().homogeneous, bar_start(task).homogeneous, atol=1e-6)
    measured = robot.measure()
    assert measured.wrenches.shape == (2, 6)
    block = task.true_block
    for name, hole in task.true_holes.items():  # both holes move with the block
        place = block.actInv(hole.pose)
        expected = [-HALF if name == "left" else HALF, 0.0, 0.0]
        assert_allclose(place.translation, expected, atol=1e-12)
    bar = task.chain().payload.inertia
    assert bar.mass == approx(0.6)
    apart = [pin.Inertia.FromCylinder(0.1, 0.5 * WIDTH, LENGTH)] * 2
    moments = apart[0].inertia[1, 1] + apart[1].inertia[1, 1] + 0.2 * HALF**2
    own = pin.Inertia.FromBox(0.4, *BAR).inertia[1, 1]
    shift = 0.5 * LENGTH + 0.5 * BAR[2]  # between the middles of bar and pins
    expected = moments + own + 0.4 * 0.2 / 0.6 * shift**2
    assert bar.inertia[1, 1] == approx(expected, rel=1e-9)


def test_both_pins_are_in_their_holes_at_once():
    """The plan ends as done; the truth agrees, and no force was large."""
    result = insert_both(TwoPins(3))
    assert result.reason == "" and result.success, result
    assert result.depth == approx(DEPTH, abs=1e-3)
    assert result.largest_sum < 60.0


# --- packaged tasks: one command, with files and a verdict ----------------------------------------


@fixture(scope="module")
def weighed(tmp_path_factory):
    """Run of the command with a plan of its first stage only, which ends above the hole."""
    folder = tmp_path_factory.mktemp("task")
    with MonkeyPatch.context() as patch:
        patch.setattr(pegs, "peg_plan", lambda *of: osc.Plan(peg_plan(*of).stages[:1]))
        result = call(f"run round_peg --seed 4 --out {folder} --json {folder}/again.json")
    return result, folder


def test_a_task_is_one_command(weighed):
    result, folder = weighed
    files = ("metrics.json", "recording.npz", "scene.html")
    assert all((folder / name).stat().st_size > 100 for name in files)
    assert not (folder / "unfinished.mcap").exists()
    verdict = read_json(folder / "metrics.json")
    assert verdict == read_json(folder / "again.json")
    assert (verdict["scenario"], verdict["seed"]) == ("round_peg", 4)
    (stage,) = verdict["plan"]["stages"]
    assert stage["name"] == "weigh" and stage["duration"] == approx(0.4, abs=2e-3)
    assert "stage weigh" in result.stdout


def test_a_peg_that_is_not_in_its_hole_fails_the_task(weighed):
    """The plan is done, and the verdict is that of the truth."""
    result, folder = weighed
    verdict = read_json(folder / "metrics.json")
    assert verdict["plan"]["outcome"] == "done"
    assert verdict["task"]["word"] == "NOT DONE" and result.exit_code == 1
    (why,) = verdict["task"]["why"]
    depth = 1e3 * verdict["inserted"]["depth"]
    assert depth < -3.0 and why.startswith(f"the peg is {depth:.1f} mm deep, tilted by ")


def test_a_recording_of_a_task_is_drawn_with_the_true_hole(weighed, tmp_path):
    _, folder = weighed
    recording = osc.Recording.load(folder / "recording.npz")
    block = task_content(recording).bodies[1]
    task = task_of(4, "round")
    assert_allclose(block.base.homogeneous, task.true_hole.pose.homogeneous)
    page = tmp_path / "task.html"
    done(f"view {folder} --html {page}")
    assert page.stat().st_size > 100_000
    recording.meta["packaged_task"] = "round_pegs"
    with raises(osc.RecordingError, match="'round_pegs'; did you mean 'round_peg'"):
        task_content(recording)


@parametrize("option", ["--set control.rate=2kHz", "--plant rigid", "--duration 2"])
def test_options_of_scenarios_are_refused(option):
    assert "change scenarios, not a task" in refused(f"run square_peg {option}")


def test_tasks_are_listed():
    _, found = answered("list")
    assert set(found["tasks"]) == {"round_peg", "square_peg", "two_pins"} == set(TASKS)


def test_summary():
    done = Inserted(True, "", 0.03, 0.0, 9.0, 1, 20.0, 15.0, 6.0)
    jammed = Inserted(False, "stage 'insert': time", 0.01, 0.1, 30.0, 3, 60.0, 50.0, 9.0)
    text = summary([done, done, jammed])
    assert text.startswith("2 of 3; time of these: median 9.0 s; peak")
    assert text.endswith("mean of the sum: median 6.0 N")


def test_the_lowest_corner_of_a_rectangular_peg_begins_beside_its_hole():
    peg = osc.Peg("square", 0.012, width_y=0.008)
    hole = osc.Hole("square", 0.0122, 0.03, width_y=0.0081)
    corner = peg_start(peg, hole).act(np.array([0.006, 0.004, 0.0]))
    beside = np.array([0.0061, 0.00405, 0.0]) + pegs.LEAD * np.array([1.0, 1.0, 0.0])
    assert_allclose(corner, beside - [0.0, 0.0, pegs.HEIGHT], atol=1e-12)


def watched(end, signals):
    """First tick of 1 ms in which a condition is met, of the signals of each tick; None: never."""
    met = end.begin(signals[0])
    return next((k for k, now in enumerate(signals) if met(now, 1e-3)), None)


def lowered(depths):
    """Signals of an object at these depths (m)."""
    return [SimpleNamespace(X=pin.SE3(np.eye(3), np.array([0.0, 0.0, z]))) for z in depths]


def test_an_object_that_creeps_in_its_grasp_has_not_found_a_hole():
    slow = np.linspace(0.0, 2e-3, 4000)  # 0.5 mm/s
    sunk = pegs.sunk(5e-4, np.array([0.0, 0.0, 1.0]), np.zeros(3), recent=0.8)
    assert watched(sunk, lowered(slow)) is None
    fall = np.append(slow, slow[-1] + np.linspace(0.0, 7e-4, 50))
    assert 4000 <= watched(sunk, lowered(fall)) < 4050
    from_the_start = pegs.sunk(5e-4, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert watched(from_the_start, lowered(slow)) == approx(1000, abs=2)


def test_a_side_is_lost_only_after_it_was_pressed():
    closed, other = Phase.CLOSED, Phase.OPEN
    lost = pegs.lost_again("side", lasting=0.8)
    phases = [other] * 2000 + [closed] * 10 + [other] * 700 + [closed] + [other] * 1000
    first = watched(lost, [SimpleNamespace(phases={"side": phase}) for phase in phases])
    assert first == approx(2711 + 800, abs=2)
