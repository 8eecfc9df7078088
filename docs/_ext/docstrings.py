"""Docstrings as people write them: what reStructuredText would take for markup is left alone."""

from __future__ import annotations

import re
from typing import Any

SECTION = re.compile(r"(Args|Attributes|Raises|Returns):$")
NAMES = re.compile(r"^ {4}(\w+(?:, \w+)+): ")
BAR = re.compile(r"(?<!\\)\|")
ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")
ARRAY = re.compile(r"[~\w.]*ndarray\[tuple\[[~\w.]*Any, \.\.\.\], [~\w.]*dtype\[[~\w.]+\]\]")
ARRAY_LIKE = re.compile(  # what NumPy makes of ArrayLike
    r"[~\w.]*_Buffer \| [^,]*?_NestedSequence\[complex \| bytes \| str\]"
)
FUNCTION = re.compile(r"<function (\w+)>")
MADE = re.compile(r"(Create a new model by parsing|Create new instance of|Alias for field number)")


def setup(app: Any) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", tidy, priority=100)  # before napoleon
    app.connect("autodoc-process-docstring", no_type, priority=900)  # after it
    app.connect("autodoc-process-signature", short_aliases)
    return {"parallel_read_safe": True}


def tidy(_app: Any, what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Show indented equations line by line; |x| is a length; "q, v: …" are two names."""
    out: list[str] = []
    section = formula = False
    for line in lines:
        indented = line.startswith("    ")
        if line and not indented:
            section, formula = SECTION.match(line) is not None, False
        if indented and not section and not formula and out[-1:] == [""]:
            out += ["::", ""]
            formula = True
        if section:
            line = NAMES.sub(lambda found: found[0].replace(", ", ","), line)
        out.append(line if formula else BAR.sub(r"\\|", line))
    made = [k for k, line in enumerate(out) if MADE.match(line)]  # what pydantic and tuples add
    lines[:] = out[: made[0]] if made else out


def no_type(app: Any, what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Napoleon reads "(6,) twist: a = S η̇" of a field as a type and a text; it is one text."""
    typed = len(lines) == 3 and lines[2].startswith(":type: ")
    if typed and what in ("attribute", "data", "property"):
        lines[:] = [f"{lines[2].removeprefix(':type: ')}: {lines[0]}"]


def short_aliases(
    _app: Any, _what: str, _name: str, _object: Any, _options: Any, given: str, returned: str
) -> tuple[str | None, str | None] | None:
    """Array, not TypeAliasForwardRef('Array'); a default made when needed is ....

    The keys of a scenario have a page of their own.
    """
    if given is None:  # no function
        return None
    if hasattr(_object, "model_fields"):
        return ("(keys)", None)
    given = FUNCTION.sub(r"\1", given.replace("<factory>", "..."))
    for long, short in ((ALIAS, r"\1"), (ARRAY, "Array"), (ARRAY_LIKE, "ArrayLike")):
        given, returned = long.sub(short, given), returned and long.sub(short, returned)
    return (given, returned)
