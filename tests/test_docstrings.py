"""Docstrings: every public function that takes three things or more says what each of them is."""

import ast
import re
from pathlib import Path
from textwrap import indent

PACKAGE = Path(__file__).parents[1] / "osc_contact"
FILES = sorted(PACKAGE.rglob("*.py"))


def public_functions(node):
    """Functions of a module, and methods of its classes, whose names have no underscore."""
    for child in getattr(node, "body", []):
        if isinstance(child, ast.ClassDef | ast.FunctionDef) and not child.name.startswith("_"):
            if isinstance(child, ast.FunctionDef):
                yield child
            else:
                yield from public_functions(child)


def arguments(function):
    every = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
    return [one for one in every if one.arg not in ("self", "cls")]


def is_command(function):
    """Of the command line: its options have their help where they stand."""
    return "Option" in ast.unparse(function.args)


def records():
    """Arguments of the law that are records: one table explains them all."""
    text = (PACKAGE / "law" / "records.py").read_text()
    rows = re.findall(r"^\| (`.*`) \|", ast.get_docstring(ast.parse(text)) or "", re.M)
    return set(re.findall(r"`(\w+)`", " ".join(rows)))


def unexplained(text, known=()):
    """Public functions of a module with an argument that neither docstring nor table explains."""
    found = []
    for function in public_functions(ast.parse(text)):
        names = [one.arg for one in arguments(function)]
        if len(names) < 3 or is_command(function):
            continue
        _, _, described = (ast.get_docstring(function) or "").partition("Args:")
        left_out = [name for name in names if name not in described and name not in known]
        if left_out:
            found.append(f"{function.name}: {', '.join(left_out)}")
    return found


def test_arguments_are_explained():
    of_law = records()
    assert of_law == {"t", "arm", "own"}
    for path in FILES:
        known = of_law if path.parent.name == "law" else ()
        assert unexplained(path.read_text(), known) == [], path
    assert len(FILES) > 100


def test_what_is_left_out_is_found():
    text = 'def carry(x, start, end):\n    """x.\n\n    Args:\n        x, start: (3,).\n    """'
    assert unexplained(text) == ["carry: end"]
    assert unexplained(text.replace("x, start", "x, start, end")) == []
    assert unexplained(text.replace("carry", "_carry")) == []
    assert unexplained(f"class Body:\n{indent(text, '    ')}") == ["carry: end"]


def test_options_of_commands_have_their_help():
    names = ("console.py", "cli.py", "cli_robots.py", "cli_sweeps.py")
    trees = [ast.parse((PACKAGE / name).read_text()) for name in names]
    aliases = {
        target.id: ast.unparse(one.value)
        for tree in trees
        for one in tree.body
        if isinstance(one, ast.Assign)
        for target in one.targets
        if isinstance(target, ast.Name)
    }
    for name, tree in zip(names, trees, strict=True):
        for function in filter(is_command, public_functions(tree)):
            for one in arguments(function):
                kind = ast.unparse(one.annotation)
                described = "help=" in aliases.get(kind, kind) or kind == "typer.Context"
                assert described, f"{name} {function.name}: {one.arg}"
