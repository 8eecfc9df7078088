"""Every error of the toolkit: one base class, children that name the refused input."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

#: Extra that brings a package, by the name under which it is imported.
EXTRAS = {
    "numba": "law",
    "llvmlite": "law",
    "yaml": "scenarios",
    "typer": "scenarios",
    "rich": "scenarios",
    "meshcat": "view",
    "tornado": "view",
    "umsgpack": "view",
    "matplotlib": "plot",
    "mpl_toolkits": "plot",
    "PIL": "plot",
    "av": "video",
    "mujoco": "sim",
    "ruckig": "sim",
    "pyarrow": "sweep",
    "yourdfpy": "scenarios",
    "scipy": "scenarios",
    "gymnasium": "learn",
    "optuna": "tune",
    "distributed": "cluster",
    "pylibfranka": "franka",
}


def missing(error: ImportError) -> str:
    """What to install where an extra's package is missing; "" for any other package."""
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return ""
    return f"{package} is not installed: pip install 'osc-contact[{EXTRAS[package]}]'"


MANY = 8  #: names beside a guess
SHOWN = 12  #: names without one


def did_you_mean(word: str, known: Iterable[str], most: int = SHOWN) -> str:
    """Return "did you mean 'x'? known: ..." for a word that is not among `known`.

    Long lists are left out where there is a guess, and cut where there is none.

    Args:
        word, known: as said. most: names listed; 0: none, a guess alone or "".
    """
    names = list(known)
    near = get_close_matches(word, names, n=2, cutoff=0.6)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else ""
    if most == 0 or (near and len(names) > MANY):
        return hint
    more = f", … ({len(names)} in all)" if len(names) > most else ""
    listed = ", ".join(names[:most]) or "none"
    return f"{hint} known: {listed}{more}".lstrip()


class OscContactError(Exception):
    """Base class: catch this one to catch whatever the toolkit raises on purpose."""


class InvalidInputError(OscContactError, ValueError):
    """An argument has the wrong shape, is not finite, or is outside its range."""


class ModelError(OscContactError):
    """A robot, an object or a closed chain is impossible: bad URDF, lost or unactuated motions.

    Attributes:
        findings: of a refused URDF, every `osc_contact.robots.Finding`; else empty.
    """

    findings: tuple[Any, ...] = ()


class ContactError(OscContactError):
    """A contact state is impossible: NᵀT ≠ 0, contradictory or unreachable contacts."""


class ScenarioError(OscContactError):
    """A scenario file is wrong; the message names the file, the line and the key."""


class SolverError(OscContactError):
    """A quadratic program was not solved (a controller that meets it holds its last torques), or no
    jerk-limited way was found (a set point keeps its former goal)."""


class PlantError(OscContactError):
    """A plant cannot be built, or its simulation left the range where it means anything.

    Attributes:
        recording: the `Recording` of what came before a run's plant failed, else None.
    """

    recording: Any = None


class RecordingError(OscContactError):
    """A recording cannot be written or read back."""


class ViewerError(OscContactError):
    """A picture cannot be shown: no browser, no server, or the live view has ended."""


class Interrupted(KeyboardInterrupt):
    """A run was ended in order by Ctrl-C, SIGTERM or SIGHUP.

    Attributes:
        recording: the `Recording` of what came before.
    """

    recording: Any = None


def require_kind(name: str, value: object, kind: type, example: str) -> None:
    """Refuse an argument that is no object of its class.

    Args:
        name: of the argument. value: as given. kind: the class that it takes.
        example: what to give instead, as it is written in a program.

    Raises:
        InvalidInputError: with the class expected and what was given.
    """
    if not isinstance(value, kind):
        raise InvalidInputError(
            f"{name} takes {article(kind.__name__)}, got {brief(value)}; give {example}"
        )


def as_tuple(name: str, value: Any, example: str) -> tuple[Any, ...]:
    """The elements of an argument that takes several objects.

    Args:
        name: of the argument. value: as given. example: what to give instead of anything else.

    Raises:
        InvalidInputError: there are no elements.
    """
    try:
        if not isinstance(value, str):
            return tuple(value)
    except TypeError:
        pass
    raise InvalidInputError(f"{name} is {brief(value)}; give a list, such as {example}")


def brief(value: object) -> str:
    """The representation of a value in one line of at most 60 characters, for messages."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:59]}…"


def article(noun: str) -> str:
    """ "an Arm", "a ClosedChain": a noun with its indefinite article."""
    return f"{'an' if noun[0] in 'AEIO' else 'a'} {noun}"
