"""Ours against selection laws with their best frames: same plants, gains, references and seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from rich.table import Table

import osc_contact as osc
from osc_contact.interface import Reference
from osc_contact.plants.rigid import RigidPlant
from osc_contact.projections import Omega_m_bar
from osc_contact.runs.contacts import feet
from osc_contact.runs.loop import run_loop
from osc_contact.runs.report import require_judgeable
from osc_contact.runs.run import run, start
from osc_contact.scenarios import Scenario
from osc_contact.spatial import Array, pose_error
from osc_contact.visual import OKABE_ITO
from osc_contact.visual.plots import style
from paper.selection_laws import (
    BASELINES,
    Coupling,
    Instant,
    Law,
    Ours,
    SelectionLaw,
    best_selection,
)
from paper.study import Ask, Data, Study, Witness, table_of, words_of

OURS = "ours"
PLANTS = ("rigid", "mujoco")
KINDS = ("force_to_motion", "motion_to_force")  #: of cross-talk
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Comparison:
    """What every law did; dictionaries go by the law's key, `steps` and `task` by plant and key.

    Attributes:
        laws: "ours" first. instant: the start, for which the frames are best.
        measured: cross-talk by whole ticks on the rigid plant.
        steps: responses at rest. task: metrics of the whole task, or why it ended early.
    """

    scenario: Scenario
    laws: dict[str, Law]
    instant: Instant
    measured: dict[str, Coupling]
    steps: dict[str, dict[str, StepRun]]
    task: dict[str, dict[str, Data]]

    def label(self, key: str) -> str:
        """What figures and tables call a law."""
        law = self.laws[key]
        return law.baseline.label if isinstance(law, SelectionLaw) else "ours"

    def peaks(self, plant: str, key: str) -> tuple[float, float]:
        """Largest cross-talk after any step: displacement (m) and force error (N)."""
        run = self.steps[plant][key]
        return float(run.force_to_motion.max()), float(run.motion_to_force.max())

    def margin(self, plant: str) -> tuple[float, float]:
        """How many times smaller ours is than the best baseline, in both kinds of cross-talk."""
        ours = np.array(self.peaks(plant, OURS))
        others = np.array([self.peaks(plant, key) for key in self.laws if key != OURS])
        of_motion, of_force = others.min(axis=0) / np.maximum(ours, np.finfo(float).tiny)
        return float(of_motion), float(of_force)

    def as_dict(self) -> Data:
        """JSON-able: the frames, every number of the table and more."""
        return {
            "scenario": self.scenario.name,
            "force_step_N": FORCE_STEP_N,
            "motion_step_m": MOTION_STEP_M,
            "task_duration_s": float(self.scenario.duration),
            "inertia_kg": self.instant.inertia,
            "size_m": self.instant.size,
            "free_motions": self.instant.free.T.tolist(),
            "laws": {key: self._law(key) for key in self.laws},
            "smaller_than_best_baseline": {
                plant: dict(zip(KINDS, self.margin(plant), strict=True)) for plant in PLANTS
            },
        }

    def _law(self, key: str) -> Data:
        law = self.laws[key]
        row: Data = {"label": self.label(key)}
        if isinstance(law, SelectionLaw):
            row["equation"] = law.baseline.equation
            row["source"] = law.baseline.source
            row["selection"] = law.selection.as_dict()
        couplings = {"predicted": self.instant.coupling(law), "measured": self.measured[key]}
        for name, coupling in couplings.items():
            row[name] = dict(zip(KINDS, coupling.norms, strict=True)) | {"cost": coupling.cost}
        for plant in PLANTS:
            steps = self.steps[plant][key]
            row[plant] = {
                "force_to_motion_m": steps.force_to_motion.tolist(),
                "motion_to_force_N": steps.motion_to_force.tolist(),
                "closed": steps.closed,
                "saturated_ticks": steps.saturated,
                "task": self.task[plant][key],
            }
        return row


def compare(
    scenario: Scenario, seed: int = 0, progress: Progress = lambda what, t: None
) -> Comparison:
    """Find the best frames, step at rest and run the whole task, on both plants.

    The rigid plant integrates once per control tick.

    Args:
        scenario: with two or more contacts that no tare precedes; its plant's type is not used.
        seed: of the search for frames and of the runs.
        progress: called with what is going on and the simulated time.

    Raises:
        InvalidInputError: no contacts, a tare, or too short to be judged.
        ContactError: a baseline cannot control the forces and motions with any frame.
    """
    require_judgeable(scenario)
    if not scenario.contacts or scenario.tare is not None:
        raise osc.InvalidInputError(
            "the comparison needs contacts that are closed from the start; give contacts and set "
            "tare: null"
        )
    rigs = {plant: osc.build_rig(_on(plant, scenario)) for plant in PLANTS}
    instant = Instant(rigs["rigid"].state(), rigs["rigid"].contact())
    laws: dict[str, Law] = {OURS: Ours()}
    for key, baseline in BASELINES.items():
        laws[key] = best_selection(instant, baseline, seed=seed)
    steps: dict[str, dict[str, StepRun]] = {plant: {} for plant in PLANTS}
    task: dict[str, dict[str, Data]] = {plant: {} for plant in PLANTS}
    for plant, rig in rigs.items():
        for key, law in laws.items():
            where = f"{key} on {plant}"
            steps[plant][key] = run_steps(rig, law, instant, partial(progress, f"{where}: steps"))
            task[plant][key] = _whole_task(rig, law, seed, partial(progress, f"{where}: task"))
    measured = {k: measured_coupling(rigs["rigid"], law, instant) for k, law in laws.items()}
    return Comparison(scenario, laws, instant, measured, steps, task)


def _whole_task(rig: osc.Rig, law: Law, seed: int, tell: Callable[[float], None]) -> Data:
    try:
        verdict = osc.metrics(run(rig.scenario, seed=seed, progress=tell, install=law.install))
    except osc.PlantError as error:
        return {"failed": str(error)}
    return {key: verdict[key] for key in ("force", "motion", "contact_fraction", "status")}


def _on(plant: str, scenario: Scenario) -> Scenario:
    changes: Data = {"type": plant}
    if plant == "rigid":
        changes["step"] = 1.0 / scenario.control.rate
    return scenario.replaced(plant=scenario.plant.model_dump() | changes)


# --- Steps of one desired quantity at rest, and what they do to the other: force ↔ motion ---


FORCE_STEP_N = 5.0
MOTION_STEP_M = 0.005  #: along a unit free motion; angles count with the object's size
_SETTLE_S = 0.5
_WINDOW_S = 0.4


@dataclass(frozen=True)
class StepRun:
    """One law on one plant: desired forces step one after the other, then each free motion.

    Attributes:
        t: (ticks,) s. starts: when the steps happen (s), the first r of them of forces.
        alpha: (ticks, r) true contact forces (N). alpha_d: (ticks, r) desired.
        motion: (ticks, 6) true displacement from the start, m and rad; `free` part of it.
        ends: (points, 3) points of the object whose displacement counts, from O (m).
        closed: fraction of the time that all contacts were closed. saturated: ticks.
    """

    t: Array
    starts: tuple[float, ...]
    alpha: Array
    alpha_d: Array
    motion: Array
    ends: Array
    closed: float
    saturated: int

    def window(self, k: int) -> slice:
        """Ticks of step k."""
        edges = np.array([self.starts[k], self.starts[k] + _WINDOW_S]) - 1e-9
        first, last = np.searchsorted(self.t, edges)
        return slice(int(first), int(last))

    def effect(self, k: int) -> Array:
        """(ticks,) what step k does to the other quantity.

        Of a force: how far it takes the point of the object that it takes farthest (m). Of a
        motion: the largest difference between true and desired forces (N).
        """
        rows = self.window(k)
        if k >= self.alpha.shape[1]:
            return np.abs(self.alpha[rows] - self.alpha_d[rows]).max(axis=1)
        d = self.motion[rows] - self.motion[rows.start - 1]
        moved = d[:, None, :3] + np.cross(d[:, None, 3:], self.ends)
        return np.linalg.norm(moved, axis=2).max(axis=1)

    @cached_property
    def force_to_motion(self) -> Array:
        """(r,) m: largest displacement along the free motions after each force step."""
        return np.array([self.effect(k).max() for k in range(self.alpha.shape[1])])

    @cached_property
    def motion_to_force(self) -> Array:
        """(n,) N: largest force error on any contact after each motion step."""
        steps = range(self.alpha.shape[1], len(self.starts))
        return np.array([self.effect(k).max() for k in steps])


def run_steps(
    rig: osc.Rig, law: Law, instant: Instant, progress: Callable[[float], None] | None = None
) -> StepRun:
    """At rest on the contacts, at t = 0.5 s and every 0.4 s one more desired value steps.

    The motion that counts is what a contact force by itself cannot cause, Ω_m(Φ₀) of the
    displacement (on a soft contact the object also gives way along N, whatever the law).

    Args:
        rig: with the plant.
        law: to be installed.
        instant: the start, whose free motions are stepped along.
        progress: called with the simulated time now and then.
    """
    r = instant.contact.r
    n = instant.free.shape[1]
    starts = tuple(_SETTLE_S + _WINDOW_S * k for k in range(r + n))
    period = 1.0 / rig.scenario.control.rate
    at_rest = replace(rig.references.at(0.0), V_D=np.zeros(6), A_D=np.zeros(6))
    t = period * np.arange(round((starts[-1] + _WINDOW_S) / period))
    done = [sum(now >= begin - 1e-9 for begin in starts) for now in t]
    stepped = [_stepped(at_rest, instant, count) for count in range(len(starts) + 1)]
    plant, controller = start(rig, install=law.install)
    witness = Witness(plant, controller)
    run_loop(plant, controller, (stepped[k] for k in done), recorder=witness, progress=progress)
    X = instant.state.X_WO
    free_part = np.eye(6) - Omega_m_bar(instant.contact.N, instant.state.Phi)
    motion = np.array([free_part @ pose_error(truth.X_WO, X) for truth in witness.truths])
    alpha = np.array([truth.alpha for truth in witness.truths])
    alpha_d = np.array([stepped[k].alpha_d for k in done])
    closed = float(np.mean([truth.closed.all() for truth in witness.truths]))
    ends = np.vstack([np.zeros(3), *(feet(pair, X)[0] - X.translation for pair in rig.pairs)])
    saturated = int(np.count_nonzero(witness.status))
    return StepRun(t, starts, alpha, alpha_d, motion, ends, closed, saturated)


def measured_coupling(rig: osc.Rig, law: Law, instant: Instant) -> Coupling:
    """The same matrices as `Instant.coupling`, from whole ticks and the rigid plant's answer.

    Steps of force come at once, whatever the scenario's rise time: one tick would not see them.

    Args:
        rig: with the rigid plant's chain. law: to be installed. instant: the start.
    """
    plant = RigidPlant(rig.chain, rig.pairs, rig.scenario.plant.step)
    plant.reset(rig.q_start)
    measurement = plant.measure()
    at_rest = rig.references.at(0.0)
    r = instant.contact.r
    n = instant.free.shape[1]
    gains = rig.gains.replaced(force=rig.gains.force.replaced(rise=0.0))

    def answer(reference: Reference) -> Array:
        controller = law.install(rig.controller().with_gains(gains))
        _, a, alpha = plant.accelerations(controller.tick(measurement, reference))
        return np.concatenate((alpha, instant.along @ a))

    base = answer(at_rest)
    forces = [replace(at_rest, alpha_d=at_rest.alpha_d + e) for e in np.eye(r)]
    motions = [replace(at_rest, A_D=at_rest.A_D + u) for u in instant.free.T]
    change = np.array([answer(x) - base for x in (*forces, *motions)]).T.reshape(r + n, r + n)
    return Coupling(change[:r, :r], change[r:, r:], change[r:, :r], change[:r, r:], instant.inertia)


def _stepped(at_rest: Reference, instant: Instant, done: int) -> Reference:
    """With the first `done` steps made: forces, then free motions."""
    r = instant.contact.r
    alpha_d = at_rest.alpha_d + FORCE_STEP_N * (np.arange(r) < done)
    steps = MOTION_STEP_M * (np.arange(instant.free.shape[1]) < done - r)
    d = instant.free @ steps
    X = at_rest.X_WD
    X_WD = pin.SE3(pin.exp3(d[3:]) @ X.rotation, X.translation + d[:3])
    return replace(at_rest, X_WD=X_WD, alpha_d=alpha_d)


# --- The comparison with the baselines as a table ---


def comparison_table(result: Mapping[str, Any]) -> Table:
    """baselines.json: a column for each law, and how many times smaller the first one's number is
    than the best of the others'."""
    laws = list(result["laws"].values())
    force = f"{result['force_step_N']:g} N"
    motion = f"{1e3 * result['motion_step_m']:g} mm"
    numbers: dict[str, list[float | None]] = {
        "rigid, one instant: force → motion (1)": [x["measured"][KINDS[0]] for x in laws],
        "rigid, one instant: motion → force (1)": [x["measured"][KINDS[1]] for x in laws],
    }
    for plant in PLANTS:
        moved = [1e6 * max(law[plant]["force_to_motion_m"]) for law in laws]
        pressed = [max(law[plant]["motion_to_force_N"]) for law in laws]
        tasks = [law[plant]["task"] for law in laws]
        numbers[f"{plant}, {force} step: object moves (µm)"] = moved
        numbers[f"{plant}, {motion} step: force error (N)"] = pressed
        numbers[f"{plant}, whole task: force rms (N)"] = [
            None if "failed" in task else max(x["rms_error_N"] for x in task["force"].values())
            for task in tasks
        ]
        for unit in ("m", "rad"):
            numbers[f"{plant}, whole task: motion rms (m{unit})"] = [
                None if "failed" in task else 1e3 * task["motion"][f"rms_error_{unit}"]
                for task in tasks
            ]
    rows = []
    for words, (ours, *others) in numbers.items():
        known = [x for x in others if x is not None]
        ratio = f"{min(known) / ours:.3g}" if known and ours else "-"
        rows.append((words, *(words_of(x, "{:.3g}", "failed") for x in (ours, *others)), ratio))
    heads = "; ".join(("cross-talk", *(law["label"] for law in laws), "best / ours"))
    title = f"{result['scenario']}: ours and selection laws with their best frames"
    return table_of(title, heads, rows)


