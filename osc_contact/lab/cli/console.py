"""Functions shared by commands: output, errors, exit codes, tasks, runs with a progress bar."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import parent_process
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from typer import Argument, Exit, Option

from osc_contact.errors import InvalidInputError, OscContactError, PlantError, missing
from osc_contact.files import sole_user
from osc_contact.lab.reports import report, viewing
from osc_contact.lab.runs.recovery import recover
from osc_contact.lab.runs.run import run
from osc_contact.lab.scenarios.loader import load_scenario
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.tasks.packaged import PackagedTask, run_task
from osc_contact.lab.visual.parts import Content
from osc_contact.lab.visual.run_figures import FigureProcess
from osc_contact.loop.protocols import Shows
from osc_contact.recorder import Recording
from osc_contact.recorder.events import events_beside
from osc_contact.recorder.judged import SETTLE_S

ScenarioArgument = Annotated[str, Argument(help="packaged name (see `list`) or a YAML file")]


PlantOption = Annotated[
    Literal["mujoco", "rigid", "drake"] | None, Option(help="instead of the scenario's own")
]
DurationOption = Annotated[float | None, Option(help="seconds, instead of the scenario's own")]
SeedOption = Annotated[int, Option(min=0, help="of everything random")]
SetOption = Annotated[
    list[str] | None, Option("--set", help="path.to.key=value, any number of times")
]
FolderOption = Annotated[
    Path | None,
    Option(help="of the scenario's file, if its URDFs are beside it"),
]
JsonOption = Annotated[Path | None, Option("--json", help="also write the result as JSON")]

# without markup: names of robots may hold brackets
out = Console(width=None if sys.stdout.isatty() else 120, markup=False)
err = Console(stderr=True, markup=False)
WHOLE = "recording.npz"
PARTIAL = "recording_until_failure.npz"
UNFINISHED = "unfinished.mcap"


def progress_bar(*columns: ProgressColumn) -> Progress:
    """Progress bar below the other output, with further columns in its line.

    It is shown on terminals only, and only by the process that was started there.
    """
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        *columns,
        console=err,
        transient=True,
        disable=not err.is_terminal or parent_process() is not None,
    )


class CompilationBar:
    """Progress bar of the compilation of the law, below the other output, on terminals only."""

    def __init__(self) -> None:
        """Begin without a bar; it is made when the compilation begins."""
        self._bar: Progress | None = None  #: progress bar; None until it is shown

    def __call__(self, share: float) -> None:
        """Show the progress; remove the bar at the end.

        Args:
            share: completed share of the work, 0 … 1.
        """
        if self._bar is None and share < 1.0:
            self._bar = progress_bar(TimeElapsedColumn())
            self._bar.add_task("compiling", total=1.0)
            self._bar.start()
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=share)
            if share >= 1.0:
                self._bar.stop()
                self._bar = None


def say(*parts: str | Table) -> None:
    """Print texts and tables unchanged, each on a new line."""
    for part in parts:
        out.print(part, highlight=False, soft_wrap=isinstance(part, str))


def require(package: str) -> None:
    """Refuse to continue without a package that is needed later.

    Raises:
        ModuleNotFoundError: the package is not installed.
    """
    if find_spec(package) is None:
        raise ModuleNotFoundError(f"No module named '{package}'", name=package)


def load_program(name: str) -> ModuleType:
    """Import the `__main__` module of another package of a checkout, such as `benchmarks`.

    The folder of the checkout is put first on Python's path, so that this process and its workers
    do not import another package of that name.

    Args:
        name: name of the package; its folder is a sibling of `osc_contact`.

    Raises:
        InvalidInputError: there is no such folder, as in an installed wheel.
    """
    root = Path(__file__).resolve().parents[3]
    required_files = (root / "pyproject.toml", root / name / "__main__.py")
    if not all(file.is_file() for file in required_files):
        raise InvalidInputError(
            f"this command needs the folder {name}/ of a checkout or of the source archive: unpack "
            "one, run `pip install -e '.[all]'` in it and repeat the command there"
        )
    if sys.path[0] != str(root):
        sys.path.insert(0, str(root))
    return import_module(f"{name}.__main__")


@contextmanager
def exit_codes() -> Iterator[None]:
    """Turn expected errors of the block into a message on stderr and an exit code.

    The code is 1 if the plant failed in a run (`PlantError`); it is 2 for every other
    `OscContactError`, for an `OSError`, such as a file that cannot be read, and for a package of an
    extra that is not installed, also if that was the cause of a `PlantError`. All other errors are
    raised unchanged, with their traceback, among them an `ImportError` that is not of an extra.

    Raises:
        Exit: with the code, in place of an expected error.
    """
    try:
        yield
    except (OscContactError, ImportError, OSError) as error:
        cause = error if isinstance(error, ImportError) else error.__cause__
        absent = missing(cause) if isinstance(cause, ImportError) else ""
        if isinstance(error, ImportError) and not absent:
            raise
        words = absent or "\n".join((str(error), *getattr(error, "__notes__", ())))
        err.print(f"error: {words}", style="red", highlight=False, soft_wrap=True)
        failed = isinstance(error, PlantError) and not absent
        raise Exit(1 if failed else 2) from error


def run_with_progress(
    scenario: Scenario, seed: int, folder: Path | None, viewer: Shows | None = None
) -> Recording:
    """Run a scenario, with a progress bar on a terminal.

    Args:
        scenario: scenario to run.
        seed: seed of random errors.
        viewer: viewer that shows the run while it lasts; None: none.
        folder: existing folder for the rows of the run in progress and for the recording of a
            failed run; None: neither is written.

    Raises:
        PlantError: the plant failed.
    """
    journal = None if folder is None else folder / UNFINISHED
    with progress_bar(TextColumn("{task.completed:.1f} s"), TimeRemainingColumn()) as bar:
        task = bar.add_task(f"{scenario.name} on {scenario.plant.type}", total=scenario.duration)
        try:
            return run(
                scenario,
                seed=seed,
                progress=lambda t: bar.update(task, completed=t),
                viewer=viewer,
                journal=journal,
            )
        except PlantError as error:
            if error.recording is not None and folder is not None:
                error.recording.save(folder / PARTIAL)
                forget_rows(folder)
                error.add_note(f"recorded until then: {folder / PARTIAL}")
            raise


def record_task(task: PackagedTask, seed: int, journal: Path | None = None) -> Recording:
    """Run a packaged task with a progress bar, and return its recording.

    Args:
        task: packaged task.
        seed: seed of everything random.
        journal: file of the rows while it runs; None: a temporary file.
    """
    with progress_bar(TextColumn("{task.completed:.1f} s")) as bar:
        row = bar.add_task(f"{task.name}, seed {seed}", total=None)
        return run_task(
            task, seed, journal=journal, progress=lambda t: bar.update(row, completed=t)
        )


def run_packaged_task(task: PackagedTask, seed: int, folder: Path, json_file: Path | None) -> bool:
    """Run a packaged task, write its results, and print its verdict.

    Args:
        task: packaged task.
        seed: seed of everything random.
        folder: folder for the files.
        json_file: another file for the verdict.

    Returns:
        Whether the task failed.
    """
    with sole_user(folder):
        recording = record_task(task, seed, folder / UNFINISHED)
        verdict = report.write_task_report(recording, folder)
        forget_rows(folder)
    out.print(report.inserted_table(verdict))
    say(*report.task_lines(verdict))
    if json_file:
        report.write_json(verdict, json_file)
    say(f"written to {folder}: metrics.json, recording.npz, scene.html")
    return bool(verdict["task"]["failed"])


def refuse_changes(
    what: str, overrides: list[str] | None, plant: str | None, duration: float | None
) -> None:
    """Refuse options that change scenarios, for a recording or a packaged task.

    Args:
        what: what is run or shown, in words.
        overrides: texts path.to.key=value; None: none.
        plant: type of the plant in place of the scenario's; None: unchanged.
        duration: duration of the run in place of the scenario's (s); None: unchanged.

    Raises:
        InvalidInputError: one of the options is given.
    """
    if overrides or plant or duration is not None:
        raise InvalidInputError(f"--set, --plant and --duration change scenarios, not {what}")


def forget_rows(folder: Path) -> None:
    """Remove the files in which a run kept its rows, after its recording has been written."""
    for path in (folder / UNFINISHED, events_beside(folder / UNFINISHED)):
        path.unlink(missing_ok=True)


def recording_in(name: str) -> str:
    """Name of the recording in a run's folder; the name of a file is returned unchanged.

    Raises:
        InvalidInputError: the folder contains no recording.
    """
    folder = Path(name)
    if not folder.is_dir():
        return name
    for file in (WHOLE, PARTIAL, UNFINISHED):
        if (folder / file).is_file():
            return str(folder / file)
    raise InvalidInputError(
        f"{name} is a folder without a recording: there is no {WHOLE}, {PARTIAL} or {UNFINISHED}"
    )


def open_recording(name: str, folder: Path | None) -> Recording:
    """Load a recording, or recover it from the rows of a run that was killed.

    Args:
        name: name of the file; .mcap files hold rows.
        folder: folder of the scenario's file, if its URDFs are beside it.
    """
    return recover(name, folder) if name.endswith(".mcap") else Recording.load(name)


def record(scenario: Scenario, seed: int, folder: Path) -> Recording:
    """Run a scenario and return its recording.

    Args:
        scenario: scenario to run.
        seed: seed of the noise.
        folder: folder for the rows of the run while it lasts.
    """
    with sole_user(folder):
        recording = run_with_progress(scenario, seed, folder)
        forget_rows(folder)
    return recording


def report_run(
    recording: Recording,
    scenario: Scenario,
    folder: Path,
    json_file: Path | None,
    figures: FigureProcess | None = None,
) -> tuple[str, bool]:
    """Write the results of a run and print its verdict.

    Args:
        recording: recording of the run.
        scenario: scenario of the run.
        folder: folder for the files.
        json_file: another file for the verdict.
        figures: process that draws the figures; None: this process draws them.

    Returns:
        A list of the files written, as text, and whether the task of the run failed.
    """
    if len(recording) <= SETTLE_S * scenario.control.rate:  # it ended before it was to
        recording.save(folder / WHOLE)
        return (f"{WHOLE}; the run was too short to be judged", False)
    verdict = report.write_report(recording, scenario, folder, figures)
    out.print(report.verdict_table(verdict))
    say(*report.task_lines(verdict))
    if json_file:
        report.write_json(verdict, json_file)
    return ("metrics.json, recording.npz, figures, scene.html", bool(verdict["task"]["failed"]))


def show_live(
    shown: Content,
    scenario: Scenario | None,
    recording: Recording | None,
    seed: int,
    hold: float | None,
) -> None:
    """Show a run, or a recording, in a browser in real time.

    Args:
        shown: bodies and marks of the page.
        scenario: scenario to run, if `recording` is None.
        recording: recording to replay.
        seed: seed of the noise of the run.
        hold: time for which to wait for a browser, and for which the page stays after the end (s);
            None: on a terminal until Ctrl-C, elsewhere 0.
    """
    at_terminal = out.is_terminal
    patience = stay = hold or 0.0
    if hold is None and at_terminal:
        patience = 15.0
        stay = float("inf")
    with viewing.open_viewer(shown) as viewer:
        hint = "   (Ctrl-C ends it)" if at_terminal else ""
        say(f"open {viewer.url}{hint}")
        viewing.wait_for(lambda: viewer.count_browsers() > 0, patience)
        try:
            if recording is not None:
                viewing.replay(recording, viewer)
            elif scenario is not None:
                run_with_progress(scenario, seed, None, viewing.RealTime(viewer))
            viewing.wait_for(lambda: viewer.error is not None, stay)
        except KeyboardInterrupt:
            return
        if viewer.error is not None:
            raise viewer.error


def changed(
    overrides: list[str] | None, plant: str | None = None, duration: float | None = None
) -> list[str]:
    """Changes of a scenario by the command line, as a list of KEY=VALUE.

    Args:
        overrides: values of the option --set.
        plant: type of the plant instead of the scenario's.
        duration: duration instead of the scenario's (s).
    """
    values = {"plant.type": plant, "duration": duration}
    options = [f"{key}={value}" for key, value in values.items() if value is not None]
    return [*(overrides or ()), *options]


def load_task(
    name: str,
    overrides: list[str] | None,
    plant: str | None = None,
    duration: float | None = None,
) -> Scenario:
    """Load a scenario with the changes of the command line.

    Args:
        name: name of the scenario, or its file.
        overrides: texts path.to.key=value; None: none.
        plant: type of the plant in place of the scenario's; None: unchanged.
        duration: duration of the run in place of the scenario's (s); None: unchanged.
    """
    return load_scenario(name, changed(overrides, plant, duration))


def require_report(scenario: Scenario) -> None:
    """Refuse a scenario whose report would fail after the run.

    Raises:
        ModuleNotFoundError: Matplotlib is not installed.
        InvalidInputError: the run would be too short to be judged.
    """
    require("matplotlib")
    report.require_judgeable(scenario)
