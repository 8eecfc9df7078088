"""Where to begin: five commands, and the short programs of the docs as files."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from osc_contact.console import exit_codes, say
from osc_contact.errors import InvalidInputError
from osc_contact.files import whole_file

__all__ = ["FIRST_STEPS", "examples"]

FIRST_STEPS = """\
Contact forces and free motion of arms, controlled at once. Five things to do first:

  osc-contact list                        the tasks that come with it
  osc-contact inspect two_contact_rod     what its contacts transmit and permit, in words
  osc-contact run two_contact_rod         run it: verdict, figures, a moving scene in out/
  osc-contact new --robot panda           a first task for a robot: a YAML file that runs
  osc-contact examples                    short Python programs to change

All commands: osc-contact --help"""
PAGES = (
    "README.md",
    "press_and_slide.md",
    "two_arms.md",
    "contact_phases.md",
    "friction.md",
    "own_loop.md",
    "mujoco_arm.md",
    "extend.md",
)
PROGRAM = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#{1,2} (.*)$", re.MULTILINE)


def examples(
    folder: Annotated[Path, typer.Argument(help="where to write them")] = Path("examples"),
) -> None:
    """Write the short programs of the docs as files, each of which runs by itself."""
    with exit_codes():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InvalidInputError(f"{folder} is there already: name an empty or a new folder")
        folder.mkdir(parents=True, exist_ok=True)
        for number, (name, page, code) in enumerate(programs(), start=1):
            path = folder / f"{number:02d}_{name}.py"
            with whole_file(path) as unfinished:
                unfinished.write_text(f"# From {page}\n\n{code}", encoding="utf-8")
            say(f"written: {path}")
        say(f"run one: python {path}")


def programs() -> Iterator[tuple[str, str, str]]:
    """Name, page and text of every program of the pages for users."""
    for page in PAGES:
        text = _page(page).read_text(encoding="utf-8")
        for found in PROGRAM.finditer(text):
            heading = HEADING.findall(text[: found.start()])[-1]
            yield _slug(heading), page, found[1]


def _page(name: str) -> Path:
    """A page: inside the installed package, or beside it in a checkout."""
    here = Path(__file__).resolve().parent
    places = (here / "docs" / name, here.parent / "docs" / name, here.parent / name)
    return next((place for place in places if place.is_file()), places[0])


def _slug(heading: str) -> str:
    """A heading as the name of a file: its first words in plain letters."""
    plain = unicodedata.normalize("NFKD", heading.partition(":")[0]).encode("ascii", "ignore")
    return "_".join(re.findall(r"[a-z0-9]+", plain.decode().lower()))
