"""Ours against selection laws with their best frames: same plants, gains, references and seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from rich.table import Table

import osc_contact as osc
from osc_contact.contacts.feet import feet
from osc_contact.lab.plants.rigid import RigidPlant
from osc_contact.lab.reports.report import require_judgeable
from osc_contact.lab.runs.run import start
from osc_contact.lab.visual import OKABE_ITO
from osc_contact.lab.visual.plots import style
from osc_contact.projections import Omega_m_bar
from osc_contact.spatial import Array, pose_error
from paper.selection_laws import (
    BASELINES,
    Coupling,
    Instant,
    Law,
    Ours,
    SelectionLaw,
    best_selection,
)
from paper.study import Ask, Data, Study, table_of, ticks

PLANTS = ("rigid", "mujoco")
KINDS = ("force_to_motion", "motion_to_force")  #: of cross-talk


def compare(scenario: osc.Scenario, ask: Ask) -> tuple[Data, list[StepRun]]:
    """Find the best frames, step at rest and run the whole task, on both plants.

    The rigid plant integrates once per control tick.

    Args:
        scenario: with two or more contacts that no tare precedes; its plant's type is not used.
        ask: seed of the search for frames and of the runs.

    Returns:
        JSON-able: the frames, every number of the table and more, ours first; and the steps of
        each law on MuJoCo.

    Raises:
        InvalidInputError: no contacts, a tare, or too short to be judged.
        ContactError: a baseline cannot control the forces and motions with any frame.
        PlantError: a task diverged.
    """
    require_judgeable(scenario)
    if not scenario.contacts or scenario.tare is not None:
        raise osc.InvalidInputError(
            "the comparison needs contacts that are closed from the start; give contacts and set "
            "tare: null"
        )
    rigs = {plant: osc.build_rig(_on(plant, scenario)) for plant in PLANTS}
    rigid = rigs["rigid"]
    instant = Instant(rigid.state, rigid.contact)
    laws: dict[str, Law] = {"ours": Ours()}
    for key, baseline in BASELINES.items():
        laws[key] = best_selection(instant, baseline, seed=ask.seed)
    rows: dict[str, Data] = {}
    for key, law in laws.items():
        row = rows[key] = {"label": law.label}
        if isinstance(law, SelectionLaw):
            row["selection"] = law.selection.as_dict()
        coupling = measured_coupling(rigid, law, instant)
        row["measured"] = dict(zip(KINDS, coupling.norms, strict=True)) | {"cost": coupling.cost}
    for plant, rig in rigs.items():
        runs = []
        for key, law in laws.items():
            ask.tell(f"{key} on {plant}: steps")
            runs.append(StepRun(rig, law, instant))
            ask.tell(f"{key} on {plant}: task")
            verdict = osc.metrics(osc.run(rig.scenario, seed=ask.seed, install=law.install))
            task = {word: verdict[word] for word in ("force", "motion", "status")}
            rows[key][plant] = runs[-1].as_dict() | {"task": task}
    result = {
        "scenario": scenario.name,
        "force_step_N": FORCE_STEP_N,
        "motion_step_m": MOTION_STEP_M,
        "free_motions": instant.free.T.tolist(),
        "laws": rows,
    }
    return result, runs


def _on(plant: str, scenario: osc.Scenario) -> osc.Scenario:
    changes: Data = {"type": plant}
    if plant == "rigid":
        changes["step"] = 1.0 / scenario.control.rate
    return scenario.replaced(plant=scenario.plant.model_dump() | changes)


# --- Steps of one desired quantity at rest, and what they do to the other: force ↔ motion ---


FORCE_STEP_N = 5.0
MOTION_STEP_M = 0.005  #: along a unit free motion; angles count with the object's size
_SETTLE_S = 0.5
_WINDOW_S = 0.4


class StepRun:
    """One law on one plant: desired forces step one after the other, then each free motion.

    At rest on the contacts, at t = 0.5 s and every 0.4 s one more desired value steps. The motion
    that counts is what a contact force by itself cannot cause, Ω_m(Φ₀) of the displacement (on a
    soft contact the object also gives way along N, whatever the law).

    Attributes:
        t: (ticks,) s.
        starts: times at which the steps happen (s), the first r of them of forces.
        alpha: (ticks, r) true contact forces (N).
        alpha_d: (ticks, r) desired.
        motion: (ticks, 6) true displacement from the start, m and rad; `free` part of it.
        ends: (points, 3) points of the object whose displacement counts, from O (m).
        closed: fraction of the time that all contacts were closed.
        saturated: ticks.
        force_to_motion: (r,) m, largest displacement along the free motions after each force step.
        motion_to_force: (n,) N, largest force error on any contact after each motion step.
    """

    def __init__(self, rig: osc.Rig, law: Law, instant: Instant) -> None:
        """Run it.

        Args:
            rig: rig of the plant.
            law: law to be installed.
            instant: the start, whose free motions are stepped along.
        """
        r = instant.contact.r
        count = r + instant.free.shape[1]
        self.starts = tuple(_SETTLE_S + _WINDOW_S * k for k in range(count))
        period = 1.0 / rig.scenario.control.rate
        at_rest = replace(rig.references.at(0.0), V_D=np.zeros(6), A_D=np.zeros(6))
        self.t = period * np.arange(round((self.starts[-1] + _WINDOW_S) / period))
        done = [sum(now >= begin - 1e-9 for begin in self.starts) for now in self.t]
        stepped = [_stepped(at_rest, instant, k) for k in range(count + 1)]
        plant, controller = start(rig, install=law.install)
        truths = []
        self.saturated = 0
        for *_, truth in ticks(plant, controller, (stepped[k] for k in done)):
            truths.append(truth)
            self.saturated += bool(controller.status)
        X = instant.state.X_WO
        free_part = np.eye(6) - Omega_m_bar(instant.contact.N, instant.state.Phi)
        self.motion = np.array([free_part @ pose_error(truth.X_WO, X) for truth in truths])
        self.alpha = np.array([truth.alpha for truth in truths])
        self.alpha_d = np.array([stepped[k].alpha_d for k in done])
        self.closed = float(np.mean([truth.closed.all() for truth in truths]))
        feet_of = (feet(pair, X)[0] - X.translation for pair in rig.pairs)
        self.ends = np.vstack([np.zeros(3), *feet_of])
        largest = np.array([self.effect(k).max() for k in range(count)])
        self.force_to_motion, self.motion_to_force = np.split(largest, [r])

    def window(self, k: int) -> slice:
        """Ticks of step k."""
        edges = np.array([0.0, _WINDOW_S]) + self.starts[k] - 1e-9
        return slice(*np.searchsorted(self.t, edges).tolist())

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

    def as_dict(self) -> Data:
        """JSON-able."""
        return {
            "force_to_motion_m": self.force_to_motion.tolist(),
            "motion_to_force_N": self.motion_to_force.tolist(),
        }


def measured_coupling(
    rig: osc.Rig, law: Law, instant: Instant, plant: RigidPlant | None = None, t: float = 0.0
) -> Coupling:
    """Measure the matrices of `Instant.coupling` by whole ticks and accelerations of the plant.

    Steps of force come at once, whatever the scenario's rise time: one tick would not see them.

    Args:
        rig: rig with the rigid plant's chain.
        law: law to be installed.
        instant: state at which steps are made.
        plant: in this state; default: at the start.
        t: time of the reference (s).
    """
    if plant is None:
        plant = RigidPlant(rig.chain, rig.pairs, rig.scenario.plant.step)
        plant.reset(rig.q_start)
    measurement = plant.measure()
    at_rest = rig.references.at(t)
    r = instant.contact.r
    gains = rig.gains.replaced(force=rig.gains.force.replaced(rise=0.0))

    def answer(reference: osc.Reference) -> Array:
        controller = law.install(rig.controller().with_gains(gains))
        _, a, alpha = plant.accelerations(controller.tick(measurement, reference))
        return np.concatenate((alpha, instant.along @ a))

    base = answer(at_rest)
    forces = [replace(at_rest, alpha_d=at_rest.alpha_d + e) for e in np.eye(r)]
    motions = [replace(at_rest, A_D=at_rest.A_D + u) for u in instant.free.T]
    change = np.array([answer(x) - base for x in (*forces, *motions)]).T
    (M, G_m), (G_f, K) = (np.split(rows, [r], axis=1) for rows in np.split(change, [r]))
    return Coupling(M, K, G_f, G_m, instant.inertia)


def _stepped(at_rest: osc.Reference, instant: Instant, done: int) -> osc.Reference:
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
    numbers: dict[str, list[float]] = {
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
            max(x["rms_error_N"] for x in task["force"].values()) for task in tasks
        ]
        for unit in ("m", "rad"):
            errors = [1e3 * task["motion"][f"rms_error_{unit}"] for task in tasks]
            numbers[f"{plant}, whole task: motion rms (m{unit})"] = errors
    rows = [
        (words, *(f"{x:.3g}" for x in (*values, min(values[1:]) / values[0])))
        for words, values in numbers.items()
    ]
    heads = "; ".join(("cross-talk", *(law["label"] for law in laws), "best / ours"))
    title = f"{result['scenario']}: ours and selection laws with their best frames"
    return table_of(title, heads, rows)


def draw(result: Data, runs: Sequence[StepRun]) -> Figure:
    """On MuJoCo, step after step: what one of a force does to the motion, and the other way round.

    Args:
        result, runs: results and runs of `compare`.
    """
    look = zip(("blue", "vermillion", "orange"), ("-", "--", ":"), strict=True)
    with style():
        figure = Figure(figsize=(10.0, 3.2))
        moved, pressed = figure.subplots(1, 2)
        for law, run, (colour, line) in zip(result["laws"].values(), runs, look, strict=True):
            r = run.alpha.shape[1]
            for k, start in enumerate(run.starts):
                ax, scale = (moved, 1e6) if k < r else (pressed, 1.0)
                label = law["label"] if k == r else "_"  # once in the legend
                how: Any = {"color": OKABE_ITO[colour], "ls": line, "label": label}
                ax.plot(run.t[run.window(k)], scale * run.effect(k), **how)
                ax.axvline(start, color="black", lw=0.7)
        moved.set(title="force steps", ylabel="displacement (µm)", xlabel="time (s)")
        pressed.set(title="motion steps", ylabel="force error (N)", xlabel="time (s)")
        pressed.legend(loc="upper right")
    return figure


def study(ask: Ask) -> Study:
    """The whole comparison on `two_contact_rod`."""
    ask.tell("best frames")
    scenario = osc.load_scenario("two_contact_rod", ask.all_changes())
    result, runs = compare(scenario, ask)
    return Study({"baselines": draw(result, runs)}, comparison_table(result), result)
