"""Helpers of all test modules: the checkout's path, tables of parameters, shared folders."""

import fcntl
import os
from functools import partial
from pathlib import Path
from shutil import rmtree

from pytest import fixture, mark, param

ROOT = Path(__file__).resolve().parent.parent  #: folder of the checkout
module_fixture = fixture(scope="module")
aligned = partial(zip, strict=True)  #: zip of sequences of equal length


def made_once(tmp_path_factory, name, make):
    """Folder that one worker of pytest fills by `make(folder)`, while the others wait.

    Args:
        tmp_path_factory: fixture of pytest.
        name: name of the folder.
        make: function of its path.
    """
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent
    folder = root / name
    made = root / f"{name}.made"
    with open(root / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            rmtree(folder, ignore_errors=True)  # from a worker that failed
            folder.mkdir()
            make(folder)
            made.touch()
    return folder


def parametrize(names, rows, **how):
    """Parametrize a test like `mark.parametrize`; rows of two names may be a dictionary.

    Args:
        names: names of the parameters.
        rows: list of rows, or dictionary from the first parameter to the second.
        **how: further arguments of `mark.parametrize`.
    """
    table = isinstance(rows, dict) and "," in names
    return mark.parametrize(names, rows.items() if table else rows, **how)


def names_in(folder):
    """Set of the names of files and folders in a folder."""
    return {path.name for path in folder.iterdir()}


def first(items, count=2):
    """List of parameters, of which those after the first `count` are marked as slow."""
    return [item if i < count else param(item, marks=mark.slow) for i, item in enumerate(items)]


def chosen(items, *names):
    """List of parameters, of which those that are not named are marked as slow.

    `make test-all` runs slow tests, too.
    """
    return first([*names, *(item for item in items if item not in names)], len(names))
