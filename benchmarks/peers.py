"""The tick beside what else could be run in its place, on the same rigs."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.cases import CASES, TickCase, repeatable
from benchmarks.engines import constraint_dynamics, mujoco_inverse
from benchmarks.measuring import (
    bars,
    joined,
    machine,
    new_axes,
    require_count,
    spread,
    take_turns,
)
from benchmarks.textbook import TextbookLaw
from osc_contact import robots
from osc_contact.contacts.contact import Contact
from osc_contact.control.controller import Controller
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array
from paper.baselines.coupling import Instant
from paper.baselines.frames import best_selection
from paper.baselines.laws import BASELINES

__all__ = ["TSID_PYTHON", "draw", "measure", "peers_of", "tables"]

TSID_PYTHON = "OSC_CONTACT_TSID_PYTHON"
BLOCKS = 10
TSID_CASE = "one_panda"
TICK, FLOOR = "tick", "floor: computeAllTerms"
TSID = "TSID: pose, posture, one contact"
HOW_TO_TSID = (
    'python3 -m venv ENV && ENV/bin/pip install "tsid==1.7.1" "pin==3.4.0" "cmeel-urdfdom<5" '
    f'"cmeel-tinyxml2<11", then --tsid-python ENV/bin/python (or {TSID_PYTHON})'
)


@dataclass(frozen=True)
class Peers:
    """Calls by name: those of compiled code, and those that live in Python; `unwind` after each."""

    compiled: dict[str, Callable[[], object]]
    python: dict[str, Callable[[], object]]
    unwind: Callable[[], None]


def peers_of(case: TickCase) -> Peers:
    """The tick and what could be run in its place, at the case's instant."""
    tick, unwind = case.tick()
    compiled = {
        TICK: tick,
        FLOOR: case.floor(),
        "pin.constraintDynamics": constraint_dynamics(case),
        "MuJoCo mj_inverse": mujoco_inverse(case),
    }
    python: dict[str, Callable[[], object]] = {
        "textbook law in NumPy": TextbookLaw(case).tick,
    }
    state = case.chain.state(case.measurement.q, case.measurement.v)
    parts = [pair.contact(state.X_WO, state.V_O) for pair in case.pairs]
    instant = Instant(state, Contact.stack(parts))
    for baseline in BASELINES.values():
        law = best_selection(instant, baseline, restarts=0)
        controller = law.install(repeatable(case.controller()))
        python[f"{baseline.label} (in Python)"] = _ticking(controller, case)
    return Peers(compiled, python, unwind)


def _ticking(controller: Controller, case: TickCase) -> Callable[[], object]:
    return lambda: controller.tick(case.measurement, case.reference)


def measure(rounds: int = 500, tsid_python: Path | None = None) -> dict[str, Any]:
    """{"machine": …, "cases": {case: {"peers_us": {name: spread}, "ratio": {name: …}}}, "tsid": …}.

    Compiled peers take turns among themselves, those in Python among themselves, in alternating
    blocks: microseconds measured right after a millisecond of Python are those of cold caches.
    `ratio` is a median over the tick's. TSID alternates with its own Pinocchio's floor in another
    process, twice; between, the tick alternates with its floor alone (`tsid.tick_us`, `.ratio`).

    Args:
        rounds: of the peers in Python; compiled ones have ten times as many.
        tsid_python: interpreter of TSID's environment (default: environment variable).

    Raises:
        InvalidInputError: no rounds, or TSID's interpreter fails.
    """
    require_count(rounds, "rounds")
    given = tsid_python or os.environ.get(TSID_PYTHON)
    cases: dict[str, Any] = {}
    tsid: dict[str, Any] = {"missing": HOW_TO_TSID}
    for name in ("two_contact_rod", "one_panda"):
        with_tsid = name == TSID_CASE and given is not None
        peers = peers_of(CASES[name]())
        times = {peer: spread(found) for peer, found in _in_blocks(peers, rounds).items()}
        if with_tsid:
            tsid = _beside_tsid(peers, Path(str(given)), 10 * rounds)
            times[TSID] = tsid["total_us"]
        tick = times[TICK]["p50"]
        cases[name] = {
            "peers_us": times,
            "ratio": {peer: t["p50"] / tick for peer, t in times.items()},
        }
    return {"machine": machine(), "rounds": rounds, "cases": cases, "tsid": tsid}


