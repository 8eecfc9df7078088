"""Detection of contacts from collision geometry: features that touch, and their places."""

from osc_contact.contacts.detection.detect import Detected, TrackedContact, detect
from osc_contact.contacts.detection.features import CollisionShape, Feature, collision_shapes

__all__ = ["CollisionShape", "Detected", "Feature", "TrackedContact", "collision_shapes", "detect"]
