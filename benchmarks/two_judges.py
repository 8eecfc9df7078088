"""Tasks judged by MuJoCo and by Drake, which share no dynamics with each other or the controller.

    make worlds    (or, in its environment: python -m benchmarks.two_judges [--only TEXT]
                    [--set KEY=VALUE], with FULL=1: the table of docs/drake.md)

Five packaged scenarios, the controller unchanged but for `control.force.reading: least_squares`, in
the MuJoCo plant of the scenario and in the Drake plant (lagged contacts; `tamsi`, too, where one
arm closes no loop), on faces without friction and with a coefficient of 0.2 that the controller
does not know. The numbers are those of `osc.metrics`, with its windows: after the first seconds,
without the rise of steps. Columns: largest rms error of a contact force, as a share of its mean
command; rms error of the path along the free directions; largest force; share of the time in
contact; status at the end. A limit that is missed is named below the table, and the exit code is 1
then.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

import osc_contact as osc
from benchmarks.measuring import side_by_side, table_from

SCENARIOS = ("two_contact_rod", "panda_edge", "dual_panda_rod", "ur5_wipe", "three_arm_plate")
#: Scenarios of one arm, in which Drake's `tamsi` closes no loop.
OPEN_CHAINS = ("panda_edge", "ur5_wipe")
FRICTION = (0.0, 0.2)
DRAKE_STEP = "0.5 ms"
FORCE = 0.02  #: limit of force rms errors, as a share of the mean command
ROD_FORCE, ROD_PATH = 0.0012, 5e-5  #: of two_contact_rod without friction (share, m)
FACTOR, TELLING = 2.0, 0.001  #: judges differ by more, and one force error is above
JUDGES = ("mujoco", "lagged", "tamsi")


@dataclass(frozen=True)
class Verdict:
    """Verdict of one judge on one task.

    Attributes:
        scenario: name of the task.
        friction: coefficient of the faces.
        judge: `mujoco`, or Drake's approximation of contacts.
        force: largest rms error of a contact force (share of its mean command).
        path: rms error along the free directions (m).
        peak: largest contact force (N).
        closed: share of the time in contact.
        status: words on the end of the run.
    """

    scenario: str
    friction: float
    judge: str
    force: float
    path: float
    peak: float
    closed: float
    status: str

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of `force` and `path`."""
        if self.scenario == "two_contact_rod" and self.friction == 0.0:
            return ROD_FORCE, ROD_PATH
        return FORCE, np.inf

    @property
    def is_within(self) -> bool:
        """True if both errors are within their limits."""
        force, path = self.limits
        return self.force <= force and self.path <= path


def changes(judge: str, friction: float = 0.0) -> list[str]:
    """Changes of a scenario for a judge.

    Args:
        judge: `mujoco`, or Drake's approximation of contacts.
        friction: coefficient of the faces.
    """
    common = ["control.force.reading=least_squares", f"plant.friction={friction}"]
    if judge == "mujoco":
        return common
    drake = ["plant.type=drake", f"plant.step={DRAKE_STEP}", f"plant.drake.contact={judge}"]
    return [*common, *drake]


def judged(
    name: str,
    friction: float,
    judge: str,
    duration: float | None = None,
    others: Sequence[str] = (),
) -> Verdict:
    """Run a scenario before a judge.

    Args:
        name: packaged scenario.
        friction: coefficient of the faces.
        judge: `mujoco`, or Drake's approximation of contacts.
        duration: duration (s); None: the scenario's.
        others: further changes of the scenario.
    """
    logging.getLogger("drake").setLevel(logging.ERROR)  # it warns of elements of URDFs
    scenario = osc.load_scenario(name, [*changes(judge, friction), *others])
    recording = osc.run(scenario, duration=duration)
    verdict: dict[str, Any] = osc.metrics(recording)
    alpha = recording["alpha_true"]
    return Verdict(
        name,
        friction,
        judge,
        max(one["rms_error_rel"] for one in verdict["force"].values()),
        float(verdict["motion"]["rms_error_m"]),
        float(alpha.max()),
        float(np.mean(recording["closed"][round(0.1 * len(alpha)) :])),
        osc.Status(int(recording["status"][-1])).name,
    )


def cases(
    only: str = "",
    duration: float | None = None,
    judges: Sequence[str] = JUDGES,
    others: Sequence[str] = (),
) -> list[tuple[Any, ...]]:
    """Arguments of `judged` for all runs whose scenario's name has a text.

    Args:
        only: text.
        duration: duration (s); None: the scenario's.
        judges: MuJoCo, or Drake's approximations of contacts.
        others: further changes of the scenarios.
    """
    return [
        (name, friction, judge, duration, others)
        for name in SCENARIOS
        if only in name
        for friction in FRICTION
        for judge in judges
        if judge != "tamsi" or name in OPEN_CHAINS
    ]


def main(
    only: str = "",
    duration: float = 0.0,
    workers: int = 2,
    judges: str = ",".join(JUDGES),
    others: Annotated[list[str] | None, typer.Option("--set")] = None,
) -> None:
    """Print the table, the missed limits, and where the judges differ.

    Args:
        only: text that scenarios' names have.
        duration: duration of each run (s); 0: the scenario's.
        workers: number of processes.
        judges: mujoco, lagged, tamsi, similar, sap, separated by commas; Drake's two last are
            refused where they would lift a sliding contact.
        others: further changes of the scenarios, as of `osc-contact run`.
    """
    found = cases(only, duration or None, judges.split(","), others or ())
    verdicts = list(side_by_side(judged, found, workers))
    console = Console(width=150)
    console.print(table_from("Two judges", [row(one) for one in verdicts]))
    by_task: dict[tuple[str, float], dict[str, Verdict]] = {}
    for one in verdicts:
        by_task.setdefault((one.scenario, one.friction), {})[one.judge] = one
    for (name, friction), by_judge in by_task.items():
        if not {"mujoco", "lagged"} <= by_judge.keys():
            continue
        mujoco, lagged = by_judge["mujoco"].force, by_judge["lagged"].force
        factor = max(mujoco, lagged) / min(mujoco, lagged)
        if factor > FACTOR and max(mujoco, lagged) > TELLING:
            console.print(f"{name}, μ {friction}: forces differ by a factor of {factor:.1f}")
    missed = [one for one in verdicts if not one.is_within]
    for one in missed:
        console.print(f"{one.scenario}, μ {one.friction}, {one.judge}: a limit is missed")
    sys.exit(bool(missed))


def row(one: Verdict) -> dict[str, Any]:
    """Line of the table.

    Args:
        one: verdict.
    """
    return {
        "scenario": one.scenario,
        "μ": f"{one.friction:g}",
        "judge": "MuJoCo" if one.judge == "mujoco" else f"Drake, {one.judge}",
        "force rms (%)": f"{100 * one.force:.3g}",
        "path rms (mm)": f"{1e3 * one.path:.3g}",
        "peak (N)": f"{one.peak:.1f}",
        "in contact": f"{one.closed:.3f}",
        "end": one.status,
    }


if __name__ == "__main__":
    typer.run(main)
