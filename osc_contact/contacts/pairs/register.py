"""Register of contact pairs, and the base class of packaged pairs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import field
from inspect import signature
from typing import Any, NamedTuple, TypeVar, dataclass_transform, get_args, get_type_hints

from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.keys import check_geometry
from osc_contact.contacts.pairs.pair import Bodies, ContactPair
from osc_contact.spatial import Array, geometry


class PackagedPair(ABC):
    """Base of pairs that compute contact and gaps from `Bodies` and a relative pose.

    Subclasses define `_contact` and `_gaps`; `contact` and `gaps` are those of `ContactPair`.
    """

    name: str

    def __post_init__(self) -> None:
        check_geometry(self)
        self._make()

    def _make(self) -> None:  # noqa: B027  most pairs need nothing here
        """Check geometry and compute derived attributes, after `check_geometry`."""

    def contact(
        self,
        X_WO: SE3,
        V_O: Array,
        X_WE: SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r) and n_γ (r,) at O, world axes (see `ContactPair.contact`).

        Args:
            X_WO: pose of the object.
            V_O: (6,) its twist at O, world axes (m/s, rad/s).
            X_WE: pose of the environment body; None: the world frame.
            V_E: (6,) its twist at its own origin, world axes; None: at rest.

        Raises:
            ContactError: N is not defined in these poses, for example for parallel edges.
        """
        return self._contact(Bodies.at_O(X_WO, V_O, X_WE, V_E))

    def gaps(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """Signed errors (r,) (m or rad), 0 in contact; distances are negative in an overlap."""
        return self._gaps(X_WO if X_WE is None else X_WE.actInv(X_WO))

    @abstractmethod
    def _contact(self, b: Bodies) -> Contact:
        """N (6, r) and n_γ (r,) at O, world axes, of the two bodies."""

    @abstractmethod
    def _gaps(self, X_EA: SE3) -> Array:
        """Signed errors (r,) (m or rad) at a pose of the object in the environment frame."""


Pair = TypeVar("Pair", bound=type)

#: Every registered pair by the name of its class.
PAIRS: dict[str, type[ContactPair]] = {}


class NamedPair(NamedTuple):
    """Pair that may be used in scenarios.

    Attributes:
        pair: its class.
        forces: r, number of its force magnitudes.
    """

    pair: Any
    forces: int


#: Pairs that may be used in scenarios, by the `type` of a contact.
NAMED: dict[str, NamedPair] = {}


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(field,))
def register_pair(forces: int | None = None) -> Callable[[Pair], Pair]:
    """Class decorator that registers a pair; a packaged pair becomes a frozen dataclass.

    Args:
        forces: number r of force magnitudes of a pair for scenarios, where its `type` is the
            default of its `name`, and its keys are the fields annotated as keys (for example
            `Point`), with their docstrings. None: the pair is not available in scenarios.
    """

    def enter(pair: Pair) -> Pair:
        """Register a class of pairs by its name; a packaged one is made a dataclass.

        Args:
            pair: class of a pair.
        """
        if issubclass(pair, PackagedPair) and "__dataclass_fields__" not in vars(pair):
            geometry(pair)
            _show_plain_types(pair)
        PAIRS[pair.__name__] = pair
        if forces is not None:
            pair_class: Any = pair
            NAMED[pair_class.name] = NamedPair(pair, forces)
        return pair

    return enter


def _show_plain_types(pair: Any) -> None:
    """Hide the annotations of keys in the signature that help and API pages show.

    Args:
        pair: class of a pair.
    """
    declared = signature(pair)
    hints = get_type_hints(pair)
    arguments = []
    for parameter in declared.parameters.values():
        hint = hints[parameter.name]
        plain = "ArrayLike" if Array in (hint, *get_args(hint)) else hint
        # unions and callables are shown as written in the source, which is shorter
        shown_type = plain if isinstance(plain, str | type) else parameter.annotation
        arguments.append(parameter.replace(annotation=shown_type))
    pair.__signature__ = declared.replace(parameters=arguments)
