"""`osc-contact reproduce`: makes figures and studies one after the other, by their names."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from rich.table import Table

from osc_contact.recorder import Recording
from osc_contact.runs.metrics import metrics
from osc_contact.runs.report import write_report
from osc_contact.runs.rig import build_rig
from osc_contact.runs.tables import verdict_table
from osc_contact.scenarios import Scenario
from paper import figures
from paper.answers import ANSWERS, Evidence
from paper.statements import PAPER, Answer, Verdict, judge
from paper.studies import SLOW, STUDIES, Ask, write_study

__all__ = ["Made", "Reproduction", "make", "names_of", "typed"]

BRIEF_S = 10.0  #: of each run of a slow study that is one of several


class Waits(Protocol):
    """Something that tells what is going on: `Console.status`."""

    def __call__(self, status: str) -> AbstractContextManager[Any]:
        """Enter it while it goes on; has `update(words)`."""


@dataclass(frozen=True)
class Made:
    """What came of one name.

    Attributes:
        files: figures in every format, and JSON.
        answers: to what the paper states, by key; empty for studies beside the paper.
        table: of a study. data: its numbers. options: that its command needs besides those typed.
    """

    files: Sequence[Path]
    answers: Mapping[str, Answer] = field(default_factory=dict)
    table: Table | None = None
    data: Mapping[str, Any] | None = None
    options: str = ""

    @property
    def drawn(self) -> bool:
        """Whether there is a picture among the files; fig. 3 needs a browser for its own."""
        return any(path.suffix in (".png", ".svg") for path in self.files)


@dataclass(frozen=True)
class Reproduction:
    """Everything that one command made.

    Attributes:
        made: by name. options: of the command, as typed. scene: the run's page.
        scenario: behind the figures that are not studies, recording: of its run, if there was one.
    """

    made: Mapping[str, Made]
    scenario: Scenario
    recording: Recording | None
    scene: Path | None
    options: str = ""

    def verdicts(self) -> dict[str, Verdict]:
        """By the names of the paper's eight figures."""
        nothing = Made(())
        return {
            f.name: judge(f, f.name in self.made, one.answers, one.drawn)
            for f in PAPER
            for one in (self.made.get(f.name, nothing),)
        }

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: files, the run's metrics, the studies' numbers, the paper's statements."""
        paper = {}
        for figure in PAPER:
            if figure.name in self.made:
                answers = self.made[figure.name].answers
                paper[figure.name] = {
                    "verdict": self.verdicts()[figure.name].value,
                    "answers": {
                        k: {"found": a.found, "holds": a.holds} for k, a in answers.items()
                    },
                }
        return {
            "figures": [str(path) for one in self.made.values() for path in one.files],
            "metrics": {} if self.recording is None else metrics(self.recording),
            "studies": {k: one.data for k, one in self.made.items() if one.data is not None},
            "paper": paper,
        }


def names_of(figure: str) -> tuple[str, ...]:
    """The names behind one word of the command line.

    "all" are the paper's figures and the studies that take no minutes.

    Raises:
        InvalidInputError: unknown, with the names there are.
    """
    names: tuple[str, ...] = (figure,)
    if figure == "all":
        ours, paper = (*figures.FIGURES, *STUDIES), {one.name for one in PAPER}
        names = tuple(name for name in ours if name in paper or name not in SLOW)
    figures.require_known(names)
    return names


def typed(plant: str | None, duration: float | None, seed: int, changes: Sequence[str]) -> str:
    """The options of a command as they are typed.

    Args:
        plant: of `--plant`, None if it was not given.
        duration: of `--duration` (s), None if it was not given.
        seed: of `--seed`; 0 is left out.
        changes: of `--set`.
    """
    words = [] if plant is None else ["--plant", plant]
    words += [] if duration is None else ["--duration", f"{duration:g}"]
    words += ["--seed", str(seed)] if seed else []
    return shlex.join([*words, *(word for change in changes for word in ("--set", change))])


def make(
    names: Sequence[str],
    folder: Path,
    scenario: Scenario,
    ask: Ask,
    record: Callable[[], Recording],
    show: Callable[[Table], None],
    waiting: Waits,
    options: str = "",
) -> Reproduction:
    """Make figures and studies.

    Args:
        names: of `FIGURES` and `STUDIES`.
        folder: for everything that is written.
        scenario: behind the figures that are not studies. ask: of the studies.
        record: runs the scenario; called if a figure needs it.
        show: called with each table. waiting: entered around each study.
        options: of the command, as typed; shown in the report.
    """
    drawn = [name for name in names if name not in STUDIES]
    recording, scene = None, None
    if any(name in figures.needs_run for name in drawn):
        recording = record()
        of_run = folder / scenario.name
        show(verdict_table(write_report(recording, scenario, of_run)))
        scene = of_run / "scene.html"
    made = {}
    for name in drawn:
        made[name] = Made(figures.write_figure(name, folder, scenario, recording))
    if recording is not None:
        evidence = Evidence(build_rig(scenario), recording)
        for name in drawn:
            made[name] = replace(made[name], answers=ANSWERS[name](evidence))
    for name in names:
        if name in STUDIES:
            brief = name in SLOW and len(names) > 1 and ask.duration is None
            duration = BRIEF_S if brief else ask.duration
            with waiting(name) as status:
                asked = replace(ask, duration=duration, tell=status.update)
                study, files = write_study(name, folder, asked)
            show(study.table)
            more = typed(None, duration, 0, ()) if brief else ""
            made[name] = Made(files, study.answers, study.table, study.data, more)
    return Reproduction(made, scenario, recording, scene, options)
