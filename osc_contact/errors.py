"""Errors of the toolkit, with one base class, and texts for their messages."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, TypeVar

T = TypeVar("T")

#: Extra that installs a package, by the name under which it is imported.
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
    "pydrake": "drake",
}


def missing(error: ImportError) -> str:
    """Command that installs the missing package of an extra; "" for any other package.

    Args:
        error: error of an import.
    """
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return ""
    return f"{package} is not installed: pip install 'osc-contact[{EXTRAS[package]}]'"


MANY = 8  #: largest number of known names that are listed after a guess
SHOWN = 12  #: largest number of known names that are listed without a guess


def did_you_mean(word: str, known: Iterable[str], most: int = SHOWN) -> str:
    """Make the hint "did you mean 'x'? known: ..." for an unknown word.

    A long list of known words is left out if there is a guess, and cut off if there is none.

    Args:
        word: word that is not among `known`.
        known: possible words.
        most: largest number of known words to list; 0: a guess only, or "".
    """
    names = list(known)
    similar = get_close_matches(word, names, n=2, cutoff=0.6)
    hint = f"did you mean {' or '.join(map(repr, similar))}?" if similar else ""
    if most == 0 or (similar and len(names) > MANY):
        return hint
    ellipsis = f", … ({len(names)} in all)" if len(names) > most else ""
    listed = ", ".join(names[:most]) or "none"
    return f"{hint} known: {listed}{ellipsis}".lstrip()


class OscContactError(Exception):
    """Base class of all errors that the toolkit raises on purpose.

    Example:
        >>> try:
        ...     scenario = osc.load_scenario("no_such_task")
        ... except osc.OscContactError as error:
        ...     print(type(error).__name__)
        ScenarioError
    """


class InvalidInputError(OscContactError, ValueError):
    """Error of an argument of wrong shape, that is not finite, or outside its range.

    Example:
        >>> osc.JerkLimits(velocity=0.0, acceleration=1.0, jerk=10.0)
        Traceback (most recent call last):
            ...
        osc_contact.errors.InvalidInputError: ...
    """


class ModelError(OscContactError):
    """Error of an impossible robot, object or closed chain: bad URDF, lost or unactuated motions.

    Attributes:
        findings: every `osc_contact.robots.ModelFinding` of a refused URDF; else empty.

    Example:
        >>> osc.RigidObject(pin.Inertia.Zero())
        Traceback (most recent call last):
            ...
        osc_contact.errors.ModelError: ...
    """

    findings: tuple[Any, ...] = ()


class ContactError(OscContactError):
    """Error of an impossible contact state: NᵀT ≠ 0, contradictory or unreachable contacts.

    Example:
        >>> osc.Contact(np.ones((6, 2)))  # dependent columns
        Traceback (most recent call last):
            ...
        osc_contact.errors.ContactError: ...
    """


class ScenarioError(OscContactError):
    """Error in a scenario file; the message names the file, the line and the key.

    Example:
        >>> osc.load_scenario("two_contact_rod", ["squeeze=5 mm"])
        Traceback (most recent call last):
            ...
        osc_contact.errors.ScenarioError: ...
    """


class SolverError(OscContactError):
    """Failure of a solver: of a quadratic program, or of the search for a jerk-limited trajectory.

    In the first case a controller holds its last torques, in the second a set point keeps its
    former goal.

    Example:
        >>> height = osc.SetPoint(0.0, osc.JerkLimits(0.1, 1.0, 10.0), dt=1e-3)
        >>> try:
        ...     state = height.step(goal=0.2)
        ... except osc.SolverError:
        ...     state = height.step()  # on the way to the former goal
    """


class PlantError(OscContactError):
    """Failure of a plant: it cannot be built, or its simulation left the range of its validity.

    Attributes:
        recording: the `Recording` of a run until its plant failed, else None.

    Example:
        >>> try:
        ...     recording = osc.run(osc.load_scenario("two_contact_rod"), duration=0.01)
        ... except osc.PlantError as error:
        ...     recording = error.recording
    """

    recording: Any = None


class RecordingError(OscContactError):
    """Error of a recording that cannot be written or read.

    Example:
        >>> osc.Recording({}, {"t": [0.0, 0.1], "force": [5.0]})
        Traceback (most recent call last):
            ...
        osc_contact.errors.RecordingError: ...
    """


class ViewerError(OscContactError):
    """Failure to show a picture: no browser, no server, or the live view has ended.

    Example:
        >>> try:
        ...     osc.open_viewer(osc.load_scenario("two_contact_rod")).close()
        ... except osc.ViewerError as error:
        ...     print(f"no picture: {error}")
    """


class Interrupted(KeyboardInterrupt):
    """End of a run in order after Ctrl-C, SIGTERM or SIGHUP.

    Attributes:
        recording: the `Recording` until then.

    Example:
        >>> try:
        ...     recording = osc.run(osc.load_scenario("two_contact_rod"), duration=0.01)
        ... except osc.Interrupted as end:
        ...     recording = end.recording
    """

    recording: Any = None


def require_kind(name: str, value: object, kind: type, example: str) -> None:
    """Refuse an argument that is not an instance of a class.

    Args:
        name: name of the argument, for the message.
        value: argument as given.
        kind: expected class.
        example: Python expression of a proper argument, for the message.

    Raises:
        InvalidInputError: `value` is not an instance of `kind`.
    """
    if not isinstance(value, kind):
        raise InvalidInputError(
            f"{name} takes {article(kind.__name__)}, got {brief(value)}; give {example}"
        )


def as_tuple(name: str, value: Iterable[T], example: str) -> tuple[T, ...]:
    """Return the elements of an argument that takes several objects.

    Args:
        name: name of the argument, for the message.
        value: argument as given.
        example: Python expression of a proper argument, for the message.

    Raises:
        InvalidInputError: `value` is a string, or cannot be iterated over.
    """
    try:
        if not isinstance(value, str):
            return tuple(value)
    except TypeError:
        pass
    raise InvalidInputError(f"{name} is {brief(value)}; give a list, such as {example}")


def brief(value: object) -> str:
    """Representation of a value in one line of at most 60 characters, for messages."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:59]}…"


def article(noun: str) -> str:
    """Noun with its indefinite article: "an Arm", "a ClosedChain"."""
    return f"{'an' if noun[0] in 'AEIO' else 'a'} {noun}"
