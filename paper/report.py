"""One HTML page: what the paper's figures state, and beside it ours, with numbers and verdicts.

The page holds everything it shows and fetches nothing. The scene of the run is folded into it and
unpacked when it is opened.
"""

from __future__ import annotations

import base64
import shlex
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table

import osc_contact as osc
from osc_contact import __version__
from osc_contact.files import write_whole
from osc_contact.lab.cli.console import out, record
from osc_contact.lab.reports.report import verdict_table, write_json, write_report
from osc_contact.lab.visual.page import POLICY, asset, filled
from osc_contact.lab.visual.plots import PRINT, save
from paper import (
    baselines,
    cone_in_groove,
    contact_phases,
    fig3,
    figures,
    kinematic_stability,
    robustness,
    variants,
)
from paper.figures import ANSWERS, Evidence
from paper.parallel import Job, Tell, done
from paper.statements import PAPER, Answer, PaperFigure, Verdict, judge
from paper.study import Ask, Data, Study

BROAD = {"fig3", "fig4", "fig5"}  #: these stand above their text
#: Class, mark and meaning of each verdict.
_MARKS = {
    Verdict.reproduced: ("yes", "✓", "every statement was put to the test and holds"),
    Verdict.partly: (
        "part",
        "…",
        "statements that nothing answers yet are marked open, or no picture was drawn",
    ),
    Verdict.contradicted: ("no", "✗", "a statement does not hold in ours"),
}


def write_paper_report(reproduction: Reproduction, path: Path) -> Path:
    """Write the report, which appears complete or not at all; returns its path.

    Args:
        reproduction: what was made. Studies that are no figures of the paper come last.
        path: path of the page.
    """
    verdicts = reproduction.verdicts()
    shown = [(figure, verdicts[figure.name]) for figure in PAPER if figure.name in verdicts]
    beside = {k: one for k, one in reproduction.made.items() if k not in verdicts}
    parts = {
        "policy": POLICY,
        "style": asset("report.css"),
        "script": asset("report.js"),
        "about": _about(reproduction),
        "overview": "".join(_row(*one) for one in shown),
        "rules": "".join(
            f"<li>{_badge(v)} <span>{escape(words)}</span></li>"
            for v, (*_, words) in _MARKS.items()
        ),
        "figures": "".join(_section(*one, reproduction) for one in shown),
        "scene": _scene(
            reproduction.scene, "Open the moving scene of the run, with slider and plots"
        ),
        "studies": "".join(_study(name, one, reproduction) for name, one in beside.items()),
    }
    return write_whole(filled("report.html", parts), path)


def _about(reproduction: Reproduction) -> str:
    run = "no run"
    if reproduction.recording is not None:
        meta = reproduction.recording.meta
        ticks = len(reproduction.recording)
        seconds = ticks / float(meta["control_rate_hz"])
        run = (
            f"a run of <b>{escape(reproduction.scenario.name)}</b> on the plant "
            f"<b>{meta['plant']}</b>: {seconds:g} s, {ticks} ticks, seed {meta['seed']}"
        )
    command = f"osc-contact reproduce all {reproduction.options}".strip()
    return (
        f"<p>Made by {_code(command)}, osc_contact {escape(__version__)}, from {run}. Forces, "
        "motion and power are judged by the plant's truth, from 1 s on, without the 50 ms after a "
        "step of a desired force.</p>"
    )


def _row(figure: PaperFigure, verdict: Verdict) -> str:
    return (
        f'<tr><td><a href="#{figure.name}">Fig. {figure.name[3:]}</a></td>'
        f"<td>{escape(figure.shows)}</td><td>{_badge(verdict)}</td></tr>"
    )


