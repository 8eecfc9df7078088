"""NIST's assembly task board 1 in gym-taskboard: pegs held by fingers, holes that are elsewhere.

    make worlds    (or, in its environment: python -m benchmarks.taskboard [--seeds N] [--parts …],
                    or --full: both tables of docs/baselines.md)

The episodes are those of `benchmarks.board_episode`. Three controllers search for the hole:

* ours: the peg goes in upright if the hole is where it is believed. If the tip meets the face,
  `peg_plan` of `osc_contact.lab.tasks.pegs` follows: the lowest point of the tilted tip slides
  along three lines until it drops. A round peg is tilted in the plane in which the flat fingers
  hold it by their faces; about the axis on which they close friction alone holds it. Through
  `MujocoArm.driven` and `SteppedLoop`, 500 times a second;
* impedance: a spiral of the upright peg; the reference goes as deep as the force needs;
* joint servos: the spiral by the environment's own actions, 20 a second, by the package's inverse
  kinematics; the goal is `DEPTH` below the face.

A peg is seated as the package judges: within 1.5 mm of the table below the board, aligned, at the
end. P_S is its `scoring.success_probability`, the probability that can be claimed with 95 %
confidence. Forces are the true sums of contact forces between the peg and all but the robot, after
each millisecond; slip is the displacement of the peg in the hand. Settings were chosen on seeds
below `FRESH`; the comparison begins with a seed that is drawn anew and printed. Verdicts are kept
in out/taskboard by the hash of the sources, so that `--first` with that seed continues where a
comparison was interrupted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pinocchio as pin
import typer
from gym_taskboard import scoring
from gym_taskboard.control import TCP, ik_action
from rich.console import Console

import osc_contact as osc
from benchmarks.board_episode import (
    DOWN,
    GAP,
    GRIP,
    HAND,
    LENGTH,
    PEGS,
    WRIST,
    Episode,
    Tried,
    about_z,
)
from benchmarks.kept import ROOT, Kept
from benchmarks.measuring import side_by_side, without_log
from osc_contact.contacts.insertion import Hole, Peg, pairs_between
from osc_contact.lab.tasks import pegs as tilted
from osc_contact.plan import ends, motions
from osc_contact.plan.sensed import Sensed
from osc_contact.spatial import Array
from paper.study import table_of

KEPT = ROOT / "out/taskboard"
PERIOD = 2e-3  #: control period (s)
LIMIT = 25.0  #: s, after which an episode ends
ACTION = 0.05  #: duration of an action of the environment (s)
FRESH = 5000  #: least seed that is drawn for a comparison
#: First seeds of the boards of docs/baselines.md, drawn when the settings were final.
FIRST = {
    "peg_round_4": 820637,
    "peg_round_8": 638395,
    "peg_round_12": 65270,
    "peg_round_16": 31985,
    "peg_rect_4": 361825,
    "peg_rect_8": 426079,
    "peg_rect_12": 128432,
    "peg_rect_16": 700766,
}
BOARDS = 30  #: boards of each peg there
FIRST_OF_RIVALS = 25320  #: first seed of the boards there on which all controllers are compared
PEGS_OF_RIVALS, BOARDS_OF_RIVALS = ("peg_round_16", "peg_rect_8"), 3
TABLE = 29e-3  #: depth of the table below the board's face (m)

PRESS = 4.0  #: force with which the upright tip touches the face (N)
SPEED = 0.01  #: speed on the spiral (m/s)
PITCH = 0.9  #: distance of neighbouring turns, as a share of the clearance
RADIUS = 2.6e-3  #: radius at which the search has failed (m)
DROP = 3e-4  #: drop of the peg, within about `RECENT`, by which the hole is found (m)
RECENT = 0.5  #: time constant of the level from which a drop counts (s)
DEEP = 26e-3  #: depth below the face from which on a peg may be seated (m)
INSERTION = 0.012  #: speed of the insertion (m/s)
DEPTH = 5e-4  #: depth of the servos' goal below the face during the search (m)
STIFFNESS = (600.0, 600.0, 600.0, 20.0, 20.0, 20.0)  #: of the impedance (N/m, N m/rad)
CEILING = 100.0  #: force at wrist and contacts above which our controller stops (N)


# --- The controllers ------------------------------------------------------------------------------


def _spiral(episode: Episode) -> tuple[float, float]:
    """Pitch (m) and speed (m/s) of the spiral; narrow holes are searched more slowly.

    Args:
        episode: peg and hole.
    """
    return PITCH * episode.clearance, SPEED * min(1.0, episode.clearance / 2e-4)


def _depth(now: Sensed) -> float:
    """Depth of the peg's tip below the point at which it touched the face (m)."""
    return float(DOWN @ (now.X.translation - now.passed["touch"].translation))


