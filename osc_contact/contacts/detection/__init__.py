"""From collision geometry to the list of contacts: what touches what, where, and as what."""

from osc_contact.contacts.detection.detect import detect
from osc_contact.contacts.detection.detected import Detected
from osc_contact.contacts.detection.features import Feature
from osc_contact.contacts.detection.shapes import CollisionShape, collision_shapes
from osc_contact.contacts.detection.tracked import TrackedContact

__all__ = ["CollisionShape", "Detected", "Feature", "TrackedContact", "collision_shapes", "detect"]