def _section(figure: PaperFigure, verdict: Verdict, reproduction: Reproduction) -> str:
    made = reproduction.made[figure.name]
    states = "".join(
        _statement(words, made.answers.get(key)) for key, words in figure.states.items()
    )
    pages = [path for path in made.files if path.suffix == ".html"]
    scenes = "".join(_scene(page, "Open the scene, to turn and look at") for page in pages)
    ours = "".join(_pictures(made, figure.name)) + scenes + _table(made.table)
    broad = " broad" * (figure.name in BROAD)
    command = _command(figure.name, reproduction)
    return (
        f'<section id="{figure.name}"><h2>Fig. {figure.name[3:]} {_badge(verdict)}</h2>'
        f'<div class="pair{broad}"><div class="paper"><h3>The paper shows</h3>'
        f"<p>{escape(figure.shows)}</p><h3>… states, and ours shows</h3><ol>{states}</ol>{command}"
        f'</div><div class="ours"><h3>Ours</h3>{ours}</div></div></section>'
    )


def _statement(words: str, answer: Answer | None) -> str:
    if answer is None:
        verdict = Verdict.partly
        text = "Open: this run does not answer it."
        limit = ""
    else:
        verdict = Verdict.reproduced if answer.holds else Verdict.contradicted
        text = answer.found
        limit = f' <span class="limit">Required: {escape(answer.limit)}.</span>' * bool(
            answer.limit
        )
    kind, mark, _ = _MARKS[verdict]
    return (
        f'<li><p>{escape(words)}</p><p class="answer"><span class="mark {kind}" title="{verdict}">'
        f"{mark}</span> {escape(text)}{limit}</p></li>"
    )


def _study(name: str, made: Study, reproduction: Reproduction) -> str:
    title = escape(name.replace("_", " "))
    return (
        f'<section id="{name}"><h2>{title[:1].upper() + title[1:]}</h2>{_table(made.table)}'
        f"{''.join(_pictures(made, name))}{_command(name, reproduction)}</section>"
    )


def _pictures(made: Study, name: str) -> Iterator[str]:
    """Each figure once, with its files to take away."""
    for path in made.files:
        if path.suffix == ".png":
            also = ", ".join(one.name for one in made.files if one.stem == path.stem)
            yield (
                f'<figure><div class="wide"><img src="data:image/png;base64,'
                f'{_base64(path.read_bytes())}" alt="{escape(path.stem)}: our {escape(name)}" '
                f'loading="lazy"></div><figcaption>Files beside this page: {escape(also)}'
                "</figcaption></figure>"
            )


def _table(table: Table | None) -> str:
    if table is None:
        return ""
    heads = "".join(f"<th>{escape(str(column.header))}</th>" for column in table.columns)
    body = ""
    for row in zip(*(column.cells for column in table.columns), strict=True):
        body += f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>"
    title = f"<caption>{escape(str(table.title))}</caption>" if table.title else ""
    return f'<div class="wide"><table>{title}<tr>{heads}</tr>{body}</table></div>'


def _scene(scene: Path | None, words: str) -> str:
    """A page folded into this one."""
    if scene is None:
        return ""
    packed = _base64(zlib.compress(scene.read_bytes(), 9))
    return (
        f'<details class="scene"><summary>{escape(words)}</summary><div></div></details>'
        f'<script type="text/plain">{packed}</script>'
    )


def _command(name: str, reproduction: Reproduction) -> str:
    command = f"osc-contact reproduce {name} {reproduction.options}".strip()
    return f'<p class="command">{_code(command)}</p>'


def _badge(verdict: Verdict) -> str:
    kind, mark, _ = _MARKS[verdict]
    return f'<span class="badge {kind}">{mark} {verdict}</span>'


def _code(text: str) -> str:
    return f"<code>{escape(text)}</code>"


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


# --- `osc-contact reproduce`: makes figures and studies, by their names ---


STUDIES: dict[str, Callable[[Ask], Study]] = {
    "fig2": cone_in_groove.study,
    "fig3": fig3.study,
    "kinematic_stability": kinematic_stability.study,
    "baselines": baselines.study,
    "robustness": robustness.study,
    **{name: partial(variants.compare, name) for name in variants.VARIANTS},
    "fig7": contact_phases.fig7,
}
RUNS: dict[str, Callable[[Ask], Mapping[str, Callable[[], Any]]]] = {
    **{name: partial(variants.runs, name) for name in variants.VARIANTS},
    "fig7": contact_phases.runs,
}
"""Independent runs of those studies that have several."""
SLOW = {"baselines", "robustness", "workcell", "fig7"}
"""several minutes: not in `reproduce all`"""
WITH_SCENARIO = SLOW | {"fig3", "moving_face"}
"""whose scenario can be changed"""
WITH_SAMPLES = {"robustness"}
"""whose runs are samples"""
REPRODUCIBLE = (*figures.FIGURES, *STUDIES)


