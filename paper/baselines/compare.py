"""Ours against selection laws with their best frames: same plants, gains, references and seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError, PlantError
from osc_contact.runs.metrics import metrics
from osc_contact.runs.report import require_judgeable
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.runs.run import run
from osc_contact.scenarios import Scenario
from paper.baselines.coupling import Coupling, Instant
from paper.baselines.frames import best_selection
from paper.baselines.laws import BASELINES, Law, Ours, SelectionLaw
from paper.baselines.steps import (
    FORCE_STEP_N,
    MOTION_STEP_M,
    StepRun,
    measured_coupling,
    run_steps,
)

__all__ = ["OURS", "PLANTS", "Comparison", "compare"]

OURS = "ours"
PLANTS = ("rigid", "mujoco")
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Comparison:
    """What every law did; dictionaries go by the law's key, `steps` and `task` by plant and key.

    Attributes:
        laws: "ours" first. instant: the start, for which the frames are best.
        predicted: cross-talk by eqs. 17 and 18. measured: by whole ticks on the rigid plant.
        steps: responses at rest. task: metrics of the whole task, or why it ended early.
    """

    scenario: Scenario
    laws: dict[str, Law]
    instant: Instant
    predicted: dict[str, Coupling]
    measured: dict[str, Coupling]
    steps: dict[str, dict[str, StepRun]]
    task: dict[str, dict[str, dict[str, Any]]]

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

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: the frames, every number of the table and more."""
        margins = {plant: self.margin(plant) for plant in PLANTS}
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
                plant: {"force_to_motion": f, "motion_to_force": m}
                for plant, (f, m) in margins.items()
            },
        }

    def _law(self, key: str) -> dict[str, Any]:
        law, predicted, measured = self.laws[key], self.predicted[key], self.measured[key]
        row: dict[str, Any] = {"label": self.label(key)}
        if isinstance(law, SelectionLaw):
            chosen = law.selection
            row |= {
                "equation": law.baseline.equation,
                "source": law.baseline.source,
                "selection": {
                    "point_m": chosen.linear.translation.tolist(),
                    "force_axes": chosen.linear.rotation[:, np.array(chosen.forces)].T.tolist(),
                    "couple_axes": chosen.angular[:, np.array(chosen.couples)].T.tolist(),
                },
            }
        for name, coupling in (("predicted", predicted), ("measured", measured)):
            f, m = coupling.norms
            row[name] = {"force_to_motion": f, "motion_to_force": m, "cost": coupling.cost}
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


def compare(scenario: Scenario, *, seed: int = 0, progress: Progress | None = None) -> Comparison:
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
        raise InvalidInputError(
            "the comparison needs contacts that are closed from the start; give contacts and set "
            "tare: null"
        )
    rigs = {plant: build_rig(_on(plant, scenario)) for plant in PLANTS}
    instant = Instant(rigs["rigid"].state(), rigs["rigid"].contact())
    laws: dict[str, Law] = {OURS: Ours()}
    for key, baseline in BASELINES.items():
        laws[key] = best_selection(instant, baseline, seed=seed)
    steps: dict[str, dict[str, StepRun]] = {plant: {} for plant in PLANTS}
    task: dict[str, dict[str, dict[str, Any]]] = {plant: {} for plant in PLANTS}
    for plant, key in _pairs(laws):
        tell = _tell(progress, f"{key} on {plant}: steps")
        steps[plant][key] = run_steps(rigs[plant], laws[key], instant, tell)
        tell = _tell(progress, f"{key} on {plant}: task")
        task[plant][key] = _whole_task(rigs[plant], laws[key], seed, tell)
    return Comparison(
        scenario=scenario,
        laws=laws,
        instant=instant,
        predicted={key: instant.coupling(law) for key, law in laws.items()},
        measured={k: measured_coupling(rigs["rigid"], law, instant) for k, law in laws.items()},
        steps=steps,
        task=task,
    )


def _whole_task(rig: Rig, law: Law, seed: int, tell: Callable[[float], None]) -> dict[str, Any]:
    try:
        verdict = metrics(run(rig.scenario, seed=seed, progress=tell, install=law.install))
    except PlantError as error:
        return {"failed": str(error)}
    return {key: verdict[key] for key in ("force", "motion", "contact_fraction", "status")}


def _on(plant: str, scenario: Scenario) -> Scenario:
    changes: dict[str, Any] = {"type": plant}
    if plant == "rigid":
        changes["step"] = 1.0 / scenario.control.rate
    return scenario.replaced(plant=scenario.plant.model_dump() | changes)


def _pairs(laws: dict[str, Law]) -> Iterator[tuple[str, str]]:
    return ((plant, key) for plant in PLANTS for key in laws)


def _tell(progress: Progress | None, what: str) -> Callable[[float], None]:
    def tell(t: float) -> None:
        if progress is not None:
            progress(what, t)

    return tell
