"""Which contacts can only push."""

from __future__ import annotations

from osc_contact.contacts.pairs import (
    ContactPair,
    CylinderOnPlane,
    EdgeOnEdge,
    EdgeOnFace,
    FaceOnFace,
    FaceOnVertex,
    SphereOnPlane,
    VertexOnFace,
)

__all__ = ["pushes_only"]

_PUSHING = (
    VertexOnFace,
    FaceOnVertex,
    SphereOnPlane,
    EdgeOnEdge,
    EdgeOnFace,
    CylinderOnPlane,
    FaceOnFace,
)


def pushes_only(pair: ContactPair) -> bool:
    """Whether every magnitude of the pair is a force that must not become negative.

    Those of pairs given by T (hinges, holes, grooves) and of gap functions have either sign.
    """
    return isinstance(pair, _PUSHING)
