"""How commands talk: output and complaints, exit codes, a run with a progress bar."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from osc_contact.errors import OscContactError, PlantError
from osc_contact.recorder import Recording
from osc_contact.runs.run import run
from osc_contact.scenarios import Scenario
from osc_contact.visual.live import Shows

__all__ = [
    "PARTIAL", "UNFINISHED", "err", "exit_codes", "forget_rows", "out", "require",
    "run_with_progress", "say",
]  # fmt: skip

out = Console(width=None if sys.stdout.isatty() else 120)
err = Console(stderr=True)
PARTIAL = "recording_until_failure.npz"
UNFINISHED = "unfinished.mcap"
EXTRAS = {"matplotlib": "plot", "mpl_toolkits": "plot", "mujoco": "sim", "ruckig": "sim"}


def say(text: str) -> None:
    """Print a text as it is."""
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def require(package: str) -> None:
    """Refuse what would fail later for want of a package."""
    if find_spec(package) is None:
        raise ModuleNotFoundError(f"No module named '{package}'", name=package)


@contextmanager
def exit_codes() -> Iterator[None]:
    """0 done, 1 the run failed, 2 bad input or a missing extra; messages without a traceback."""
    try:
        yield
    except (OscContactError, ImportError, OSError) as error:
        cause = error if isinstance(error, ImportError) else error.__cause__
        package = ((cause.name or "") if isinstance(cause, ImportError) else "").partition(".")[0]
        if isinstance(error, ImportError) and package not in EXTRAS:
            raise
        words = "\n".join((str(error), *getattr(error, "__notes__", ())))
        if package in EXTRAS:
            words = f"{package} is not installed: pip install 'osc-contact[{EXTRAS[package]}]'"
        err.print(f"error: {words}", style="red", highlight=False, markup=False, soft_wrap=True)
        failed = isinstance(error, PlantError) and package not in EXTRAS
        raise typer.Exit(1 if failed else 2) from error


def run_with_progress(
    scenario: Scenario, seed: int, folder: Path | None, viewer: Shows | None = None
) -> Recording:
    """Run, with a progress bar on a terminal.

    Args:
        scenario, seed, viewer: see `run`.
        folder: where a failed run leaves its recording, and any run its rows while it lasts.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.1f} s"),
               TimeRemainingColumn())  # fmt: skip
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    journal = None if folder is None else folder / UNFINISHED
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task(f"{scenario.name} on {scenario.plant.type}", total=scenario.duration)
        try:
            return run(
                scenario, seed=seed, progress=lambda t: bar.update(task, completed=t),
                viewer=viewer, journal=journal,
            )  # fmt: skip
        except PlantError as error:
            if error.recording is not None and folder is not None:
                error.recording.save(folder / PARTIAL)
                forget_rows(folder)
                error.add_note(f"recorded until then: {folder / PARTIAL}")
            raise


def forget_rows(folder: Path) -> None:
    """Remove the rows of a run, once what they make is written."""
    (folder / UNFINISHED).unlink(missing_ok=True)
