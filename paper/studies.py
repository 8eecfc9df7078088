"""Experiments beside the main job: each gives figures, a table and its numbers by one name."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from osc_contact.errors import InvalidInputError
from osc_contact.runs.report import write_json
from osc_contact.visual.plots import PRINT, save
from paper import (
    baselines,
    cone_in_groove,
    contact_phases,
    fig3,
    kinematic_stability,
    moving_face,
    robustness,
    workcell,
)
from paper.study import Ask, Study

STUDIES: dict[str, Callable[[Ask], Study]] = {
    "fig2": cone_in_groove.study,
    "fig3": fig3.study,
    "kinematic_stability": kinematic_stability.study,
    "moving_face": moving_face.study,
    "baselines": baselines.study,
    "robustness": robustness.study,
    "workcell": workcell.study,
    "fig7": contact_phases.fig7_study,
    "approach_and_slide": contact_phases.landing_study,
}
SLOW = {"baselines", "robustness", "workcell", "fig7", "approach_and_slide"}
"""several minutes: not in `reproduce all`"""
WITH_SCENARIO = SLOW | {"fig3"}
"""whose scenario can be changed"""
WITH_SAMPLES = {"robustness"}
"""whose runs are samples"""


def write_study(name: str, folder: Path, ask: Ask) -> tuple[Study, list[Path]]:
    """Run a study; write its figures (PNG, SVG, PDF) and NAME.json into a folder.

    Args:
        name: one of `STUDIES`.
        folder: made if need be.
        ask: seed, duration and more.

    Raises:
        InvalidInputError: changes of a scenario for a study that has none.
    """
    if ask.changes and name not in WITH_SCENARIO:
        raise InvalidInputError(f"{name} is not made from a scenario; leave --set out")
    folder.mkdir(parents=True, exist_ok=True)
    study = STUDIES[name](replace(ask, folder=folder))
    written = [
        path
        for title, figure in study.figures.items()
        for path in save(figure, folder / title, PRINT)
    ]
    written += [write(folder / f"{title}.html") for title, write in study.pages.items()]
    written.append(folder / f"{name}.json")
    write_json(study.data, written[-1])
    return study, written