def dropped() -> ends.End:
    """Condition that the tip is lower than it was lately, by `DROP`.

    A peg that fingers hold creeps up in them under the force of the search, some tenths of a
    millimetre in ten seconds, so that the depth since the touch is no evidence of a hole.
    """

    def begin(now: Sensed) -> ends.Watch:
        """Begin with the present height."""
        level = float(DOWN @ now.X.translation)

        def met(now: Sensed, dt: float) -> bool:
            """Update the low-passed height, and compare the present one with it.

            Args:
                now: signals after the last tick.
                dt: control period (s).
            """
            nonlocal level
            height = float(DOWN @ now.X.translation)
            level += dt / RECENT * (height - level)
            return height - level > DROP

        return met

    return ends.End(begin, f"dropped by {1e3 * DROP:g} mm")


def _spiral_stages(episode: Episode, start: pin.SE3) -> list[osc.Stage]:
    """Stages of the impedance: weigh, touch, search, insert; after a failure back to the start.

    The reference goes as deep as `PRESS` needs.

    Args:
        episode: peg and hole.
        start: pose of the peg's tip at the start.
    """
    push = motions.along(DOWN, 0.01, yields=PRESS)
    touched = ends.pressed(0.6 * PRESS, DOWN)
    pitch, speed = _spiral(episode)
    fallen = ends.moved(GAP + 1e-3, DOWN)  # there was no face: the hole is where it is believed
    deep = ends.when(lambda now: _depth(now) > DEEP, "deep")
    seated = (deep & ends.pressed(6.0, DOWN) & ends.at_rest(2e-3, 0.05)).lasting(0.2)
    search = motions.spiral(DOWN, pitch, speed, RADIUS) & push
    stage = osc.Stage
    return [
        stage("weigh", until=ends.after(0.4), within=1.0, tare=True),
        stage("touch", {}, push, until=touched | fallen, within=4.0, fails="back"),
        stage(
            "search",
            {},
            search,
            until=dropped(),
            unless=ends.finished(),
            within=LIMIT,
            fails="back",
        ),
        stage(
            "insert",
            {},
            motions.along([0, 0, 1], INSERTION, axes="object", yields=10.0),
            until=seated,
            within=8.0,
            fails="back",
            then="done",
        ),
        stage(
            "back",
            {},
            motions.along(-DOWN, 20e-3, 2.0 * GAP),
            until=ends.finished(),
            within=3.0,
            then="return",
        ),
        stage(
            "return",
            {},
            motions.to(start, 20e-3),
            until=ends.finished(),
            within=4.0,
            then="touch",
        ),
        stage("done", until=ends.after(0.1), within=1.0),
    ]


def _arm(episode: Episode, turn: float | None = None) -> osc.MujocoArm:
    """The arm with the peg, whose tip is the operational point, z out of it.

    Args:
        episode: peg in the hand.
        turn: angle of the operational frame in the hand, about the peg's axis (rad); None: that at
            which its axes are those of the hole.
    """
    model = episode.env.model
    peg = episode.peg.body_id
    angle = -0.5 * np.pi * episode.turns if turn is None else turn
    tip = pin.SE3(about_z(angle), TCP + np.array([0.0, 0.0, GRIP + 0.5 * LENGTH]))
    middle = np.array([0.0, 0.0, -0.5 * LENGTH])
    inertia = pin.Inertia(float(model.body_mass[peg]), middle, np.diag(model.body_inertia[peg]))
    return osc.MujocoArm(
        model,
        episode.env.data,
        tip=HAND,
        tip_offset=tip,
        wrist_sensor=WRIST,
        payload=osc.RigidObject(inertia),
        name="panda",
    )


