"""robosuite's task `Wipe`, its own controllers and ours, without knowledge of height or friction.

    make worlds    (or, in its environment: python -m benchmarks.wiping [--seeds N], or --full: the
                    comparison of docs/baselines.md)

A Panda wipes the 100 markers of the task with its pad, pressing with 12 N at 50 mm/s along their
path. The environment is unmodified, with its default stepping; every seed draws other markers, a
table up to 5 mm higher or lower than its model, and a friction coefficient from 0.03 to 0.3.
`--force` and `--friction` give others. All controllers follow the same path with the same goals, 20
a second. OSC_POSE presses by lowering its goal below the table: `--search-settings` finds how deep
and how stiff, for 12 N, on tables that the comparison does not use. Verdicts are kept in out/wiping
by the hash of the sources, so that the same command continues where it was interrupted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np
import pinocchio as pin
import robosuite
import typer
from rich.console import Console
from robosuite.controllers import load_composite_controller_config
from robosuite.environments.manipulation.wipe import DEFAULT_WIPE_CONFIG
from robosuite.utils.log_utils import ROBOSUITE_DEFAULT_LOGGER

import osc_contact as osc
from benchmarks.kept import ROOT, Kept
from benchmarks.measuring import side_by_side
from osc_contact.lab.visual.plots import legend, panels, save, style
from osc_contact.robosuite import osc_contact_config
from osc_contact.spatial import Array
from paper.study import table_of

KEPT = ROOT / "out/wiping"
ROBOT, ARM = "Panda", "right"
HEIGHT = 0.9  #: m, of the table, as its model has it
FORCE = 12.0  #: N
SPEED = 0.05  #: m/s, along the markers
ABOVE = 0.015  #: m, between pad and table before landing
ABOVE_ACTIONS, LANDING_ACTIONS = 60, 60  #: 3 s each
LANDED = 15  #: actions with contact after which the path begins
THICKNESS, INSIDE = 0.015, 0.025  #: of the pad from the grip site; its rim from there (m)
WINDOW = 10  #: steps of the physics in 20 ms
OFF, FRICTION = 0.005, (0.03, 0.3)  #: largest error of the table's height (m), friction
FIRST_TUNING_SEED = 1000  #: seeds of the search begin here
FRESH = 5000  #: least seed that is drawn for a comparison
FIRST, TABLES = 604457, 30  #: first seed and number of the tables of docs/baselines.md


class Rival(Protocol):
    """A controller with its way to press."""

    def config(self) -> dict[str, Any]:
        """Return the configuration for `robosuite.make`."""

    def action(self, goal: pin.SE3, force: float) -> Array:
        """Return the action that leads the tool to a pose on or above the table.

        Args:
            goal: goal of the grip site; on the table where a force is given.
            force: to press with (N).
        """


def tip_on_table() -> osc.VertexOnFace:
    """Contact of the grip site, which only presses: the pad's rotation is a motion."""
    return osc.VertexOnFace([0, 0, 0], point=[0, 0, HEIGHT], normal=[0, 0, 1], name="table")


def pad_on_table() -> osc.FaceOnFace:
    """Contact of the pad's face, in the frame of the grip site; two of its rotations are forces."""
    return osc.FaceOnFace(
        [0, 0, THICKNESS], [0, 0, 1], [0, 0, HEIGHT], [0, 0, 1], size=INSIDE, name="table"
    )


