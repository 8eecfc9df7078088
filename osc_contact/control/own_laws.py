"""Laws put in place of the controller's own: see `laws`."""

from osc_contact.control.laws import ForceCommand as Law
from osc_contact.control.laws import force_law, motion_law

__all__ = ["Law", "force_law", "motion_law"]
