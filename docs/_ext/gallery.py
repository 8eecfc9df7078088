"""`make gallery`: cards of packaged scenarios, tasks and studies, and the README's moving picture.

Runs each scenario and task and films it, makes each study's figure, and writes docs/gallery.md with
the verdicts of these runs. `make gallery NAMES="ur5_wipe fig2"` makes the cards of these alone.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

import osc_contact as osc
from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.rig.rig import build_rig
from osc_contact.lab.tasks.packaged import TASKS, run_task, task_content, task_verdict
from osc_contact.lab.visual.browser import write_gif
from paper.report import STUDIES
from paper.statements import PAPER, judge
from paper.study import Ask, Study

DOCS = Path(__file__).resolve().parents[1]
PICTURES = DOCS / "images" / "gallery"
README_MOST, CARD_MOST, FIGURE_MOST = 3_000_000, 1_500_000, 300_000  # bytes
HEAD = """# Gallery

Every packaged scenario, task and study, with its command and the verdict of the run shown. Arrows
are contact forces (10 mm per newton; wide and pale: commanded, black: measured), long lines are
lines of force, thin curves are trails. `make gallery` makes this page and its pictures anew;
`osc-contact view SCENARIO --gif FILE` makes another; on the
[web page](viewing.md#a-page-that-runs-the-task) of `osc-contact page SCENARIO --out FOLDER` you set
forces and walls yourself.

Two runs are `POOR` on purpose: `limited_rod` is commanded beyond the limits of its motors, and
`collisions` is pushed off its faces again and again.
"""


class Shot(NamedTuple):
    """How a scenario is filmed: how long it runs (s, None: its own time), from where."""

    duration: float | None = None
    camera: str = "whole"


SHOTS = {
    "approach_and_slide": Shot(camera="contacts"),
    "collisions": Shot(4.0, "contacts"),
    "workcell": Shot(10.0),
}


#: Studies that are no scenario of their own: what they show.
STUDIED = {
    "fig2": "A Panda turns and slides a cone in a groove by four contacts (fig. 2); no constraint "
    "frame describes them.",
    "fig3": "The workcell and its task, rendered from a run (fig. 3).",
    "kinematic_stability": "Postures that classic hybrid control leaves by itself, and "
    "this law keeps.",
}


def verdict_words(recording: osc.Recording) -> str:
    """The verdict of a run in one line."""
    verdict: Mapping[str, Any] = osc.metrics(recording)
    words = [f"**{verdict['task']['word']}**"]
    for name, force in verdict["force"].items():
        closed = verdict["contact_fraction"][name.partition(".")[0]]
        if closed > 0.99:
            note = f"error {force['rms_error_rel']:.2%} rms"
        else:
            note = f"closed {closed:.0%} of the time"
        words.append(f"`{name}` {force['mean_command_N']:.1f} N, {note}")
    motion = verdict["motion"]
    words.append(f"free motion {1e3 * motion['rms_error_m']:.2g} mm rms")
    return "; ".join(words)


def film(name: str) -> str:
    """Run a scenario, write its moving picture; returns its card."""
    scenario, shot = osc.load_scenario(name), SHOTS.get(name, Shot())
    print(name, flush=True)
    recording = osc.run(scenario, duration=shot.duration)
    t = recording["t"]
    begin, end = float(t[0]), float(t[-1])
    begin += 0.3 * (name != "approach_and_slide")
    page = write_scene_of(recording, build_rig(scenario), Path("out/gallery") / f"{name}.html")
    card = write_gif(page, PICTURES / f"{name}.gif", begin, end, (420, 370), shot.camera, 32)
    require_small(card, CARD_MOST)
    if name == "two_contact_rod":
        picture = DOCS / "images" / "two_contact_rod.gif"
        require_small(write_gif(page, picture, begin, end, camera="contacts"), README_MOST)
    seconds = f" --duration {shot.duration:g}" if shot.duration else ""
    first, _, rest = scenario.description.partition(" ")
    name_of, comma = first.rstrip(","), "," * first.endswith(",")
    sentence = f"`{name_of}`{comma} {rest}" if "_" in first else f"{first.capitalize()} {rest}"
    return (
        f"## {name}\n\n![{name.replace('_', ' ')}, moving](images/gallery/{name}.gif)\n\n"
        f"{sentence}.\n\n    osc-contact run {name}{seconds}\n\n{verdict_words(recording)}\n"
    )


def film_task(name: str) -> str:
    """Run a packaged task, write its moving picture; returns its card."""
    print(name, flush=True)
    task = TASKS[name]
    recording = run_task(task)
    t = recording["t"]
    file = Path("out/gallery") / f"{name}.html"
    page = write_scene_of(recording, task_content(recording), file)
    picture = PICTURES / f"{name}.gif"
    begin, end = float(t[0]), float(t[-1])
    write_gif(page, picture, begin, end, (420, 370), "contacts", 48)
    require_small(picture, CARD_MOST)
    verdict = task_verdict(recording)
    inserted = verdict["inserted"]
    words = (
        f"**{verdict['task']['word']}**; seed {verdict['seed']}: {1e3 * inserted['depth']:.1f} mm "
        f"deep after {inserted['time']:.1f} s, {inserted['tries']} tries; largest sum of the "
        f"contact forces {inserted['largest_sum']:.0f} N"
    )
    sentence = task.description[0].upper() + task.description[1:]
    return (
        f"## {name}\n\n![{name.replace('_', ' ')}, moving](images/gallery/{name}.gif)\n\n"
        f"{sentence} ([insert a peg](insert_a_peg.md)).\n\n"
        f"    osc-contact run {name}\n\n{words}\n"
    )


def draw(name: str) -> str:
    """Make a study, write its figure; returns its card."""
    print(name, flush=True)
    study, picture = STUDIES[name](Ask()), PICTURES / f"{name}.png"
    study.figures[name].savefig(picture, dpi=90)
    Image.open(picture).quantize(256).save(picture, optimize=True)
    require_small(picture, FIGURE_MOST)
    return (
        f"## {name}\n\n![{name.replace('_', ' ')}](images/gallery/{name}.png)\n\n"
        f"{STUDIED[name]}\n\n    osc-contact reproduce {name}\n\n{study_words(name, study)}\n"
    )


def study_words(name: str, study: Study) -> str:
    """The verdict of a study: what it answers to the paper, or its own numbers."""
    if study.answers:
        (figure,) = (figure for figure in PAPER if figure.name == name)
        return f"**{judge(figure, study.answers).upper()}**; " + " ".join(
            answer.found for answer in study.answers.values()
        )
    found = study.data
    stable = "UNSTABLE" if found["ours_unstable"] else "OK"
    counts = "classic leaves {classic_unstable} of {postures} postures, ours {ours_unstable}"
    return f"**{stable}**; {counts.format(**found)}"


def require_small(picture: Path, most: int) -> None:
    """Refuse a picture that is too large for a page."""
    size = picture.stat().st_size
    if size > most:
        sys.exit(f"{picture} has {size} bytes, more than {most}: fewer frames or a smaller size")


def main() -> None:
    """Make all cards, or those named."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    Path("out/gallery").mkdir(parents=True, exist_ok=True)
    names = sys.argv[1:] or [*osc.list_scenarios(), *TASKS, *STUDIED]
    makers = {**dict.fromkeys(TASKS, film_task), **dict.fromkeys(STUDIED, draw)}
    cards = [makers.get(name, film)(name) for name in names]
    if not sys.argv[1:]:
        text = "\n".join([HEAD, *cards])
        (DOCS / "gallery.md").write_text(text, encoding="utf-8")
    else:
        print("\n".join(cards))


if __name__ == "__main__":
    main()
