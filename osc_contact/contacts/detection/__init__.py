"""From collision geometry to the list of contacts: what touches what, where, and as what."""

from osc_contact.contacts.detection.detect import Detected, TrackedContact, detect
from osc_contact.contacts.detection.features import CollisionShape, Feature, collision_shapes

__all__ = ["CollisionShape", "Detected", "Feature", "TrackedContact", "collision_shapes", "detect"]