@dataclass(frozen=True)
class Ours:
    """This package's composite controller: the force is a part of its action.

    Attributes:
        options: further options of the controller.
        contact: function that makes the contact of the tool with the table.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    contact: Callable[[], osc.ContactPair] = tip_on_table

    def config(self) -> dict[str, Any]:
        """Return the configuration, see `Rival`."""
        return osc_contact_config(ROBOT, [self.contact()], **self.options)

    def action(self, goal: pin.SE3, force: float) -> Array:
        """Return the action, see `Rival`."""
        return np.concatenate((goal.translation, pin.log3(goal.rotation), [force]))


@dataclass(frozen=True)
class OscPose:
    """robosuite's OSC_POSE with fixed impedance: it presses as its goal lies in the table.

    With variable impedance robosuite 1.5.1 takes the first three stiffnesses for the position, if
    goals are absolute.

    Attributes:
        kp: stiffness (1/s²); damping is critical.
        depth: depth of the goal below the table as its model has it (m).
    """

    kp: float
    depth: float

    def __str__(self) -> str:
        return f"kp {self.kp:g} /s², {1e3 * self.depth:g} mm deep"

    def config(self) -> dict[str, Any]:
        """Return the configuration, see `Rival`."""
        config: dict[str, Any] = load_composite_controller_config(robot=ROBOT)
        config["body_parts"][ARM].update(
            kp=self.kp,
            damping_ratio=1.0,
            input_type="absolute",
            input_ref_frame="world",
        )
        return config

    def action(self, goal: pin.SE3, force: float) -> Array:
        """Return the action, see `Rival`."""
        position = goal.translation.copy()
        position[2] -= self.depth if force else 0.0
        return np.concatenate((position, pin.log3(goal.rotation)))


@dataclass(frozen=True)
class Wiped:
    """Verdict of one episode; forces are the true normal forces between gripper and table.

    Attributes:
        name: name of the rival.
        seed: seed of markers, height and friction.
        force: command (N).
        friction: coefficient that was given; None: drawn.
        markers: wiped, of 100.
        mean: force on the path (N).
        raw, smooth: rms of force errors of each step, and of their means over 20 ms (N).
        late: the latter on the second half of the path (N).
        peak, landing: largest force on the path, and before it (N).
        aside: rms distance of the tool from the path (mm).
        success: True if the environment judges so.
        end: last status of our controller; empty for others.
    """

    name: str
    seed: int
    force: float
    friction: float | None
    markers: int
    mean: float
    raw: float
    smooth: float
    late: float
    peak: float
    landing: float
    aside: float
    success: bool
    end: str = ""

    @property
    def key(self) -> tuple[str, int, float, float | None]:
        """Rival, seed, command and friction."""
        return (self.name, self.seed, self.force, self.friction)


class Wiping:
    """One episode of the task.

    Args:
        rival: controller of the rival.
        seed: seed of markers, height and friction.
        force: command (N).
        friction: coefficient of the table; None: drawn.
        options: further arguments of `robosuite.make`.

    Attributes:
        env: robosuite's environment.
        forces: true force of each step of the physics so far (N).
        places: positions of the tool after each action.
    """

    def __init__(
        self,
        rival: Rival,
        seed: int,
        force: float = FORCE,
        friction: float | None = None,
        **options: Any,
    ) -> None:
        ROBOSUITE_DEFAULT_LOGGER.setLevel("ERROR")
        rng = np.random.default_rng(seed)
        height, drawn = HEIGHT + rng.uniform(-OFF, OFF), rng.uniform(*FRICTION)
        task = dict(
            DEFAULT_WIPE_CONFIG,
            early_terminations=False,
            table_offset=[0.15, 0, height],
            table_friction=[drawn if friction is None else friction, 0.005, 1e-4],
        )
        np.random.seed(seed)  # robosuite draws the markers and the arm's posture from it
        self.env = robosuite.make(
            "Wipe",
            ROBOT,
            controller_configs=rival.config(),
            task_config=task,
            ignore_done=True,
            has_renderer=False,
            has_offscreen_renderer=False,
            use_camera_obs=False,
            **options,
        )
        self.env.reset()
        self.rival, self.force = rival, force
        self.forces: list[float] = []
        self.places: list[Array] = []
        self._watch_forces()
        sim = self.env.sim
        markers = self.env.model.mujoco_arena.markers
        bodies = [sim.model.body_name2id(marker.root_body) for marker in markers]
        self.path: Array = np.array(sim.data.body_xpos)[bodies, :2]
        legs = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        self.lengths: Array = np.append(0.0, np.cumsum(legs))
        self._site = self.env.robots[0].eef_site_id[ARM]
        along = np.array(sim.data.site_xmat[self._site]).reshape(3, 3)[:, 0]
        self._down = pin.rpy.rpyToMatrix(np.pi, 0.0, np.arctan2(along[1], along[0]))

    def _watch_forces(self) -> None:
        """Record the true force after every step of the physics."""
        model = self.env.sim.model._model
        names = [model.geom(k).name for k in range(model.ngeom)]
        tool = np.array(["gripper0" in name for name in names])
        table = np.array(["table" in name for name in names])
        after_step = self.env._update_observables

        def record_force(force: bool = False) -> None:
            self.forces.append(normal_force(model, self.env.sim.data._data, tool, table))
            after_step(force=force)

        self.env._update_observables = record_force

    def act(self, along: float, height: float, force: float) -> float:
        """Act once: go to a place of the path, at a height.

        Returns:
            The mean force meanwhile (N).
        """
        place = [np.interp(along, self.lengths, axis) for axis in self.path.T]
        goal = pin.SE3(self._down, np.array([*place, height]))
        before = len(self.forces)
        self.env.step(self.rival.action(goal, force))
        self.places.append(np.array(self.env.sim.data.site_xpos[self._site]))
        return float(np.mean(self.forces[before:]))

    def land(self) -> None:
        """Go above the first marker, lower the tool and press."""
        for _ in range(ABOVE_ACTIONS):
            self.act(0.0, HEIGHT + ABOVE, 0.0)
        step = SPEED / self.env.control_freq
        for height in np.arange(HEIGHT + ABOVE, HEIGHT, -step):
            self.act(0.0, height, self.force)
        touched = 0
        for _ in range(LANDING_ACTIONS):
            touched += self.act(0.0, HEIGHT, self.force) > 0.5 * self.force
            if touched == LANDED:
                break

    def wipe(self) -> None:
        """Follow the markers to the last one, and a little longer."""
        for along in np.arange(0.0, self.lengths[-1] + SPEED, SPEED / self.env.control_freq):
            self.act(along, HEIGHT, self.force)


def normal_force(model: Any, data: Any, some: Array, others: Array) -> float:
    """Sum the normal forces between geoms (N).

    Args:
        model, data: MuJoCo's.
        some, others: which geoms, each (ngeom,).
    """
    wrench, total = np.zeros(6), 0.0
    for k, (one, other) in enumerate(data.contact.geom[: data.ncon]):
        if (some[one] and others[other]) or (some[other] and others[one]):
            mujoco.mj_contactForce(model, data, k, wrench)
            total += float(wrench[0])
    return total


def aside(places: Array, path: Array) -> Array:
    """Distances (n,) of places (n, 2) from a path of straight legs through points (m, 2)."""
    starts, legs = path[:-1], np.diff(path, axis=0)
    squares = np.maximum((legs**2).sum(1), 1e-12)
    offset = places[:, None] - starts
    share = np.clip((offset * legs).sum(2) / squares, 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * legs, axis=2).min(1)


def try_wiping(
    name: str, rival: Rival, seed: int, force: float = FORCE, friction: float | None = None
) -> Wiped:
    """Run one episode.

    Args:
        name: name of the rival.
        rival: controller of the rival.
        seed: seed of markers, height and friction.
        force: command (N).
        friction: coefficient of the table; None: drawn.
    """
    episode = Wiping(rival, seed, force, friction)
    episode.land()
    begun, acted = len(episode.forces), len(episode.places)
    episode.wipe()
    forces = np.array(episode.forces[begun:])
    smooth = np.convolve(forces, np.full(WINDOW, 1.0 / WINDOW), "valid")
    parts = (forces, smooth, smooth[len(smooth) // 2 :])
    raw, every, late = (float(np.sqrt(np.mean((part - force) ** 2))) for part in parts)
    off = aside(np.array(episode.places[acted:])[:, :2], episode.path)
    end = ""
    if isinstance(rival, Ours):
        end = episode.env.robots[0].composite_controller.loops[ARM].loop.controller.status.name
    return Wiped(
        name,
        seed,
        force,
        friction,
        len(episode.env.wiped_markers),
        float(forces.mean()),
        raw,
        every,
        late,
        float(forces.max()),
        max(episode.forces[:begun]),
        1e3 * float(np.sqrt(np.mean(off**2))),
        bool(episode.env._check_success()),
        end,
    )


# --- Search and comparison -----------------------------------------------------------------------

DEPTHS = (0.003, 0.004, 0.006, 0.009, 0.014)  #: m, of the goal below the table
STIFFNESS = (75.0, 150.0, 300.0)  #: 1/s²; 150: robosuite's default
OURS = "ours"


#: Controllers that are compared; those of OSC_POSE were found by `--search-settings`.
RIVALS: dict[str, Rival] = {
    OURS: Ours(),
    "OSC_POSE, most markers": OscPose(300.0, 0.004),
    "OSC_POSE, smallest force error": OscPose(75.0, 0.009),
}
COMPARED = ";".join(RIVALS)  #: names of the controllers that are compared without `--rivals`
RIVALS["friction not compensated"] = Ours({"friction": osc.Friction(mu=0.0, learning=0.0)})
RIVALS["face on face"] = Ours(contact=pad_on_table)
RIVALS["face on face, patient"] = Ours(
    {
        "life": osc.PhaseSettings(patience=0.2),
        "gains": osc.Gains(force=osc.ForceGains(bandwidth=2.0)),
    },
    pad_on_table,
)


Job = tuple[str, Rival, int, float, float | None]  #: arguments of `try_wiping`


def results(jobs: Sequence[Job], workers: int) -> list[Wiped]:
    """Run episodes, those that are not kept yet.

    Args:
        jobs: name of the rival, the rival, seed, command and friction of each.
        workers: processes.
    """
    kept = Kept(KEPT, lambda row: Wiped(**row))
    left = [job for job in jobs if (job[0], *job[2:]) not in kept.found]
    for wiped in side_by_side(try_wiping, left, workers) if left else ():
        kept.add(wiped)
    return [kept.found[(name, *rest)] for name, _, *rest in jobs]


def row(name: str, found: Sequence[Wiped]) -> list[object]:
    """Cells of one line: means over the episodes, of peak and landing the largest."""

    def mean(value: Callable[[Wiped], float]) -> float:
        return float(np.mean([value(one) for one in found]))

    spread, force = [one.mean for one in found], found[0].force
    return [
        name,
        f"{sum(one.success for one in found)} of {len(found)}",
        f"{mean(lambda one: one.markers):.1f}",
        f"{min(spread):.1f} to {max(spread):.1f}",
        f"{100.0 * mean(lambda one: one.raw) / force:.1f}",
        f"{100.0 * mean(lambda one: one.smooth) / force:.1f}",
        f"{100.0 * mean(lambda one: one.late) / force:.1f}",
        f"{max(one.peak for one in found):.0f}",
        f"{max(one.landing for one in found):.0f}",
        f"{mean(lambda one: one.aside):.1f}",
    ]


HEADS = (
    "controller; success; markers of 100; mean force (N); rms raw (%); rms of 20 ms (%); "
    "2nd half (%); peak (N); landing (N); off the path (mm)"
)


def search(seeds: int, workers: int) -> None:
    """Print all settings of OSC_POSE, best first, from tables that the comparison does not use."""
    settings = [OscPose(kp, depth) for kp in STIFFNESS for depth in DEPTHS]
    every = range(FIRST_TUNING_SEED, FIRST_TUNING_SEED + seeds)
    jobs = [(str(one), one, seed, FORCE, None) for one in settings for seed in every]
    found = results(jobs, workers)
    by_name = {str(one): [w for w in found if w.name == str(one)] for one in settings}

    def merit(name: str) -> tuple[int, float]:
        mine = by_name[name]
        return (-sum(w.markers for w in mine), sum(w.smooth for w in mine))

    rows = [row(name, by_name[name]) for name in sorted(by_name, key=merit)]
    Console(width=160).print(table_of(f"OSC_POSE: {seeds} tables for tuning", HEADS, rows))


def compare(
    seeds: int,
    first: int | None,
    rivals: str,
    workers: int,
    force: float = FORCE,
    friction: float | None = None,
) -> None:
    """Print the comparison.

    Args:
        seeds: tables.
        first: first seed; None: it is drawn, and printed.
        rivals: names of the controllers, separated by semicolons.
        workers: processes.
        force: command (N).
        friction: coefficient of the tables; None: drawn.
    """
    begin = int(np.random.default_rng().integers(FRESH, 10**6)) if first is None else first
    print(f"seeds {begin} to {begin + seeds - 1}: --first {begin}", flush=True)
    names = rivals.split(";")
    jobs = [
        (name, RIVALS[name], seed, force, friction)
        for name in names
        for seed in range(begin, begin + seeds)
    ]
    found = results(jobs, workers)
    rows = [row(name, [one for one in found if one.name == name]) for name in names]
    unknown = "height and friction" if friction is None else f"height, friction {friction:g}"
    title = f"Wipe, {force:g} N, {1e3 * SPEED:g} mm/s, {seeds} tables of unknown {unknown}"
    Console(width=180).print(table_of(title, HEADS, rows))


def draw(path: Path, seed: int = 0) -> None:
    """Draw forces of one table under ours and OSC_POSE, means over 20 ms."""
    with style():
        figure, (ax,) = panels(1, 2.2)
        for name, rival in RIVALS.items():
            episode = Wiping(rival, seed)
            episode.land()
            episode.wipe()
            force = np.convolve(episode.forces, np.full(WINDOW, 1.0 / WINDOW), "valid")
            ax.plot(np.arange(len(force)) * episode.env.model_timestep, force, label=name)
        ax.axhline(FORCE, color="black", linewidth=0.6, linestyle=":")
        ax.set_ylabel("force on the table (N)")
        legend(ax)
        save(figure, path.with_suffix(""), (path.suffix,))


def main(
    seeds: int = 3,
    first: int | None = None,
    rivals: str = COMPARED,
    search_settings: bool = False,
    workers: int = 2,
    picture: Path | None = None,
    force: float = FORCE,
    friction: float | None = None,
    full: bool = False,
) -> None:
    """Compare the controllers, or search settings for OSC_POSE.

    Args:
        seeds: tables, each with markers, height and friction of its own.
        first: seed of the first table of the comparison; None: it is drawn, and printed.
        rivals: names of the controllers that are compared, separated by semicolons.
        search_settings: search instead of comparing.
        workers: processes.
        picture: draw the forces of the first table instead.
        force: command of the comparison (N); OSC_POSE presses as for 12 N.
        friction: coefficient of the tables of the comparison; None: drawn.
        full: compare on the tables of docs/baselines.md, whatever `seeds` and `first` are.
    """
    if full:
        seeds, first = TABLES, FIRST
    if picture is not None:
        draw(picture)
        return
    if search_settings:
        search(seeds, workers)
    else:
        compare(seeds, first, rivals, workers, force, friction)


if __name__ == "__main__":
    typer.run(main)
