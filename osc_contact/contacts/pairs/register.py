"""Register of contact pairs, and the base of those of the package."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from inspect import signature
from typing import Any, NamedTuple, TypeVar, dataclass_transform, get_args, get_type_hints

from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.keys import check_geometry
from osc_contact.contacts.pairs.pair import Bodies, ContactPair
from osc_contact.spatial import Array, geometry


class PackagedPair:
    """A pair whose `contact` and `gaps` are evaluated on `Bodies`; see `ContactPair`."""

    name: str

    def __post_init__(self) -> None:
        check_geometry(self)
        self._make()

    def _make(self) -> None:
        """Check and keep what else there is of the geometry."""

    def contact(
        self,
        X_WO: SE3,
        V_O: Array,
        X_WE: SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r) and n_γ (r,) at O, world axes (see `ContactPair.contact`).

        Args:
            X_WO, V_O, X_WE, V_E: as of `ContactPair.contact`.

        Raises:
            ContactError: there is no N in these poses, such as that of two parallel edges.
        """
        return self._contact(Bodies.at_O(X_WO, V_O, X_WE, V_E))

    def gaps(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """(r,) signed errors (m or rad), 0 in contact; distances are negative in an overlap."""
        return self._gaps(X_WO if X_WE is None else X_WE.actInv(X_WO))

    def _contact(self, b: Bodies) -> Contact:
        raise NotImplementedError

    def _gaps(self, X_EA: SE3) -> Array:
        """At a pose of the object in the environment frame."""
        raise NotImplementedError


Pair = TypeVar("Pair", bound=type)

#: Every registered pair by the name of its class.
PAIRS: dict[str, type[ContactPair]] = {}


class NamedPair(NamedTuple):
    """A pair that scenarios may name.

    Attributes:
        pair: its class. forces: r, number of its force magnitudes.
    """

    pair: Any
    forces: int


#: The pairs that scenarios may name, by the `type` of their contact.
NAMED: dict[str, NamedPair] = {}


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(field,))
def register_pair(forces: int | None = None) -> Callable[[Pair], Pair]:
    """Class decorator: enter a pair in the register; a packaged one becomes a frozen dataclass.

    Args:
        forces: r, of a pair that scenarios may name, as its `name` is by default; its keys are the
            fields that are annotated as keys, such as `Point`, with their docstrings. None: it is
            made in Python only.
    """

    def enter(pair: Pair) -> Pair:
        if issubclass(pair, PackagedPair) and "__dataclass_fields__" not in vars(pair):
            geometry(pair)
            _show_plain_types(pair)
        PAIRS[pair.__name__] = pair
        if forces is not None:
            named: Any = pair
            NAMED[named.name] = NamedPair(pair, forces)
        return pair

    return enter


def _show_plain_types(pair: Any) -> None:
    """Let help and API pages show the types of fields without what they are as keys."""
    shown = signature(pair)
    hints = get_type_hints(pair)
    arguments = []
    for one in shown.parameters.values():
        hint = hints[one.name]
        plain = "ArrayLike" if Array in (hint, *get_args(hint)) else hint
        # no class: as it is written, since unions and callables spell out all that they are made of
        kept = plain if isinstance(plain, str | type) else one.annotation
        arguments.append(one.replace(annotation=kept))
    pair.__signature__ = shown.replace(parameters=arguments)