def _in_blocks(peers: Peers, rounds: int) -> dict[str, Array]:
    blocks = min(BLOCKS, rounds)
    found: list[dict[str, Array]] = []
    for _ in range(blocks):
        fast = take_turns(peers.compiled, 10 * rounds // blocks, between=peers.unwind)
        found.append(fast | take_turns(peers.python, max(1, rounds // blocks)))
    return joined(found)


def _beside_tsid(peers: Peers, python: Path, rounds: int) -> dict[str, Any]:
    """TSID's run that was less disturbed, and the tick in the same pattern: next to its floor."""
    runs = [_tsid(python, rounds)]
    alone = {name: peers.compiled[name] for name in (TICK, FLOOR)}
    tick = spread(take_turns(alone, rounds, between=peers.unwind)[TICK])
    runs.append(_tsid(python, rounds))
    best = min(runs, key=lambda run: float(run["total_us"]["p50"]))
    return best | {"tick_us": tick, "ratio": best["total_us"]["p50"] / tick["p50"]}


def _tsid(python: Path, rounds: int) -> dict[str, Any]:
    program = Path(__file__).with_name("tsid_peer.py")
    urdf, _ = robots.find_robot("panda")
    command = [str(python), "-I", str(program), str(urdf), str(rounds)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    except OSError as error:
        raise InvalidInputError(f"{python} cannot be run: {error}. {HOW_TO_TSID}") from error
    if done.returncode != 0:
        said = (done.stderr.strip() or "nothing").splitlines()[-1]
        raise InvalidInputError(f"{python} cannot run TSID: {said}. {HOW_TO_TSID}")
    return dict(json.loads(done.stdout))


def tables(result: dict[str, Any]) -> list[Table]:
    """One table a case."""
    found = []
    for name, case in result["cases"].items():
        title = f"{name}: {result['rounds']} rounds, compiled code {10 * result['rounds']}"
        table = Table("µs", "p50", "p99", "p99.9", "max", "p50 / tick", title=title)
        for peer, times in case["peers_us"].items():
            numbers = (f"{times[key]:.1f}" for key in ("p50", "p99", "p99_9", "max"))
            table.add_row(peer, *numbers, f"{case['ratio'][peer]:.2f}")
        if name == TSID_CASE and "missing" in result["tsid"]:
            table.caption = f"TSID: {result['tsid']['missing']}"
        found.append(table)
    if "floor_us" in result["tsid"]:
        found[-1].caption = (
            "TSID, in its own process: computeProblemData {problem_us[p50]:.1f}, solve "
            "{solve_us[p50]:.1f}, its floor (pin {pin}) {floor_us[p50]:.1f}; the tick, next to its "
            "floor alone as TSID is: {tick_us[p50]:.1f}; TSID / tick {ratio:.2f}"
        ).format(**result["tsid"])
    return found


def draw(result: dict[str, Any], path: Path) -> None:
    """Medians as bars, µs on a logarithmic axis."""
    from matplotlib.ticker import LogFormatter

    from osc_contact.visual.plots import save, style

    with style():
        cases = result["cases"]
        figure, axes = new_axes(len(cases))
        for ax, (name, case) in zip(axes, cases.items(), strict=True):
            medians = {peer: times["p50"] for peer, times in case["peers_us"].items()}
            bars(ax, medians, "median time (µs)", marked=(TICK,))
            ax.set_xscale("log")
            ax.set_xlim(0.5 * min(medians.values()), 3.0 * max(medians.values()))
            ax.xaxis.set_major_formatter(LogFormatter())
            slowest = np.max(list(case["ratio"].values()))
            ax.set_title(f"{name}: tick {medians[TICK]:.1f} µs, slowest peer {slowest:.0f} ×")
        save(figure, path.with_suffix(""))
