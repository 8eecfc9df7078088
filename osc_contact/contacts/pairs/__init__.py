"""Contact pairs: the poses and twists of two bodies in, a `Contact` out (first-order geometry).

Coordinates: what belongs to the held object is given in its frame, what belongs to the environment
body in that body's frame. Normals point out of the body whose face they belong to; the columns of N
push into the environment.

A pair is one file of this folder. Every file is loaded here, and every pair that registers itself
(`register_pair`) is a name of this module and of `osc_contact`. The imports below give no more than
what type checkers and editors know by name.
"""

from importlib import import_module
from pkgutil import iter_modules

from osc_contact.contacts.pairs.compiled_pair import CompiledPair
from osc_contact.contacts.pairs.cylinder_in_v_groove import CylinderInVGroove
from osc_contact.contacts.pairs.gap_functions import GapFunctions
from osc_contact.contacts.pairs.law_pair import EdgeOnEdge, FaceOnVertex
from osc_contact.contacts.pairs.pair import PAIRS, ContactPair, register_pair
from osc_contact.contacts.pairs.points_on_planes import (
    CylinderInHole,
    CylinderOnPlane,
    EdgeOnFace,
    FaceOnFace,
    SphereOnPlane,
    VertexOnFace,
)
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.contacts.pairs.tangent_pair import (
    ConeInGroove,
    Fixed,
    Free,
    Prismatic,
    Revolute,
    Screw,
)

for _file in iter_modules(__path__):
    import_module(f"{__name__}.{_file.name}")
globals().update(PAIRS)

__all__ = [
    "ContactPair",
    "PAIRS",
    "register_pair",
    "VertexOnFace",
    "FaceOnVertex",
    "SphereOnPlane",
    "SphereOnSurface",
    "EdgeOnEdge",
    "EdgeOnFace",
    "CylinderOnPlane",
    "FaceOnFace",
    "CylinderInHole",
    "CylinderInVGroove",
    "ConeInGroove",
    "Revolute",
    "Prismatic",
    "Screw",
    "Fixed",
    "Free",
    "GapFunctions",
    "CompiledPair",
]
