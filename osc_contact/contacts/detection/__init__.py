"""From collision geometry to the list of contacts: what touches what, where, and as what."""

from osc_contact.contacts.detection.detect import detect
from osc_contact.contacts.detection.detected import Detected
from osc_contact.contacts.detection.features import Feature
from osc_contact.contacts.detection.shapes import CollisionShape, collision_shapes

__all__ = ["CollisionShape", "Detected", "Feature", "collision_shapes", "detect"]
