"""Commands of studies: many runs of one scenario with other numbers."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from rich.progress import MofNCompleteColumn, TimeRemainingColumn
from rich.table import Table
from typer import Exit, Option

from osc_contact.errors import InvalidInputError
from osc_contact.lab.cli.console import (
    DurationOption,
    JsonOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    changed,
    out,
    progress_bar,
    require,
    say,
)
from osc_contact.lab.reports.report import write_json
from osc_contact.lab.sweeps.report import REPORT, in_words, write_report
from osc_contact.lab.sweeps.study import Design, SweepStudy
from osc_contact.lab.sweeps.sweep import TABLE, run_study
from osc_contact.lab.sweeps.tune import Tuned

WorkersOption = Annotated[int | None, Option(min=1, help="processes (default: one for each core)")]
SchedulerOption = Annotated[str | None, Option(help="address of a dask cluster that does it")]


def sweep(
    scenario: ScenarioArgument,
    *,
    vary: Annotated[
        list[str],
        Option(help="path.to.key=uniform(A, B), any number; see docs/sweeps.md for others"),
    ],
    samples: Annotated[
        int, Option(min=1, help="points; on a grid: values of each key that can have any")
    ] = 100,
    design: Annotated[Design, Option(help="how they are placed")] = "halton",
    seed: SeedOption = 0,
    duration: DurationOption = None,
    set_: SetOption = None,
    out_dir: Annotated[
        Path | None, Option("--out", help="folder (default: out/SCENARIO_sweep)")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json_file: JsonOption = None,
) -> None:
    """Run a scenario many times with other numbers; the same command continues after a kill."""
    require("pyarrow")
    study = SweepStudy.of(scenario, vary, samples, design, seed, changed(set_, duration=duration))
    folder = out_dir or Path("out") / f"{Path(scenario).stem}_sweep"
    with counting("runs", study.rows) as progress:
        try:
            table = run_study(
                study, out=folder, workers=workers, scheduler=scheduler, progress=progress
            )
        except KeyboardInterrupt:
            say(f"interrupted; the same command continues with what is in {folder}")
            raise Exit(130) from None
    summary = write_report(table, study, folder)
    say(*in_words(summary))
    columns = f"{table.num_rows} rows of {table.num_columns} columns"
    say(f"written to {folder}: {TABLE}, {columns}; {REPORT}")
    if json_file:
        write_json(summary, json_file)


@contextmanager
def counting(label: str, total: int) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on a terminal while the block runs.

    Args:
        label: name of the items that are counted.
        total: number of all items.

    Yields:
        A function that takes the number of completed items, and the total.
    """
    with progress_bar(MofNCompleteColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task(label, total=total)
        yield lambda done, _: bar.update(task, completed=done)


def tune(
    scenario: ScenarioArgument,
    *,
    vary: Annotated[
        list[str] | None,
        Option(help="path.to.key=DISTRIBUTION to tune (default: the gains, factors of them)"),
    ] = None,
    objective: Annotated[
        str, Option(help="force | motion | both | a column of the sweep's table")
    ] = "both",
    limit: Annotated[
        list[str] | None,
        Option(help="COLUMN=MOST (default: overshoots and saturated ticks of the shipped)"),
    ] = None,
    trials: Annotated[int, Option(min=1, help="in all")] = 60,
    over: Annotated[
        list[str] | None, Option(help="path.to.key=DISTRIBUTION of what is not known")
    ] = None,
    samples: Annotated[int, Option(min=1, help="of that, for each trial")] = 1,
    seed: SeedOption = 0,
    duration: DurationOption = None,
    set_: SetOption = None,
    out_dir: Annotated[
        Path | None, Option("--out", help="folder of the trials; continues them")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json_file: JsonOption = None,
) -> None:
    """Tune keys of a scenario with Optuna; print those to paste."""
    require("optuna")
    from osc_contact.lab.sweeps.tune import tune as find

    with counting("trials", trials) as progress:
        tuned = find(
            scenario,
            vary or (),
            objective=objective,
            limits=_parse_limits(limit or []),
            trials=trials,
            over=over or (),
            samples=samples,
            seed=seed,
            overrides=changed(set_, duration=duration),
            out=out_dir,
            workers=workers,
            scheduler=scheduler,
            progress=progress,
        )
    # without a better trial there is nothing to paste: exit code 1
    show_tuned(tuned, objective)
    if json_file:
        write_json(asdict(tuned) | {"better": tuned.better}, json_file)
    if not tuned.better:
        raise Exit(1)


def _parse_limits(texts: list[str]) -> dict[str, float]:
    """Largest value by column, read from texts COLUMN=NUMBER.

    Raises:
        InvalidInputError: a text of another form.
    """
    limits = {}
    for text in texts:
        name, _, limit = text.partition("=")
        try:
            limits[name.strip()] = float(limit)
        except ValueError as error:
            raise InvalidInputError(f"--limit {text!r}: write COLUMN=NUMBER") from error
    return limits


def show_tuned(tuned: Tuned, objective: str) -> None:
    """Print the tuned numbers next to the shipped ones, and the keys to paste."""
    table = Table("worst over all samples", "shipped", "found")
    for name, (before, after) in tuned.numbers.items():
        table.add_row(name, f"{before:.4g}", f"{after:.4g}")
    out.print(table)
    say(f"{objective}: {tuned.shipped:.4g} shipped, {tuned.best:.4g} after {tuned.trials} trials")
    for words in tuned.broken:
        say(f"no trial keeps all limits: {words}")
    if not tuned.better:
        say("nothing better was found; give more --trials, or other keys with --vary")
    for path, value in tuned.values.items():
        say(f"{path}: {value}")
