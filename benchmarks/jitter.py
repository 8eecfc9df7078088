"""The tick on the clock: absolute deadlines, compute time and wake-up jitter apart."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from pathlib import Path
from time import perf_counter_ns, sleep
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.cases import CASES
from benchmarks.measuring import (
    machine,
    new_axes,
    require_count,
    spread,
)
from osc_contact.spatial import Array

__all__ = ["RATES_HZ", "clocked", "draw", "measure", "tables"]

RATES_HZ = (1000, 2000, 5000)
BLOCKS = 8
TICK, EMPTY = "tick", "empty"


def clocked(body: Callable[[], object], rate_hz: int, periods: int) -> tuple[Array, Array, int]:
    """Run a body at absolute deadlines k/rate; a late period is not made up for by a burst.

    Returns:
        (periods,) µs that each wake-up came after its deadline, (periods,) µs that the body took,
        and how many deadlines were missed: the body had not ended when the next one was due.
    """
    period = round(1e9 / rate_hz)
    late, spent = np.zeros(periods), np.zeros(periods)
    missed = 0
    due = perf_counter_ns() + period
    for k in range(periods):
        left = due - perf_counter_ns()
        if left > 0:
            sleep(1e-9 * left)
        awake = perf_counter_ns()
        body()
        end = perf_counter_ns()
        late[k], spent[k] = awake - due, end - awake
        skipped = max(0, (end - due) // period)
        missed += skipped
        due += (1 + skipped) * period
    return late / 1e3, spent / 1e3, missed


def measure(periods: int = 4000) -> dict[str, Any]:
    """{"machine": …, "rates": {rate: {"tick" | "empty": {wake_up_us, compute_us, missed}}}}.

    The loop with the tick of `two_contact_rod` and the same loop with an empty body take turns in
    blocks, so that both see the same machine; their wake-ups differ by what the tick does to them.

    Args:
        periods: of each loop at each rate.

    Raises:
        InvalidInputError: no periods.
    """
    require_count(periods, "periods")
    tick, unwind = CASES["two_contact_rod"]().tick()

    def whole_tick() -> None:
        tick()
        unwind()

    bodies: dict[str, Callable[[], object]] = {TICK: whole_tick, EMPTY: lambda: None}
    rates = {}
    for rate in RATES_HZ:
        blocks = min(BLOCKS, periods)
        found: dict[str, list[tuple[Array, Array, int]]] = {name: [] for name in bodies}
        for _ in range(blocks):
            for name, body in bodies.items():
                found[name].append(clocked(body, rate, max(1, periods // blocks)))
        rates[str(rate)] = {name: _joined(blocks_of) for name, blocks_of in found.items()}
    return {
        "machine": machine(),
        "scheduler": _scheduler(),
        "timer_slack_us": _timer_slack(),
        "kernel": platform.version(),
        "rates": rates,
    }


def _joined(blocks: list[tuple[Array, Array, int]]) -> dict[str, Any]:
    late, spent = (np.concatenate([block[i] for block in blocks]) for i in (0, 1))
    return {
        "periods": len(late),
        "wake_up_us": spread(late),
        "compute_us": spread(spent),
        "missed": sum(block[2] for block in blocks),
    }


def _scheduler() -> str:
    names = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}
    return names.get(os.sched_getscheduler(0), "another")


def _timer_slack() -> float | None:
    """How much later than asked for the kernel may wake this process, µs (Linux: 50 by default)."""
    file = Path("/proc/self/timerslack_ns")
    return int(file.read_text()) / 1e3 if file.is_file() else None


def tables(result: dict[str, Any]) -> list[Table]:
    """Wake-up and compute time of both loops at each rate."""
    title = f"absolute deadlines, {result['scheduler']}, timer slack {result['timer_slack_us']} µs"
    table = Table(
        "rate", "body", "periods", "what (µs)", "p50", "p99", "p99.9", "max", "missed", title=title
    )
    for rate, bodies in result["rates"].items():
        for name, loop in bodies.items():
            first = (f"{int(rate) / 1000:g} kHz", name, str(loop["periods"]))
            table.add_row(*first, "wake-up", *_numbers(loop["wake_up_us"]), str(loop["missed"]))
            table.add_row("", "", "", "compute", *_numbers(loop["compute_us"]), "")
        table.add_section()
    return [table]


def _numbers(times: dict[str, float]) -> list[str]:
    return [f"{times[key]:.1f}" for key in ("p50", "p99", "p99_9", "max")]


def draw(result: dict[str, Any], path: Path) -> None:
    """Median to 99.9 % of wake-up and compute time, by rate."""
    from osc_contact.visual import OKABE_ITO
    from osc_contact.visual.plots import save, style

    series = {
        "wake-up, empty body": (EMPTY, "wake_up_us", "black"),
        "wake-up, tick": (TICK, "wake_up_us", "blue"),
        "compute, tick": (TICK, "compute_us", "vermillion"),
    }
    with style():
        figure, (ax,) = new_axes(1)
        for i, (label, (body, what, colour)) in enumerate(series.items()):
            times = [bodies[body][what] for bodies in result["rates"].values()]
            at = np.arange(len(times)) + 0.12 * (i - 1)
            low, high = (np.array([t[key] for t in times]) for key in ("p50", "p99_9"))
            ax.errorbar(
                at, low, [np.zeros(len(low)), high - low], fmt="o", capsize=4, label=label,
                color=OKABE_ITO[colour],
            )  # fmt: skip
        ax.set_xticks(
            range(len(result["rates"])), [f"{int(r) / 1000:g} kHz" for r in result["rates"]]
        )
        ax.set(yscale="log", ylabel="µs: p50, whisker to p99.9")
        ax.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        save(figure, path.with_suffix(""))
