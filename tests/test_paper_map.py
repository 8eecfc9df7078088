"""docs/paper_map.md against the code: every row complete, every name and test really there."""

import ast
import re
from functools import cache
from pathlib import Path

import yaml
from pytest import mark

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "paper_map.md"
REFERENCE = re.compile(r"`([^`\s]+)`")
CELL = re.compile(r"`[^`\s]+`(, `[^`\s]+`)*")
RIG = (
    "two SCARA arms",
    "gripper hinges",
    "rod,",
    "vision",
    "joint torque sensors",
    "joint-level controller",
    "wrist force sensors",
    "two end-point contacts",
    "N continuously updated",
    "Λ₀ = Λ₀l + Λ₀r + Λ₀o",
    "force filter",
    "generalised inverse of N",
    "force controller",
    "feed-forward",
    "power test",
    "contact made, lost and regained",
)


def rows_of(text):
    """(what, where, test) of every table row that speaks of the paper."""
    rows = []
    for line in text.splitlines():
        if not line.startswith("|"):
            continue
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] == "what" or set("".join(cells)) <= set("-: "):
            continue
        assert len(cells) == 3, f"not three cells: {line}"
        rows.append(cells)
    return rows


def names_in(tree):
    """Functions, classes and module variables, and "Class.name" of methods and attributes."""
    found = set()
    for node in tree.body:
        found.update(_defined(node))
        if isinstance(node, ast.ClassDef):
            own = {name for item in node.body for name in _defined(item)}
            own.update(re.findall(r"\bself\.(\w+)(?:: [^=\n]+)? = ", ast.unparse(node)))
            found.update(f"{node.name}.{name}" for name in own)
    return found


def _defined(node):
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = getattr(node, "targets", [getattr(node, "target", None)])
    return [target.id for target in targets if isinstance(target, ast.Name)]


def yaml_names(data, prefix=""):
    """Dotted keys; list items go by their `name`."""
    pairs = data.items() if isinstance(data, dict) else []
    if isinstance(data, list):
        pairs = [(item["name"], item) for item in data if isinstance(item, dict) and "name" in item]
    found = set()
    for key, value in pairs:
        found |= {f"{prefix}{key}"} | yaml_names(value, f"{prefix}{key}.")
    return found


@cache
def names_of(path):
    text = path.read_text()
    if path.suffix == ".py":
        return names_in(ast.parse(text))
    if path.suffix == ".urdf":
        return set(re.findall(r'<(?:link|joint) name="(.*?)"', text))
    return yaml_names(yaml.safe_load(text))


def complaint(reference, *, test):
    """What is wrong with a reference path::name; None: nothing."""
    file, _, name = reference.partition("::")
    path = ROOT / file
    if not path.is_file():
        return f"no file {file}"
    if test and not (file.startswith("tests/test_") and name.startswith("test_")):
        return f"{reference} is no test"
    if not test and file.startswith("tests/"):
        return f"{reference} lives in the tests"
    if not name or name not in names_of(path):
        return f"{file} defines no {name!r}"
    return None


def check(row):
    """Every complaint about one row."""
    what, where, test = row
    if where == test == "planned":
        return []
    problems = []
    for cell, is_test in ((where, False), (test, True)):
        if not CELL.fullmatch(cell):
            problems.append(f"{what}: neither references nor planned in both columns: {cell!r}")
            continue
        found = (complaint(reference, test=is_test) for reference in REFERENCE.findall(cell))
        problems += [f"{what}: {text}" for text in found if text]
    return problems


ROWS = rows_of(PAGE.read_text())


@mark.parametrize("row", ROWS, ids=[row[0].split(":")[0] for row in ROWS])
def test_row_is_complete_or_planned(row):
    assert not check(row), "\n".join(check(row))


def test_every_equation_and_figure_has_one_row():
    starts = [what.partition(":")[0] for what, _, _ in ROWS]
    wanted = [f"eq. {n}" for n in range(1, 26)] + [f"fig. {n}" for n in range(1, 9)]
    assert [start for start in starts if start != "rig"] == wanted


def test_every_part_of_the_rig_has_one_row():
    parts = [what for what, _, _ in ROWS if what.startswith("rig: ")]
    for part, wanted in zip(parts, RIG, strict=True):
        assert part.startswith(f"rig: {wanted}")


def test_the_erratum_is_stated_once_with_its_correction():
    text = PAGE.read_text()
    assert text.count("**Erratum.**") == 1
    assert "Ω̄_f(A₁) Ω_f(A₂) = 0" in text and "Ω̄_m(B₁) Ω_m(B₂) = 0" in text


GOOD = "`osc_contact/projections.py::Omega_f`"
PROOF = "`tests/test_projections.py::test_every_projection_is_the_decomposition_it_stands_for`"


@mark.parametrize(
    "where, test, words",
    [
        (GOOD, PROOF, None),
        ("planned", "planned", None),
        ("`osc_contact/control/custom_laws.py::Laws.force`", PROOF, None),
        ("`paper/diagrams.py::BLOCKS`", PROOF, None),
        ("planned", PROOF, "neither"),
        (GOOD + " and more", PROOF, "neither"),
        ("`osc_contact/nowhere.py::Omega_f`", PROOF, "no file"),
        ("`osc_contact/projections.py::Omega_g`", PROOF, "defines no"),
        ("`osc_contact/projections.py::np`", PROOF, "defines no"),
        ("`osc_contact/contacts/contact.py::Contact.nowhere`", PROOF, "defines no"),
        ("`urdf/scara_left.urdf::elbow`", PROOF, "defines no"),
        ("`osc_contact/scenarios/files/two_contact_rod.yaml::contacts.middle`", PROOF, "defines"),
        (GOOD, "`tests/test_projections.py::test_nothing`", "defines no"),
        (GOOD, "`tests/test_projections.py::case`", "is no test"),
        (GOOD, GOOD, "is no test"),
        (PROOF, PROOF, "lives in the tests"),
    ],
)
def test_the_checker_itself(where, test, words):
    problems = check(("eq. 0: an example", where, test))
    assert not problems if words is None else any(words in text for text in problems)
