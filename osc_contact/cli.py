"""The command line `osc-contact`: thin, everything it does is a call into the package."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from osc_contact.errors import OscContactError, PlantError
from osc_contact.experiments import figures as paper_figures
from osc_contact.experiments.inspection import inspect_rig
from osc_contact.experiments.report import write_json, write_report
from osc_contact.experiments.rig import build_rig
from osc_contact.experiments.run import run as run_scenario
from osc_contact.experiments.timing import time_tick
from osc_contact.recorder import Recording
from osc_contact.scenarios import Scenario, list_scenarios, load_scenario

__all__ = ["app"]

app = typer.Typer(
    help="Decoupled force and motion control of arms in contact.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
out = Console()
err = Console(stderr=True)


class PlantName(StrEnum):
    """Which plant judges the controller."""

    mujoco = "mujoco"
    rigid = "rigid"


ScenarioArgument = Annotated[str, typer.Argument(help="packaged name (see `list`) or a YAML file")]
PlantOption = Annotated[PlantName | None, typer.Option(help="instead of the scenario's own")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="also write the result as JSON")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="path.to.key=value, any number of times")
]


@app.command()
def run(
    scenario: ScenarioArgument,
    plant: PlantOption = None,
    duration: Annotated[float | None, typer.Option(help="s, instead of the scenario's own")] = None,
    out_dir: Annotated[Path | None, typer.Option("--out", help="folder for the results")] = None,
    seed: Annotated[int, typer.Option(help="of everything random")] = 0,
    set_: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Run a scenario; write metrics.json, the recording, figures and an HTML scene."""
    with _exit_codes():
        chosen = _load(scenario, set_, plant, duration)
        folder = out_dir or Path("out") / chosen.name
        recording = _run_with_progress(chosen, seed)
        verdict = write_report(recording, chosen, folder)
        out.print(_verdict_table(verdict))
        out.print(f"written to {folder}: metrics.json, recording.npz, figures, scene.html")
        if json_file:
            write_json(verdict, json_file)


@app.command()
def reproduce(
    figure: Annotated[str, typer.Argument(help="fig1 | fig4 | fig5 | fig6 | fig8 | all")],
    out_dir: Annotated[Path, typer.Option("--out", help="folder for the figures")] = Path(
        "out/figures"
    ),
    seed: Annotated[int, typer.Option(help="of the run behind figs. 6 and 8")] = 0,
    json_file: JsonOption = None,
) -> None:
    """Make figures of the paper from our own data (PNG and SVG)."""
    with _exit_codes():
        names = paper_figures.FIGURES if figure == "all" else (figure,)
        unknown = [name for name in names if name not in paper_figures.FIGURES]
        if unknown:
            raise typer.BadParameter(
                f"no figure '{unknown[0]}'; there are {', '.join(paper_figures.FIGURES)} and all"
            )
        recording, verdict = None, {}
        if any(name in paper_figures.needs_run for name in names):
            scenario = load_scenario(paper_figures.SCENARIO)
            recording = _run_with_progress(scenario, seed)
            verdict = write_report(recording, scenario, out_dir / scenario.name)
            out.print(_verdict_table(verdict))
        written = [paper_figures.write_figure(name, out_dir, recording) for name in names]
        for path in written:
            out.print(f"written: {path}")
        if json_file:
            write_json({"figures": [str(p) for p in written], "metrics": verdict}, json_file)


@app.command()
def inspect(
    scenario: ScenarioArgument, set_: SetOption = None, json_file: JsonOption = None
) -> None:
    """Say in plain words what the contact state is: d, r, free motions, forces, N and T."""
    with _exit_codes():
        found = inspect_rig(build_rig(_load(scenario, set_)))
        for line in found.lines:
            out.print(line, highlight=False, soft_wrap=True)
        out.print(
            _basis_table("N: forces the contacts transmit", found.N, found.contacts, ("", "m"))
        )
        names = [f"t{i + 1}" for i in range(found.T.shape[1])]
        out.print(_basis_table("T: motions they permit", found.T, names, ("m/s", "rad/s")))
        if json_file:
            write_json(found.as_dict(), json_file)