def _follow(
    episode: Episode, arm: osc.MujocoArm, controller: osc.Controller, plan: osc.Plan
) -> str:
    """Step the environment until the peg is seated, the plan has ended, or time is up.

    Args:
        episode: peg and hole.
        arm: arm of the environment.
        controller: controller of the arm.
        plan: plan that gives the references.

    Returns:
        How the plan ended.
    """
    loop = osc.SteppedLoop(controller, plan=plan)
    with loop, arm.driven(loop.step, dt=PERIOD):
        while not (plan.ended or episode.status()[1] or episode.time > LIMIT):
            episode.act()
    return f"{plan.stage.name}: {plan.reason or plan.outcome.value}"


def ours(episode: Episode) -> str:
    """Insert a peg by `peg_plan`, unless it goes in upright; returns how the plan ended.

    The x axis of a round peg, towards its lowest point, is the axis on which the fingers close.

    Args:
        episode: peg in the hand.
    """
    if episode.rectangular:
        arm = _arm(episode)
        (width, other), (wide, across) = episode.peg.size, episode.peg.hole
        peg = Peg("square", width, width_y=other)
        hole = Hole("square", wide, TABLE, episode.hole, width_y=across)
    else:
        turn = 0.5 * np.pi
        arm = _arm(episode, turn)
        peg = Peg("round", 2.0 * episode.peg.r)
        frame = pin.SE3(about_z(turn + 0.5 * np.pi * episode.turns), np.zeros(3))
        hole = Hole("round", 2.0 * episode.peg.hole_r, TABLE, episode.hole * frame)
    settings = _settings(peg)
    plan = osc.Plan(
        [*_upright_stages(peg, hole, settings), *tilted.peg_plan(peg, hole, settings).stages[1:]],
        largest=CEILING,
        tries=4,  # of which the first is upright
    )
    touch = pairs_between(peg, hole)
    return _pressed(episode, arm, plan, [touch[name] for name in plan.contacts])


def _settings(peg: Peg) -> tilted.PegSettings:
    """Search and forces for a peg: the fingers hold those of 4 mm by 2 to 4 N only.

    Args:
        peg: peg.
    """
    square = peg.shape == "square"
    if peg.width < 5e-3:
        return tilted.PegSettings(
            push=1.0 if square else 0.5,
            drop=3e-4,
            recent=0.4,
            asides=(0.0, 8e-4, -8e-4),
            length=8e-3,
            sides=0.12,
            tip=0.05,
            paired=False,
            short=-4e-3,
            patience=0.8,
        )
    return tilted.PegSettings(
        push=3.0,
        drop=5e-4,
        recent=0.8,
        asides=(0.0, 1.3e-3, -1.3e-3),
        length=10e-3,
        sides=0.25 if square else 0.5,
        tip=0.07 if square else 0.1,
        paired=False,
        patience=0.8,
    )


def _upright_stages(peg: Peg, hole: Hole, settings: tilted.PegSettings) -> list[osc.Stage]:
    """Stages that weigh a peg, insert it if there is no face, and else tilt it beside the hole.

    Args:
        peg: round peg.
        hole: hole at its believed pose.
    """
    face = "tip on face"
    lifted = motions.along(-DOWN, 20e-3, GAP)
    tilt = motions.to(tilted.peg_start(peg, hole, settings), 30e-3, 0.5)
    fallen = ends.moved(GAP + 1e-3, DOWN)
    deep = ends.moved(GAP + DEEP, DOWN, since="weigh")
    seated = deep & ends.pressed(6.0, DOWN) & ends.at_rest(2e-3, 0.05)
    return [
        osc.Stage("weigh", until=ends.after(0.4), within=1.0, tare=True),
        osc.Stage(
            "touch",
            {face: PRESS},
            until=fallen,
            unless=ends.made(face, lasting=0.1),
            within=4.0,
            fails="lift",
        ),
        osc.Stage(
            "enter",
            {"hole": 0.0},
            motions.along([0, 0, 1], INSERTION, axes="object", yields=10.0),
            until=seated.lasting(0.2),
            within=6.0,
            fails="lift",
            then="done",
            places={"hole": lambda now: hole.found_at(now.X)},
        ),
        osc.Stage("lift", {}, lifted, until=ends.finished(), within=3.0),
        osc.Stage("tilt", {}, tilt, until=ends.finished(), within=8.0),
    ]


