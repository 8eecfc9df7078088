"""Names in backticks, in docstrings and comments: each is a name of this project.

Names of other software stand in quotation marks.
"""

import builtins
import importlib
import io
import pkgutil
import re
import tokenize
from pathlib import Path

from pytest import fixture
from samples import ROOT, parametrize

import osc_contact

PACKAGES = ("osc_contact", "paper", "benchmarks")
FILES = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]
#: Other software whose names stand in backticks as `package.name`.
OTHERS = {"llvmlite", "matplotlib", "mujoco", "np", "numba", "numpy", "pin", "scipy", "meshcat"}
IN_BACKTICKS = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)`(?!`)")
WORD = re.compile(r"\w+")
#: First words of keys of scenarios, `control.safety.wrist_error`.
KEYS = {"arms", "contacts", "control", "force", "gains", "model_error", "motion", "object"}
KEYS |= {"plan", "plant", "sensors", "tare"}


def code_and_text(source):
    """The words of a file's code, and its strings and comments, each with its line."""
    words = set()
    texts = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in (tokenize.STRING, tokenize.COMMENT):
            texts.append((token.start[0], token.string))
            words |= set(WORD.findall(IN_BACKTICKS.sub("", token.string)))
        elif token.type == tokenize.NAME:
            words.add(token.string)
    return (words, texts)


@fixture(scope="module")
def words():
    """Words that stand somewhere without backticks: identifiers, keys, columns."""
    found = {word for path in FILES for word in code_and_text(path.read_text())[0]}
    for path in (ROOT / "osc_contact").rglob("*.yaml"):
        found |= set(WORD.findall(path.read_text()))
    return found | set(dir(builtins)) | {path.stem for path in FILES}


def modules():
    """Module by its path below the package, and by the last part of the path."""
    found = {}
    for one in pkgutil.walk_packages(osc_contact.__path__, "osc_contact."):
        path = one.name.removeprefix("osc_contact.")
        found.setdefault(path, []).append(one.name)
        found.setdefault(path.rpartition(".")[2], []).append(one.name)
    return found


MODULES = modules()


def stale(name, words):
    """Whether nothing has this name: of `module.name`, the module has to have it."""
    first, *rest = name.split(".")
    if first in OTHERS:
        return False
    places = [n for n in range(len(rest) + 1, 0, -1) if ".".join([first, *rest][:n]) in MODULES]
    for n in places:
        left = [first, *rest][n:]
        for module in MODULES[".".join([first, *rest][:n])]:
            text = Path(importlib.util.find_spec(module).origin).read_text()
            if not left or left[0] in WORD.findall(IN_BACKTICKS.sub("", text)):
                return False
    if places and rest and first not in KEYS:
        return True
    return not {first, *rest} <= words


@parametrize("file", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_names_in_backticks_exist(file, words):
    _, texts = code_and_text(file.read_text())
    names = [(line, name) for line, text in texts for name in IN_BACKTICKS.findall(text)]
    assert [one for one in names if stale(one[1], words)] == []


@parametrize(
    "name, is_stale",
    [
        ("law.sensors", False),
        ("law.watch", True),
        ("law.rows.rows", False),
        ("law.tick.columns_that_nothing_has", True),
        ("control.safety.wrist_error", False),
        ("numpy.cross", False),
        ("Controller.tick", False),
        ("Controller.tock_that_nothing_has", True),
    ],
)
def test_a_name_that_nothing_has_is_found(name, is_stale, words):
    assert stale(name, words - {"tock_that_nothing_has"}) == is_stale
