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
from osc_contact.contacts.pairs.cone_in_groove import ConeInGroove
from osc_contact.contacts.pairs.cylinder_in_hole import CylinderInHole
from osc_contact.contacts.pairs.cylinder_in_v_groove import CylinderInVGroove
from osc_contact.contacts.pairs.cylinder_on_plane import CylinderOnPlane
from osc_contact.contacts.pairs.edge_on_edge import EdgeOnEdge
from osc_contact.contacts.pairs.edge_on_face import EdgeOnFace
from osc_contact.contacts.pairs.face_on_face import FaceOnFace
from osc_contact.contacts.pairs.face_on_vertex import FaceOnVertex
from osc_contact.contacts.pairs.fixed import Fixed, Free
from osc_contact.contacts.pairs.gap_functions import GapFunctions
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.prismatic import Prismatic
from osc_contact.contacts.pairs.registry import PAIRS, register_pair
from osc_contact.contacts.pairs.revolute import Revolute
from osc_contact.contacts.pairs.screw import Screw
from osc_contact.contacts.pairs.sphere_on_plane import SphereOnPlane
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.contacts.pairs.vertex_on_face import VertexOnFace

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
