"""Contact pairs: the poses and twists of two bodies in, a `Contact` out (first-order geometry).

Coordinates: what belongs to the held object is given in its frame, what belongs to the environment
body in that body's frame. Normals point out of the body whose face they belong to; the columns of N
push into the environment.
"""

from osc_contact.contacts.pairs.cone_in_groove import ConeInGroove
from osc_contact.contacts.pairs.gap_functions import GapFunctions
from osc_contact.contacts.pairs.joints import Fixed, Free, Prismatic, Revolute, Screw
from osc_contact.contacts.pairs.lines import CylinderOnPlane, EdgeOnEdge, EdgeOnFace
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.points import FaceOnVertex, SphereOnPlane, VertexOnFace
from osc_contact.contacts.pairs.surfaces import CylinderInHole, FaceOnFace

__all__ = [
    "ContactPair",
    "VertexOnFace",
    "FaceOnVertex",
    "SphereOnPlane",
    "EdgeOnEdge",
    "EdgeOnFace",
    "CylinderOnPlane",
    "FaceOnFace",
    "CylinderInHole",
    "ConeInGroove",
    "Revolute",
    "Prismatic",
    "Screw",
    "Fixed",
    "Free",
    "GapFunctions",
]
