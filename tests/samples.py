"""The checkout, rows of tests, what modules share, what every `make test` runs of a long list."""

import fcntl
import os
from functools import partial
from pathlib import Path
from shutil import rmtree

from pytest import fixture, mark, param

ROOT = Path(__file__).resolve().parent.parent  #: of the checkout
module_fixture = fixture(scope="module")
aligned = partial(zip, strict=True)  #: of equally many


def made_once(tmp_path_factory, name, make):
    """A folder that one worker of pytest fills, by `make(folder)`; the others wait for it."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent
    folder = root / name
    made = root / f"{name}.made"
    with open(root / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            rmtree(folder, ignore_errors=True)  # of one that failed
            folder.mkdir()
            make(folder)
            made.touch()
    return folder


def parametrize(names, rows, **how):
    """`mark.parametrize`, which also takes a table from the first of two names to the second."""
    table = isinstance(rows, dict) and "," in names
    return mark.parametrize(names, rows.items() if table else rows, **how)


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def first(items, count=2):
    """Parameters, one for each item: those behind the first `count` are slow."""
    return [item if i < count else param(item, marks=mark.slow) for i, item in enumerate(items)]


def chosen(items, *names):
    """Likewise with all that are not named: `make test-all` runs them, too."""
    return first([*names, *(item for item in items if item not in names)], len(names))
