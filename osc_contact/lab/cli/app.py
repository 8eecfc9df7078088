"""Command line `osc-contact`: options and output of calls into the package."""

import atexit
import gc
import re
import unicodedata
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Context, Exit, Option, Typer
from typer.core import TyperGroup

from osc_contact import __version__
from osc_contact.errors import Interrupted, InvalidInputError
from osc_contact.files import sole_user, write_whole
from osc_contact.lab.checks.inspection import inspect_rig
from osc_contact.lab.checks.preflight import require_ready
from osc_contact.lab.cli import robots as cli_robots
from osc_contact.lab.cli import sweeps as cli_sweeps
from osc_contact.lab.cli.console import (
    CompilationBar,
    DurationOption,
    FolderOption,
    JsonOption,
    PlantOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    err,
    exit_codes,
    forget_rows,
    load_program,
    load_task,
    open_recording,
    out,
    record_task,
    recording_in,
    refuse_changes,
    report_run,
    require,
    require_report,
    run_packaged_task,
    run_with_progress,
    say,
    show_live,
)
from osc_contact.lab.reports import report, viewing
from osc_contact.lab.reports.viewing import shown_of
from osc_contact.lab.reports.web_page import write_web_page
from osc_contact.lab.rig.rig import build_rig
from osc_contact.lab.runs.tape import build as build_library
from osc_contact.lab.scenarios.loader import FILES, list_scenarios
from osc_contact.lab.sweeps.workers import available_cores
from osc_contact.lab.tasks.packaged import TASKS, task_content
from osc_contact.lab.visual.browser import find_browser, write_gif, write_mp4
from osc_contact.lab.visual.run_figures import FigureProcess
from osc_contact.law import compiled


class Commands(TyperGroup):
    """Group of all commands, whose errors end the process with an exit code."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command of the command line."""
        with exit_codes():
            return super().invoke(ctx)


