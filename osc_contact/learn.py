"""Public module of the action term for mjlab, see `osc_contact.lab.learn`."""

from osc_contact.lab.learn import ContactAction, ContactActionCfg, begin

__all__ = ["ContactAction", "ContactActionCfg", "begin"]
