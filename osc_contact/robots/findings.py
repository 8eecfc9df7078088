"""What is wrong with a robot: one finding, one sentence; all findings become one error."""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from osc_contact.errors import ModelError

SHOWN = 12
"""So many findings, or names, go into the text of an error; the rest is counted."""


@dataclass(frozen=True)
class ModelFinding:
    """One thing wrong with a file.

    Attributes:
        check: which check speaks: "file", "xml", "name", "number", "tree", "joint", "geometry",
            "mesh", "limit", "inertia", "mass matrix" or "second reader".
        file: the URDF. line, column: where, from 1; 0 where no place in the file is to blame.
        element: "link 'tip' <mass value='-1'>"; empty for the file as a whole.
        reason: what is wrong, with the numbers. cure: what to do about it.
    """

    check: str
    file: Path
    line: int
    column: int
    element: str
    reason: str
    cure: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else f"{self.file}"
        return ": ".join(part for part in (place, self.element, self.reason) if part) + (
            f". {self.cure[0].upper()}{self.cure[1:]}" if self.cure else ""
        )


def refuse(findings: Sequence[ModelFinding]) -> NoReturn:
    """Raise a `ModelError` with the text of all findings, which carries them as `findings`."""
    lines = [str(finding) for finding in findings[:SHOWN]]
    if len(findings) > SHOWN:
        lines.append(f"… and {len(findings) - SHOWN} more")
    error = ModelError("\n".join(lines))
    error.findings = tuple(findings)
    raise error


def refuse_file(
    check: str, file: Path, reason: str, cure: str = "", line: int = 0, column: int = 0
) -> NoReturn:
    """Raise a `ModelError` with one finding about a file, or about a place in it.

    Args:
        check, file, reason, cure, line, column: of the `ModelFinding`.
    """
    refuse([ModelFinding(check, file, line, column, "", reason, cure)])


def suggest(name: str, known: Iterable[str]) -> str:
    """ "Did you mean x?" for a name that is not among `known`, or the list of those there are."""
    names = sorted(set(known))
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    more = f", … ({len(names)} in all)" if len(names) > SHOWN else ""
    listed = f"There is: {', '.join(names[:SHOWN]) or 'nothing'}{more}"
    guess = f"Did you mean {' or '.join(near)}?"
    return (guess if more else f"{guess} {listed}") if near else listed