def _pressed(
    episode: Episode,
    arm: osc.MujocoArm,
    plan: osc.Plan,
    contacts: Sequence[osc.ContactPair],
) -> str:
    """Follow a plan by our controller; returns how the plan ended.

    Args:
        episode: peg in the hand.
        arm: arm of the environment.
        plan: plan that gives the references.
        contacts: contacts of the plan.
    """
    controller = osc.Controller(
        arm.chain,
        contacts,
        tilted.GAINS,
        B=tilted.METRIC,
        posture=arm.measure().q,
        dt=PERIOD,
        life=osc.PhaseSettings(),
        in_contact=False,
        safety=osc.SafetySettings(contact_ceiling=CEILING, wrist_ceiling=CEILING),
    )
    return _follow(episode, arm, controller, plan)


def impedance(episode: Episode) -> str:
    """Insert the peg by an impedance; returns how its plan ended.

    Args:
        episode: peg in the hand.
    """
    arm = _arm(episode)
    q = arm.measure().q
    plan = osc.Plan(_spiral_stages(episode, arm.chain.state(q).X_WO), largest=CEILING)
    controller = osc.Controller(
        arm.chain,
        [],
        laws=osc.impedance(STIFFNESS, damping_ratio=1.0),
        posture=q,
        dt=PERIOD,
        safety=osc.SafetySettings(wrist_ceiling=CEILING),
    )
    return _follow(episode, arm, controller, plan)


def servos(episode: Episode) -> str:
    """Insert the peg by the environment's joint servos; returns an empty text.

    The goal goes down at 10 mm/s to `DEPTH` below the face, then along the spiral; once the hand
    has dropped by `DROP` it goes straight down.

    Args:
        episode: peg in the hand.
    """
    pitch, speed = _spiral(episode)
    per_angle = pitch / (2.0 * np.pi)
    x = episode.hole.rotation @ about_z(0.5 * np.pi * episode.turns)
    yaw = float(np.arctan2(x[1, 0], x[0, 0]))
    centre = episode.hole.translation - (0.5 * LENGTH + GRIP) * DOWN
    goal = centre - GAP * DOWN
    angle, level, found = 0.0, None, False
    while not (episode.status()[1] or episode.time > LIMIT):
        tcp = _fingertips(episode)
        if goal[2] > centre[2] - DEPTH or found:
            goal = goal + 0.01 * ACTION * DOWN
        else:
            level = tcp[2] if level is None else level + ACTION / RECENT * (tcp[2] - level)
            angle += speed * ACTION / np.hypot(per_angle * angle, per_angle)
            aside = per_angle * angle * np.array([np.cos(angle), np.sin(angle), 0.0])
            goal = centre + DEPTH * DOWN + aside
            if tcp[2] < level - DROP:
                found, goal = True, tcp
        episode.act(ik_action(episode.env, goal, yaw, 1.0))
    return ""


def _fingertips(episode: Episode) -> Array:
    """Place (3,) between the fingertips (m)."""
    data = episode.env.data
    hand = episode.env.model.body(HAND).id
    return np.array(data.xpos[hand] + data.xmat[hand].reshape(3, 3) @ TCP)


RIVALS: dict[str, Callable[[Episode], str]] = {
    "ours": ours,
    "impedance": impedance,
    "joint servos": servos,
}


# --- The comparison -------------------------------------------------------------------------------


