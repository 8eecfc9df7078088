"""The register of contact pairs: each enters it where it is written, with its keys in YAML."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.scenarios.bodies import ContactSpec, OfBody, register_contact

__all__ = ["PAIRS", "make_pair", "register_pair"]

Pair = TypeVar("Pair", bound=type[Any])

#: Every registered pair by the name of its class.
PAIRS: dict[str, type[ContactPair]] = {}
_MADE_FROM: dict[type[ContactSpec], tuple[Callable[..., ContactPair], dict[str, str]]] = {}


def register_pair(keys: type[ContactSpec] | None = None, **renamed: str) -> Callable[[Pair], Pair]:
    """Class decorator: enter a pair in the register.

    Args:
        keys: keys of such a contact in a scenario. None: it is made in Python only.
        renamed: keys that the class calls otherwise, such as face_point="point".
    """

    def enter(pair: Pair) -> Pair:
        PAIRS[pair.__name__] = pair
        if keys is not None:
            register_contact(keys)
            _MADE_FROM[keys] = pair, renamed
        return pair

    return enter


def make_pair(spec: ContactSpec, X_WB: pin.SE3, folder: Path | None = None) -> ContactPair:
    """The pair that a scenario describes, its environment frame E where the world's is.

    Args:
        spec: of a registered kind. X_WB: pose of the body that the contact is on.
        folder: where files are that it names.
    """
    pair, renamed = _MADE_FROM[type(spec)]
    given: dict[str, Any] = {}
    for key, field in type(spec).model_fields.items():
        value = getattr(spec, key)
        if OfBody.POINT in field.metadata:
            value = X_WB.act(np.array(value))
        elif OfBody.DIRECTION in field.metadata:
            value = X_WB.rotation @ np.array(value)
        elif hasattr(value, "made"):
            value = value.made(folder)
        if key == "face":
            given |= {"point": value.point, "normal": value.normal}
        elif key not in ("type", "body"):
            given[renamed.get(key, key)] = value
    return pair(**given)
