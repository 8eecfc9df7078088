"""Public name of the composite controller for robosuite, see `osc_contact.lab.robosuite`."""

from osc_contact.lab.robosuite import OscContact, osc_contact_config

__all__ = ["OscContact", "osc_contact_config"]
