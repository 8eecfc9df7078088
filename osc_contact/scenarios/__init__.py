"""Scenarios: YAML files → frozen, checked objects; the packaged files are in `files/`."""

from .loader import list_scenarios, load_scenario, parse_scenario
from .schema import Scenario
from .signals import total

__all__ = ["Scenario", "list_scenarios", "load_scenario", "parse_scenario", "total"]