class Reproduction(NamedTuple):
    """Everything that one command made.

    Attributes:
        made: results by name.
        options: options of the command, as typed.
        scene: the run's page.
        scenario: behind the figures that are not studies, recording: of its run, if there was one.
    """

    made: Mapping[str, Study]
    scenario: osc.Scenario
    recording: osc.Recording | None
    scene: Path | None
    options: str = ""

    def verdicts(self) -> dict[str, Verdict]:
        """By the names of the figures of the paper that were made."""
        return {
            figure.name: judge(figure, one.answers, one.drawn)
            for figure in PAPER
            if (one := self.made.get(figure.name))
        }

    def as_dict(self) -> Data:
        """JSON-able: files, the run's metrics, the studies' numbers, the paper's statements."""
        paper = {
            name: {
                "verdict": verdict.value,
                "answers": {k: a._asdict() for k, a in self.made[name].answers.items()},
            }
            for name, verdict in self.verdicts().items()
        }
        return {
            "figures": [str(path) for one in self.made.values() for path in one.files],
            "metrics": {} if self.recording is None else osc.metrics(self.recording),
            "studies": {k: one.data for k, one in self.made.items() if one.data is not None},
            "paper": paper,
        }


def names_of(figure: str) -> tuple[str, ...]:
    """The names behind one word of the command line.

    "all" are the paper's figures and the studies that take no minutes.

    Raises:
        InvalidInputError: unknown, with the names there are.
    """
    if figure == "all":
        paper = {one.name for one in PAPER}
        return tuple(name for name in REPRODUCIBLE if name in paper or name not in SLOW)
    if figure not in REPRODUCIBLE:
        raise osc.InvalidInputError(f"no figure '{figure}'; there are {', '.join(REPRODUCIBLE)}")
    return (figure,)


def typed(plant: str | None, duration: float | None, seed: int, changes: Sequence[str]) -> str:
    """The options of a command as they are typed.

    Args:
        plant: value of `--plant`; None if it was not given.
        duration: value of `--duration` (s); None if it was not given.
        seed: value of `--seed`; 0 is left out.
        changes: values of `--set`.
    """
    given = {"--plant": plant, "--duration": duration and f"{duration:g}", "--seed": seed or None}
    words = [word for pair in given.items() if pair[1] is not None for word in map(str, pair)]
    return shlex.join([*words, *(word for change in changes for word in ("--set", change))])


def make(
    names: Sequence[str], folder: Path, scenario: osc.Scenario, ask: Ask, options: str = ""
) -> Reproduction:
    """Make figures and studies on all cores; their tables are printed in the order of the names.

    Args:
        names: names in `FIGURES` and `STUDIES`.
        folder: for everything that is written.
        scenario: behind the figures that are not studies; run if one of them needs it.
        ask: options of the studies, and the seed of that run.
        options: options of the command, as typed; shown in the report.
    """
    drawn = [name for name in names if name not in STUDIES]
    needs_run = bool(figures.NEED_RUN.intersection(drawn))
    jobs = list(_jobs(names, folder, scenario, ask))
    shown = [job.name for job in jobs if not job.name.partition(BETWEEN)[1]]
    made: dict[str, Study] = {}
    found = {}
    for name, result in done(jobs, LONG):
        found[name] = result
        while shown and shown[0] in found:
            for study_name, study in found[shown.pop(0)].items():
                made[study_name] = study
                if study.table is not None:
                    out.print(study.table)
    of_run = folder / scenario.name
    return Reproduction(
        {name: made[name] for name in (*drawn, *(k for k in names if k in STUDIES))},
        scenario,
        osc.Recording.load(of_run / "recording.npz") if needs_run else None,
        of_run / "scene.html" if needs_run else None,
        options,
    )


