"""Scenarios: YAML files → frozen, checked objects; the packaged files are in `files/`.

Settings of controllers are declared here, too: what reads files (extra `scenarios`) is imported on
first access.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from osc_contact.scenarios.loader import list_scenarios, load_scenario, parse_scenario
    from osc_contact.scenarios.schema import Scenario
    from osc_contact.scenarios.signals import total

__all__ = ["Scenario", "list_scenarios", "load_scenario", "parse_scenario", "total"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = {"Scenario": "schema", "total": "signals"}.get(name, "loader")
    return getattr(import_module(f"{__name__}.{home}"), name)