@without_log()
def try_inserting(name: str, part: str, off: float, seed: int) -> Tried:
    """Run one episode.

    Args:
        name: controller.
        part: name of the peg.
        off: distance of the hole from its modelled place (mm).
        seed: seed of the episode.
    """
    episode = Episode(part, off, seed)
    return episode.verdict(name, off, seed, RIVALS[name](episode))


def results(jobs: Sequence[tuple[str, str, float, int]], workers: int) -> list[Tried]:
    """Run the episodes that are not kept yet.

    Args:
        jobs: controller, peg, error (mm) and seed of each.
        workers: processes.
    """
    kept = Kept(KEPT, lambda row: Tried(**row))
    left = [job for job in jobs if job not in kept.found]
    for tried in side_by_side(try_inserting, left, workers) if left else ():
        kept.add(tried)
    return [kept.found[job] for job in jobs]


Case = tuple[str, str, float]  #: controller, peg, error (mm)

HEADS = (
    "controller; peg; off (mm); first seed; seated; P_S; time (s); peak (N), median; largest; "
    "slip (mm), median; turned (°), largest"
)


def row(found: Sequence[Tried]) -> list[object]:
    """Cells of one line: time is the median of those that were seated, slips are of all.

    Args:
        found: verdicts of one controller on one peg with one error.
    """
    first = found[0]
    times = [one.time for one in found if one.seated]
    peaks = [one.peak for one in found]
    return [
        first.name,
        first.part,
        f"{first.off:g}",
        first.seed,
        f"{len(times)} of {len(found)}",
        f"{scoring.success_probability(len(times), len(found)):.2f}",
        f"{np.median(times):.1f}" if times else "–",
        f"{np.median(peaks):.0f}",
        f"{max(peaks):.0f}",
        f"{np.median([one.slip for one in found]):.2f}",
        f"{max(one.turned for one in found):.1f}",
    ]


def compare(title: str, cases: Mapping[Case, range], workers: int, each: bool) -> None:
    """Print the table of a comparison.

    Args:
        title: its title.
        cases: seeds of each case.
        workers: processes.
        each: print each episode, too.
    """
    jobs = [(*case, seed) for case, seeds in cases.items() for seed in seeds]
    found = results(jobs, workers)
    if each:
        for one in found:
            Console(width=200, highlight=False).print(one, soft_wrap=True)
    rows = [row([one for one in found if one.key[:3] == case]) for case in cases]
    Console(width=175).print(table_of(title, HEADS, rows))


def main(
    seeds: int = 3,
    first: int | None = None,
    parts: str = "peg_round_16",
    off: str = "2",
    rivals: str = ",".join(RIVALS),
    workers: int = 1,
    each: bool = False,
    full: bool = False,
) -> None:
    """Compare controllers; lists are separated by commas.

    Args:
        seeds: episodes of each.
        first: first seed; None: it is drawn, and printed.
        parts: pegs; `all`: all eight.
        off: distances of the hole from its modelled place (mm).
        rivals: controllers.
        workers: processes.
        each: print each episode, too.
        full: make the tables of docs/baselines.md, with their seeds, pegs and errors.
    """
    title = "pegs of NIST's board 1, {} boards each"
    if full:
        ours_on = {("ours", peg, 2.0): range(at, at + BOARDS) for peg, at in FIRST.items()}
        compare(title.format(BOARDS), ours_on, workers, each)
        same = range(FIRST_OF_RIVALS, FIRST_OF_RIVALS + BOARDS_OF_RIVALS)
        all_on = {(name, peg, 2.0): same for peg in PEGS_OF_RIVALS for name in RIVALS}
        compare(title.format(BOARDS_OF_RIVALS), all_on, workers, each)
        return
    pegs = PEGS if parts == "all" else parts.split(",")
    begin = int(np.random.default_rng().integers(FRESH, 10**6)) if first is None else first
    print(f"seeds {begin} to {begin + seeds - 1}: --first {begin}", flush=True)
    cases = {
        (name, part, float(one)): range(begin, begin + seeds)
        for part in pegs
        for one in off.split(",")
        for name in rivals.split(",")
    }
    compare(title.format(seeds), cases, workers, each)


if __name__ == "__main__":
    typer.run(main)