@app.command("list")
def list_(json_file: JsonOption = None) -> None:
    """List the packaged scenarios and the figures that can be reproduced."""
    scenarios = list_scenarios()
    table = Table("scenario", "what it is", title="osc-contact run SCENARIO")
    for name, words in scenarios.items():
        table.add_row(name, words.strip())
    out.print(table)
    out.print(f"osc-contact reproduce {' | '.join(paper_figures.FIGURES)} | all")
    if json_file:
        write_json({"scenarios": scenarios, "figures": list(paper_figures.FIGURES)}, json_file)


@app.command()
def bench(
    what: Annotated[str, typer.Argument(help="tick")],
    ticks: Annotated[int, typer.Option(help="timed ticks")] = 1000,
    json_file: JsonOption = None,
) -> None:
    """Time the control tick against Pinocchio's own model evaluation of the same arms."""
    with _exit_codes():
        if what != "tick":
            raise typer.BadParameter(f"no benchmark '{what}'; there is: tick")
        result = time_tick([paper_figures.SCENARIO], ticks)
        table = Table("case", "tick p50", "floor p50", "ratio", "tick p99.9", title="µs")
        for case, row in result.items():
            table.add_row(case, *(f"{value:.1f}" for value in row.values()))
        out.print(table)
        if json_file:
            write_json(result, json_file)


def _load(
    name: str,
    overrides: list[str] | None,
    plant: PlantName | None = None,
    duration: float | None = None,
) -> Scenario:
    changes = list(overrides or [])
    if plant is not None:
        changes.append(f"plant.type={plant.value}")
    if duration is not None:
        changes.append(f"duration={duration!r}")
    return load_scenario(name, changes)


def _run_with_progress(scenario: Scenario, seed: int) -> Recording:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.1f} s"),
               TimeRemainingColumn())  # fmt: skip
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task(f"{scenario.name} on {scenario.plant.type}", total=scenario.duration)
        return run_scenario(scenario, seed=seed, progress=lambda t: bar.update(task, completed=t))


@contextmanager
def _exit_codes() -> Iterator[None]:
    """0 done, 1 the run failed, 2 bad input; messages without a traceback."""
    try:
        yield
    except OscContactError as error:
        err.print(f"error: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        raise typer.Exit(1 if isinstance(error, PlantError) else 2) from error


def _verdict_table(verdict: dict[str, Any]) -> Table:
    title = (
        f"{verdict['scenario']} on {verdict['plant']}, {verdict['duration_s']:g} s, "
        f"{verdict['real_time_factor']:.2f} × real time"
    )
    table = Table("quantity", "value", title=title)
    for name, force in verdict["force"].items():
        table.add_row(
            f"force {name}",
            f"rms {100 * force['rms_error_rel']:.3f} %, peak {100 * force['peak_error_rel']:.3f} % "
            f"of {force['mean_command_N']:.2f} N; sensed within "
            f"{100 * force['sensing_rms_rel']:.3f} %; closed "
            f"{100 * verdict['contact_fraction'][name]:.2f} %",
        )
    motion = verdict["motion"]
    table.add_row(
        "free motion",
        f"rms {1e3 * motion['rms_error_m']:.4f} mm, {1e3 * motion['rms_error_rad']:.4f} mrad",
    )
    power = verdict["power"]
    table.add_row(
        "power", f"total {power['total_rms_W']:.4g} W, projected {power['projected_rms_W']:.3g} W, "
        f"ratio {100 * power['ratio']:.3g} %",
    )  # fmt: skip
    tick = verdict["tick_us"]
    table.add_row("tick", f"p50 {tick['p50']:.0f} µs, p99 {tick['p99']:.0f} µs")
    table.add_row("ticks", ", ".join(f"{n} {name}" for name, n in verdict["status"].items() if n))
    return table


def _basis_table(title: str, basis: Any, names: Any, units: tuple[str, str]) -> Table:
    table = Table("", *names, title=f"{title} (at the object's origin, world axes)")
    kinds = ("force", "moment") if title.startswith("N") else ("linear", "angular")
    for i, row in enumerate(basis):
        kind, unit = kinds[i // 3], units[i // 3]
        label = f"{kind} {'xyz'[i % 3]}" + (f" [{unit}]" if unit else "")
        table.add_row(label, *(f"{round(value, 4) + 0.0:.4f}" for value in row))
    return table