def draw(comparison: Comparison) -> Figure:
    """Top: what a force step does to the motion. Bottom: what a motion step does to the force.

    Left: at one instant on the rigid plant, dimensionless. Middle: peak on MuJoCo. Right: over
    time on MuJoCo, every step after the other.
    """
    laws = comparison.laws
    colours = [OKABE_ITO[name] for name in ("blue", "vermillion", "orange")]
    units = ("displacement (µm)", "force error (N)")
    symbols = (r"$\|m\,G_f M^{-1}\|$  (1)", r"$\|G_m K^{-1}\|/m$  (1)")
    titles = ("force step → motion", "motion step → force")
    runs = comparison.steps["mujoco"].values()
    r = comparison.instant.contact.r
    with style():
        figure = Figure(figsize=(10.0, 5.4))
        grid = figure.subplots(2, 3, width_ratios=[1.0, 1.0, 2.7])
        for i, (instant, peak, course) in enumerate(grid):
            scale = (1e6, 1.0)[i]
            _bars(instant, [comparison.measured[key].norms[i] for key in laws], colours)
            _bars(peak, [scale * comparison.peaks("mujoco", key)[i] for key in laws], colours)
            instant.set(title=f"{titles[i]}: rigid plant, one instant", ylabel=symbols[i])
            peak.set(title="MuJoCo: largest of all steps", ylabel=units[i])
            for run, colour in zip(runs, colours, strict=True):
                for k in (range(r), range(r, len(run.starts)))[i]:
                    course.plot(run.t[run.window(k)], scale * run.effect(k), color=colour)
                    course.axvline(run.starts[k], color="black", lw=0.7)
            course.set(title="MuJoCo, step after step", ylabel=units[i], xlabel="time (s)")
        handles = [Patch(color=colour) for colour in colours]
        labels = [comparison.label(key) for key in laws]
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _bars(ax: Axes, values: Sequence[float], colours: Sequence[str]) -> None:
    """One bar for each law, with its number."""
    bars = ax.bar(range(len(values)), values, color=colours)
    ax.bar_label(bars, fmt="{:.2g}")
    ax.set(yscale="log", xticks=[])
    ax.margins(y=0.2)


def study(ask: Ask) -> Study:
    """The whole comparison on `two_contact_rod`."""
    ask.tell("best frames")
    scenario = osc.load_scenario("two_contact_rod", ask.all_changes())
    comparison = compare(scenario, ask.seed, lambda what, t: ask.tell(f"{what} {t:.1f} s"))
    result = comparison.as_dict()
    return Study({"baselines": draw(comparison)}, comparison_table(result), result)
