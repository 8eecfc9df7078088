"""Contact pairs: the poses and twists of two bodies in, a `Contact` out (first-order geometry).

Coordinates: what belongs to the held object is given in its frame, what belongs to the environment
body in that body's frame. Normals point out of the body whose face they belong to; the columns of N
push into the environment.

A pair is one file of this folder. Every pair that registers itself (`register_pair`) is a name of
this module and of `osc_contact`; the files are loaded when such a name is used, or by `load_pairs`.
"""

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from osc_contact.contacts.pairs import register
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.register import register_pair

__all__ = ["ContactPair", "load_pairs", "register_pair"]


def load_pairs() -> dict[str, type[ContactPair]]:
    """Load every file of this folder, each of which enters its pairs; returns these by name."""
    for file in iter_modules(__path__):
        import_module(f"{__name__}.{file.name}")
    return register.PAIRS


def __getattr__(name: str) -> Any:
    if name == "PAIRS":
        return load_pairs()
    if name[:1].isupper() and name in load_pairs():
        return register.PAIRS[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
