"""A scenario, or the name or path of one, wherever a scenario is taken."""

from __future__ import annotations

from pathlib import Path

from osc_contact.lab.scenarios.schema import Scenario


def as_scenario(scenario: str | Path | Scenario) -> Scenario:
    """Return a scenario made already, or load it by name or path, see `load_scenario`.

    Raises:
        ScenarioError: see `load_scenario`.
    """
    if isinstance(scenario, Scenario):
        return scenario
    from osc_contact.lab.scenarios.loader import load_scenario  # YAML comes with an extra

    return load_scenario(scenario)
