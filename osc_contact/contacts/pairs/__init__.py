"""Contact pairs: the poses and twists of two bodies in, a `Contact` out (first-order geometry).

Coordinates: what belongs to the held object is given in its frame, what belongs to the environment
body in that body's frame. Normals point out of the body whose face they belong to; the columns of N
push into the environment.

A pair is one file of this folder. Every file is loaded here, and every pair that registers itself
(`register_pair`) is a name of this module and of `osc_contact`.
"""

from importlib import import_module
from pkgutil import iter_modules

from osc_contact.contacts.pairs.pair import PAIRS, ContactPair, register_pair

for _file in iter_modules(__path__):
    import_module(f"{__name__}.{_file.name}")
globals().update(PAIRS)

__all__ = ["PAIRS", "ContactPair", "register_pair"]
