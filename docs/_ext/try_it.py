"""Pages that run a task in the browser, beside docs/try_it.md: one folder for each of `TASKS`."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from typing import Any

import osc_contact as osc
from osc_contact.lab.reports.web_page import write_web_page
from paper.selection_laws import selection_of

#: Whether a selection law can run beside: where its best frame fits the contact it is the same law.
TASKS = {"two_contact_rod": True, "panda_edge": False, "ur5_wipe": False, "three_arm_plate": False}


def write_page(name: str, folder: Path) -> None:
    """Write the page of a task into a folder.

    The frame of its selection law is found without random starts: of two_contact_rod's costs these
    lower none in the first twelve digits, and they take ten seconds.
    """
    select = partial(selection_of, restarts=0) if TASKS[name] else None
    write_web_page(osc.load_scenario(name), folder, select=select)


def write_pages(folder: Path) -> None:
    """Write the page of each task into a folder of its name."""
    for name in TASKS:
        write_page(name, folder / name)


def bring(app: Any, error: Exception | None) -> None:
    """Put the pages into the site: those of the folder `try_pages`, or new ones."""
    if error is not None or app.builder.name != "html":
        return
    target = Path(app.outdir) / "docs" / "try"
    if app.config.try_pages:
        shutil.copytree(app.config.try_pages, target, dirs_exist_ok=True)
    else:
        write_pages(target)


def setup(app: Any) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_config_value("try_pages", "", "")
    app.connect("build-finished", bring)
    return {"parallel_read_safe": True}
