"""False stops: packaged scenarios with joint friction, coarse encoders, noisy and late wrists.

    python -m benchmarks.false_stops [--only TEXT] [--seed N --count K] [--workers 2]

Each packaged scenario whose plant has such errors runs for its own duration, with dry friction of
0, 1 and 2 % of the smallest motor, with ideal encoders and with those of 16, 18 and 20 bits (a turn
or a metre), and with its own wrists and with wrists that have noise and are late by 3 ms. Nothing
is faulty: the exit code is 1 where a run ends in a stop. Verdicts are kept in out/false_stops by
the hash of the sources, so that the same command goes on where it was interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import osc_contact as osc
from benchmarks.kept import ROOT, Kept
from benchmarks.measuring import side_by_side
from osc_contact.control.status import SafetyState
from paper.study import table_of

KEPT = ROOT / "out/false_stops"
FRICTION = (0.0, 0.01, 0.02)  #: of the torque limit of the smallest motor
BITS = (0, 16, 18, 20)  #: of a turn and of a metre; 0: ideal
WRIST = "{rate: 1 kHz, delay: 3 ms, force: {noise: 0.5 N}, torque: {noise: 0.05 Nm}}"


@dataclass(frozen=True)
class Errors:
    """One run: scenario, friction and bits (see above), whether wrists are noisy and late."""

    scenario: str
    friction: float
    bits: int
    noisy: bool

    def __str__(self) -> str:
        encoders = f"{self.bits} bits" if self.bits else "ideal encoders"
        wrists = ", noisy wrists" if self.noisy else ""
        return f"{self.scenario}, friction {self.friction:g}, {encoders}{wrists}"

    def overrides(self) -> list[str]:
        """Changes of the scenario."""
        found = [f"plant.joint_friction={self.friction:g}"] if self.friction else []
        if self.bits:
            turn = 2.0 * np.pi / 2**self.bits
            steps = f"angle: {{resolution: {turn} rad}}, length: {{resolution: {0.5**self.bits} m}}"
            found.append(f"sensors.encoder={{rate: 1 kHz, {steps}}}")
        if self.noisy:
            found.append(f"sensors.wrist={WRIST}")
        return found


@dataclass(frozen=True)
class Ended:
    """End of a run.

    Attributes:
        errors: of it.
        stopped: whether it was; a stop lasts to the end.
        reason: reason of the stop.
    """

    errors: Errors
    stopped: bool = False
    reason: str = ""

    @property
    def key(self) -> Errors:
        """The run that it is of."""
        return self.errors


def read_ended(row: dict[str, Any]) -> Ended:
    """A verdict from the fields that it was kept with."""
    return Ended(**{**row, "errors": Errors(**row["errors"])})


def runs() -> list[Errors]:
    """All runs, in an order in which neighbours differ in their scenario."""
    names = [n for n in osc.list_scenarios() if not osc.load_scenario(n).plant.exact]
    wrists = {name: bool(osc.load_scenario(name).contacts) for name in names}
    every = product(FRICTION, BITS, (False, True), names)
    return [
        Errors(name, friction, bits, noisy)
        for friction, bits, noisy, name in every
        if wrists[name] or not noisy
    ]


def try_errors(errors: Errors, duration: float | None = None) -> Ended:
    """Run a scenario with these errors.

    Args:
        errors: see there.
        duration: s; None: the scenario's own.
    """
    scenario = osc.load_scenario(errors.scenario, errors.overrides())
    meta = osc.run(scenario, duration=duration).meta
    if meta["end_state"] != SafetyState.SAFE_STOP.name:
        return Ended(errors)
    return Ended(errors, True, str(meta["first_reason"]))


def table(ended: Sequence[Ended]) -> Table:
    """One line for each scenario."""
    rows = []
    for name in dict.fromkeys(one.errors.scenario for one in ended):
        mine = [one for one in ended if one.errors.scenario == name]
        rows.append((name, len(mine), sum(one.stopped for one in mine)))
    return table_of("", "scenario; runs; stopped", rows)


def main(only: str = "", seed: int = 0, count: int = 0, workers: int = 2) -> None:
    """Run them all; exit with 1 if anything stopped.

    Args:
        only: runs whose name contains this.
        seed: seed of the runs that are drawn.
        count: number of runs drawn from all; 0: all.
        workers: processes.
    """
    wanted = [one for one in runs() if only in str(one)]
    if not wanted:
        raise typer.BadParameter(f"no run has {only!r} in its name")
    if 0 < count < len(wanted):
        drawn = np.random.default_rng(seed).choice(len(wanted), count, replace=False)
        wanted = [wanted[i] for i in sorted(drawn)]
    kept = Kept(KEPT, read_ended)
    missing = [(one,) for one in wanted if one not in kept.found]
    for ended in side_by_side(try_errors, missing, workers) if missing else ():
        kept.add(ended)
    found = [kept.found[one] for one in wanted]
    for ended in found:
        if ended.stopped:
            print(f"{ended.errors}: stopped: {ended.reason}")
    Console(width=120).print(table(found))
    stopped = sum(ended.stopped for ended in found)
    print(f"{len(found)} runs, {stopped} of them stopped")
    sys.exit(bool(stopped))


if __name__ == "__main__":
    typer.run(main)
