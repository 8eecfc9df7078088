"""Joint limits: what a controller must know before it may move a joint."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase

from osc_contact.errors import InvalidInputError
from osc_contact.robots.document import Document, Joint
from osc_contact.robots.findings import suggest
from osc_contact.robots.xml_tree import Element

__all__ = ["JointLimits", "check_limits", "give_limits"]

_KEYS = ("lower", "upper", "effort", "velocity")


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint given by hand; None leaves what the file says.

    Attributes:
        lower, upper: positions in rad (revolute) or m (prismatic); ∓inf: no end stop.
        effort: largest |torque| in N m, or |force| in N. velocity: rad/s or m/s.

    Raises:
        InvalidInputError: NaN; lower > upper; effort or velocity not finite or not > 0.
    """

    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None

    def __post_init__(self) -> None:
        for key in ("effort", "velocity"):
            value = getattr(self, key)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InvalidInputError(f"JointLimits: {key} {value} must be finite and > 0")
        low = -math.inf if self.lower is None else self.lower
        high = math.inf if self.upper is None else self.upper
        if not low <= high or low == math.inf or high == -math.inf:
            raise InvalidInputError(f"JointLimits: no position lies in [{low}, {high}]")

    @classmethod
    def parse(cls, text: str) -> tuple[str, JointLimits]:
        """(joint pattern, limits) of "joint1:effort=5,velocity=3".

        Raises:
            InvalidInputError: with the form that is wanted.
        """
        name, colon, rest = text.rpartition(":")
        pairs = [part.partition("=") for part in rest.split(",")]
        wrong = [key.strip() for key, _, _ in pairs if key.strip() not in _KEYS]
        if not colon or wrong:
            raise InvalidInputError(
                f"{text!r}: expected JOINT:key=number,… with the keys {', '.join(_KEYS)}"
            )
        try:
            return name, cls(**{key.strip(): float(value) for key, _, value in pairs})
        except ValueError as error:
            raise InvalidInputError(f"{text!r}: {error}") from error


def give_limits(document: Document, limits: Mapping[str, JointLimits]) -> None:
    """Replace limits of the joints whose name is a key or matches it ("finger*"); first key wins.

    Raises:
        InvalidInputError: a key that no moving joint matches.
    """
    moving = [joint for joint in document.joints.values() if joint.kind != "fixed"]
    used: set[str] = set()
    for joint in moving:
        key = next((key for key in limits if fnmatchcase(joint.name, key)), None)
        if key is not None:
            given = {k: v for k, v in asdict(limits[key]).items() if v is not None}
            joint.limits.update(given)
        used.update(k for k in limits if fnmatchcase(joint.name, k))
    for key in limits:
        if key not in used:
            raise InvalidInputError(
                f"limits: no moving joint matches {key!r}. {suggest(key, [j.name for j in moving])}"
            )


def check_limits(document: Document) -> None:
    """Note limits that are missing, ≤ 0 (effort, velocity) or empty (lower > upper).

    A continuous joint needs effort and velocity; its positions are unbounded whatever is written.
    """
    for joint in document.joints.values():
        if joint.kind == "fixed":
            continue
        element = joint.element.find("limit")
        where = joint.element if element is None else element
        wanted = _KEYS[2:] if joint.kind == "continuous" else _KEYS
        missing = [key for key in wanted if key not in joint.limits]
        if missing == list(wanted) and element is None:
            keys = " ".join(f'{key}="…"' for key in wanted)
            document.add("limit", where, "has no <limit>", f"add <limit {keys}/>{_by_hand(joint)}")
            continue
        for key in missing:
            if element is None or key not in element.attributes:
                document.add("limit", where, f"{key} is missing: a reader would take 0",
                             f'write {key}="…"{_by_hand(joint)}')  # fmt: skip
        _check_values(document, joint, where)


def _check_values(document: Document, joint: Joint, where: Element) -> None:
    limits, turns = joint.limits, joint.kind != "prismatic"
    for key, unit in (
        ("effort", "N m" if turns else "N"),
        ("velocity", "rad/s" if turns else "m/s"),
    ):
        if key in limits and not limits[key] > 0:
            document.add("limit", where, f"{key} limit {limits[key]:g} {unit} must be > 0",
                         f"write what the joint can bear, passive joints too{_by_hand(joint)}",
                         key)  # fmt: skip
    if joint.kind != "continuous" and {"lower", "upper"} <= limits.keys():
        low, high = limits["lower"], limits["upper"]
        if low >= high:
            word = "is above" if low > high else "equals"
            cure = "exchange them" if low > high else 'make the joint fixed or "continuous"'
            document.add("limit", where, f"lower limit {low:g} {word} the upper limit {high:g}",
                         f"{cure}{_by_hand(joint)}", "lower")  # fmt: skip


def _by_hand(joint: Joint) -> str:
    return f", or give limits={{{joint.name!r}: JointLimits(…)}} when loading"
