"""Scenarios: YAML files → frozen, checked objects; the packaged files are in `files/`."""

from osc_contact.scenarios.loader import list_scenarios, load_scenario, parse_scenario
from osc_contact.scenarios.schema import Scenario
from osc_contact.scenarios.signals import total

__all__ = ["Scenario", "list_scenarios", "load_scenario", "parse_scenario", "total"]