app = Typer(
    cls=Commands,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
for command in (
    cli_sweeps.sweep,
    cli_sweeps.tune,
    cli_robots.check,
    cli_robots.pose,
    cli_robots.new,
    cli_robots.commission,
):
    app.command()(command)
RECORDINGS = (".npz", ".mcap")  #: suffixes of recordings
#: settings of a command that hands all its arguments to another program
PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


def _show_version(requested: bool) -> None:
    """Print the version and end, if it was requested."""
    if requested:
        say(f"osc-contact {__version__}")
        raise Exit


@app.callback()
def main(
    context: Context,
    version: Annotated[
        bool, Option("--version", callback=_show_version, is_eager=True, help="and exit")
    ] = False,
) -> None:
    """Decoupled force and motion control of arms in contact."""
    if context.invoked_subcommand is None:
        say(FIRST_STEPS)
    compiled.report_to(lambda text: err.print(text, style="dim", highlight=False), CompilationBar())
    atexit.register(gc.freeze)  # else Python visits all of numba's objects before it ends


@app.command()
def run(
    scenario: ScenarioArgument,
    plant: PlantOption = None,
    duration: DurationOption = None,
    out_dir: Annotated[
        Path | None, Option("--out", help="folder for the results (default: out/SCENARIO)")
    ] = None,
    seed: SeedOption = 0,
    set_: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Run a scenario or packaged task; write metrics.json, recording, figures and an HTML scene."""
    if scenario in TASKS:
        refuse_changes("a task, which takes --seed", set_, plant, duration)
        folder = out_dir or Path("out") / scenario
        raise Exit(int(run_packaged_task(TASKS[scenario], seed, folder, json_file)))
    task = load_task(scenario, set_, plant, duration)
    folder = out_dir or Path("out") / task.file_stem
    require_report(task)
    code = 0  # exit code: 130 after an interruption, 1 if the task failed or there are doubts
    # a second process loads matplotlib during the run, where there is a core for it
    figure_process = FigureProcess() if available_cores() > 1 else nullcontext()
    with sole_user(folder), figure_process as figures:
        try:
            recording = run_with_progress(task, seed, folder)
        except Interrupted as error:
            recording = error.recording
            code = 130
            say(str(error))
        written, failed = report_run(recording, task, folder, json_file, figures)
        forget_rows(folder)
    missing = recording.meta.get("missing", ())
    say(*missing, f"written to {folder}: {written}")
    if failed or missing or recording.meta.get("doubts"):
        code = code or 1
    raise Exit(code)


@app.command()
def export(
    recording: Annotated[
        str, Argument(help="folder of a run, its recording.npz or unfinished.mcap")
    ],
    file: Annotated[Path, Argument(help="to write: .npz, .csv or .mcap")],
    folder: FolderOption = None,
) -> None:
    """Write a recording for other programs; recover that of a run that was killed."""
    loaded = open_recording(recording_in(recording), folder)
    say(*loaded.meta.get("missing", ()))
    say(f"written: {loaded.export(file)}")


@app.command(context_settings=PASSED_ON)
def reproduce(context: Context) -> None:
    """Make the paper's figures from our own data, with a report on them (needs a checkout)."""
    load_program("paper").app(context.args, prog_name="osc-contact reproduce")


@app.command()
def build(
    scenario: ScenarioArgument,
    folder: Annotated[Path, Option("--out", help="folder for the C library")],
    ticks: Annotated[int, Option(min=1, help="to record for the replay")] = 10_000,
    seed: SeedOption = 0,
    set_: SetOption = None,
) -> None:
    """Write the scenario's controller for C programs, with a recording to replay there."""
    tape = build_library(build_rig(load_task(scenario, set_)), folder, ticks, seed)
    say(f"{tape.count} ticks recorded. Build and replay: make -C {folder} && {folder}/replay")


@app.command()
def view(
    what: Annotated[
        str,
        Argument(metavar="SCENARIO|RECORDING", help="as for `run`, an .npz file, a run's folder"),
    ],
    *,
    live: Annotated[bool, Option("--live", help="in a browser, during the run")] = False,
    html: Annotated[
        Path | None,
        Option(help="one file that needs no server"),
    ] = None,
    png: Annotated[Path | None, Option(help="a picture of the page")] = None,
    gif: Annotated[Path | None, Option(help="a moving picture of it")] = None,
    mp4: Annotated[Path | None, Option(help="a video of it (extra `video`)")] = None,
    time: Annotated[
        float | None,
        Option(help="s: stand still there (PNG: default the middle)"),
    ] = None,
    hold: Annotated[
        float | None,
        Option(help="s: wait for a browser, stay after the end (terminal: until Ctrl-C)"),
    ] = None,
    plant: PlantOption = None,
    duration: DurationOption = None,
    seed: SeedOption = 0,
    set_: SetOption = None,
    folder: FolderOption = None,
) -> None:
    """Look at a scenario or a recording: page with a time slider (default), PNG, GIF, MP4, live."""
    # bodies and marks to draw (`content`): of a recording, a task that is run first, or a scenario
    film = gif or mp4
    _require_writable(live, html, png, gif, mp4, time)
    recording = scenario = None
    what = recording_in(what)
    if what.endswith(RECORDINGS):
        refuse_changes("recordings", set_, plant, duration)
        recording = open_recording(what, folder)
        content = shown_of(recording, Path(what), folder)
        viewing.require_drawable(recording, content, what)
    elif what in TASKS:
        refuse_changes("a task, which takes --seed", set_, plant, duration)
        recording = record_task(TASKS[what], seed)
        content = task_content(recording)
    else:
        scenario = load_task(what, set_, plant, duration)
        content = viewing.content_of(build_rig(scenario))
    if live:
        show_live(content, scenario, recording, seed, hold)
        return
    if scenario is not None:  # everything but a live view needs the whole run
        recording = run_with_progress(scenario, seed, None)
    assert recording is not None
    if png:
        written = viewing.picture(recording, content, png, time)
    elif film:
        write = write_gif if gif else write_mp4
        written = viewing.moving_picture(recording, content, film, write)
    else:
        page = html or Path("out") / f"{Path(what).stem}.html"
        written = viewing.write_scene_of(recording, content, page, time)
    say(f"written: {written}")


def _require_writable(
    live: bool,
    html: Path | None,
    png: Path | None,
    gif: Path | None,
    mp4: Path | None,
    time: float | None,
) -> None:
    """Refuse a combination of options of `view`, or a format whose program is not installed.

    Args:
        live: True: the run is shown while it lasts.
        html, png, gif, mp4: files to be written; None: not requested.
        time: time of a still picture (s); None: not requested.

    Raises:
        InvalidInputError: several results, or a time for a moving picture.
        ViewerError: no browser for a picture.
        ModuleNotFoundError: a package for moving pictures is not installed.
    """
    files = [file for file in (html, png, gif, mp4) if file is not None]
    if len(files) > 1 or (live and files):
        raise InvalidInputError(
            "give one of --live, --html FILE, --png FILE, --gif FILE and --mp4 FILE"
        )
    if (gif or mp4) and time is not None:
        kind = "a GIF" if gif else "a video"
        raise InvalidInputError(f"{kind} shows the whole recording: leave --time out")
    if png or gif or mp4:
        find_browser()
    if mp4:
        require("av")
    if gif or mp4:
        require("PIL")


@app.command()
def page(
    scenario: ScenarioArgument,
    folder: Annotated[Path, Option("--out", help="folder for the page and its files")],
    without: Annotated[
        str, Option(metavar="NAME,…", help="leave out what a page cannot have: tare, noise, …")
    ] = "",
    mujoco: Annotated[
        Path | None, Option(help="archive of npm pack @mujoco/mujoco, where npm is not here")
    ] = None,
    selection: Annotated[
        bool, Option("--selection", help="beside it a selection law (needs a checkout)")
    ] = False,
    one_file: Annotated[
        bool, Option("--one-file", help="all in index.html, which opens from disk")
    ] = False,
    set_: SetOption = None,
) -> None:
    """Write a web page that runs plant and law in the browser; any static server will do."""
    names = [name for name in without.split(",") if name]
    select = load_program("paper").selection_of if selection else None
    sizes = write_web_page(load_task(scenario, set_), folder, names, mujoco, select, one_file)
    size = sum(sizes.values()) / 1e6
    if one_file:
        say(f"{folder / 'index.html'}, {size:.1f} MB: open it in a browser")
        return
    say(f"{len(sizes)} files, {size:.1f} MB, written to {folder}")
    say(f"look at it: python -m http.server -d {folder} 8000, then http://localhost:8000")


@app.command()
def inspect(
    scenario: ScenarioArgument, set_: SetOption = None, json_file: JsonOption = None
) -> None:
    """Describe the contact state in plain words: d, r, free motions, forces, N and T."""
    rig = build_rig(load_task(scenario, set_))
    doubts = require_ready(rig)
    inspection = inspect_rig(rig)
    say(*inspection.lines)
    for table in report.basis_tables(inspection):
        out.print(table)
    if json_file:
        report.write_json(inspection.as_dict(), json_file)
    if doubts:
        raise Exit(1)


@app.command("list")
def list_(json_file: JsonOption = None) -> None:
    """List the packaged scenarios and tasks."""
    scenarios = list_scenarios()
    tasks = {name: task.description for name, task in TASKS.items()}
    out.print(report.scenario_table(scenarios | tasks))
    say("osc-contact reproduce --help lists the figures")
    if json_file:
        report.write_json({"scenarios": scenarios, "tasks": tasks}, json_file)


@app.command(context_settings=PASSED_ON)
def bench(context: Context) -> None:
    """Time the control tick, and more: `python -m benchmarks` (needs a checkout)."""
    load_program("benchmarks").app(context.args, prog_name="osc-contact bench")


# First steps: five commands, and the short programs of the docs as files.


FIRST_STEPS = """\
Contact forces and free motion of arms, controlled at once. Five things to do first:

  osc-contact list                        the tasks that come with it
  osc-contact inspect two_contact_rod     what its contacts transmit and permit, in words
  osc-contact run two_contact_rod         run it: verdict, figures, a moving scene in out/
  osc-contact new --robot panda           a first task for a robot: a YAML file that runs
  osc-contact examples                    programs and scenarios, to run and to change

All commands: osc-contact --help"""
PAGES = (
    "README.md",
    "press_and_slide.md",
    "objects.md",
    "two_arms.md",
    "holes_and_pegs.md",
    "contact_phases.md",
    "come_and_go.md",
    "plans.md",
    "insert_a_peg.md",
    "which_contact.md",
    "friction.md",
    "own_loop.md",
    "others_loops.md",
    "own_driver.md",
    "batch.md",
    "without_python.md",
    "mujoco_arm.md",
    "extend.md",
)
PROGRAM = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#{1,3} (.*)$", re.MULTILINE)


@app.command()
def examples(
    folder: Annotated[Path, Argument(help="where to write them")] = Path("examples"),
) -> None:
    """Write the programs of the docs and the packaged scenarios as files, to run and to change."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidInputError(f"{folder} is there already: name an empty or a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    first = None
    for number, (name, title, code) in enumerate(programs(), start=1):
        path = folder / f"{number:02d}_{name}.py"
        first = first or path
        write_whole(f"# {title}\n\n{code}", path)
        say(f"{path}: {title}")
    copies = folder / "scenarios"
    copies.mkdir()
    for source in sorted(FILES.glob("*.yaml")):
        write_whole(source.read_text(encoding="utf-8"), copies / source.name)
    say(f"{copies}: the packaged scenarios")
    say(f"run one: python {first}, osc-contact run {copies / 'two_contact_rod.yaml'}")


def programs() -> Iterator[tuple[str, str, str]]:
    """Programs of the pages for users: file name, title and text of each.

    A title is that of the page and of the section, such as "Two arms: The chain in Python".
    """
    for page in PAGES:
        text = _page_file(page).read_text(encoding="utf-8")
        for program in PROGRAM.finditer(text):
            title, *sections = HEADING.findall(PROGRAM.sub("", text[: program.start()]))
            if page == "README.md":
                yield ("first_program", "First program", program[1])
            elif sections:
                name = _file_name_of(f"{Path(page).stem} {sections[-1]}")
                yield (name, f"{title}: {sections[-1]}", program[1])
            else:
                yield (Path(page).stem, title, program[1])


def _page_file(name: str) -> Path:
    """File of a page, inside the installed package or in the checkout.

    Args:
        name: name of the page.
    """
    package = Path(__file__).resolve().parents[2]
    places = (package / "docs" / name, package.parent / "docs" / name, package.parent / name)
    return next((place for place in places if place.is_file()), places[0])


def _file_name_of(heading: str) -> str:
    """Heading as a file name: its words in ASCII letters, joined by "_"."""
    plain = unicodedata.normalize("NFKD", heading).encode("ascii", "ignore")
    return "_".join(re.findall(r"[a-z0-9]+", plain.decode().lower()))