#: Jobs that take long, by their names: they begin first where there are several cores.
LONG = ("fig7: workcell", "fig2", "fig3", figures.SCENARIO)
BETWEEN = ": "  #: name of a study and name of its run


def _jobs(names: Sequence[str], folder: Path, scenario: osc.Scenario, ask: Ask) -> Iterator[Job]:
    """Yield all jobs: the figures of one run, the runs of studies, and the studies.

    Args:
        names, folder, scenario, ask: arguments of `make`.
    """
    drawn = [name for name in names if name not in STUDIES]
    if drawn:
        run = partial(_draw_figures, drawn, scenario, ask.seed, folder)
        yield Job(figures.SCENARIO, run)
    for name in names:
        if name in STUDIES:
            _require_changeable(name, ask)
            runs = RUNS[name](ask) if name in RUNS else {}
            named = {f"{name}{BETWEEN}{key}": run for key, run in runs.items()}
            yield from (Job(key, partial(_run, run)) for key, run in named.items())
            yield Job(name, partial(_make_study, name, folder, ask), tuple(named))


def _draw_figures(
    names: Sequence[str],
    scenario: osc.Scenario,
    seed: int,
    folder: Path,
    tell: Tell,
    needed: Mapping[str, Any],
) -> dict[str, Study]:
    """Run the scenario if a figure needs it, report the run, and write the figures.

    Args:
        names: names in `FIGURES`.
        scenario, seed: scenario and seed of the run.
        folder: for everything that is written.
        tell, needed: arguments of the work of a `Job`.

    Returns:
        By name; the run, by the name of its scenario, is a study without figures.
    """
    made = {}
    recording = None
    if figures.NEED_RUN.intersection(names):
        recording = record(scenario, seed, folder)
        table = verdict_table(write_report(recording, scenario, folder / scenario.name))
        made[scenario.name] = Study({}, table)
    for name in names:
        answers = {}
        if recording is not None:
            answers = ANSWERS[name](Evidence(osc.build_rig(scenario), recording))
        picture = {name: figures.reproduce(name, scenario, recording)}
        made[name] = write(name, folder, Study(picture, answers=answers))
    return made


def _run(run: Callable[[], Any], tell: Tell, needed: Mapping[str, Any]) -> Any:
    """One run of a study, as a job."""
    tell("")
    return run()


def _make_study(
    name: str, folder: Path, ask: Ask, tell: Tell, needed: Mapping[str, Any]
) -> dict[str, Study]:
    """A study, as a job: by its name.

    Args:
        name, folder, ask: arguments of `write_study`.
        tell: function that shows a step, see `Job`.
        needed: results of its runs, by the names of their jobs.
    """
    tell("")
    runs = {key.removeprefix(f"{name}{BETWEEN}"): result for key, result in needed.items()}
    return {name: write_study(name, folder, replace(ask, tell=tell, made=runs))}


def write_study(name: str, folder: Path, ask: Ask) -> Study:
    """Run a study; write its figures (PNG, SVG, PDF) and NAME.json into a folder.

    Args:
        name: one of `STUDIES`.
        folder: made if need be.
        ask: seed, duration and more.

    Raises:
        InvalidInputError: changes of a scenario for a study that has none.
    """
    _require_changeable(name, ask)
    folder.mkdir(parents=True, exist_ok=True)
    return write(name, folder, STUDIES[name](replace(ask, folder=folder)))


def _require_changeable(name: str, ask: Ask) -> None:
    """Refuse changes of a scenario for a study that has none."""
    if ask.changes and name not in WITH_SCENARIO:
        raise osc.InvalidInputError(f"{name} is not made from a scenario; leave --set out")


def write(name: str, folder: Path, study: Study) -> Study:
    """Write figures, pages and numbers; returns the study with the files in their place."""
    drawn = (save(figure, folder / title, PRINT) for title, figure in study.figures.items())
    files = [path for paths in drawn for path in paths]
    files += [page(folder / f"{title}.html") for title, page in study.pages.items()]
    if study.data is not None:
        files.append(folder / f"{name}.json")
        write_json(study.data, files[-1])
    return replace(study, figures={}, pages={}, files=files)
