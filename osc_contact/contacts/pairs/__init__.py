"""Contact pairs: first-order geometry that maps poses and twists of two bodies to a `Contact`.

Geometry of the held object is given in the object's frame, geometry of the environment body in that
body's frame. Normals point out of the body to whose face they belong; the columns of N push into
the environment.

Pairs are defined in the files of this folder. Every pair that registers itself (`register_pair`) is
a name of this module and of `osc_contact`; the files are loaded when such a name is used, or by
`load_pairs`.
"""

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from osc_contact.contacts.pairs import register
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.register import register_pair

__all__ = ["ContactPair", "load_pairs", "register_pair"]


def load_pairs() -> dict[str, type[ContactPair]]:
    """Load all files of this folder, which register their pairs; return the pairs by name."""
    for file in iter_modules(__path__):
        import_module(f"{__name__}.{file.name}")
    return register.PAIRS


def __getattr__(name: str) -> Any:
    """Return `PAIRS` or the class of a pair by its name, importing the pairs on first use."""
    if name == "PAIRS":
        return load_pairs()
    if name[:1].isupper() and name in load_pairs():
        return register.PAIRS[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
