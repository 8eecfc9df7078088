"""Scenarios as arguments: a scenario itself, or its name or path."""

from __future__ import annotations

from pathlib import Path

from osc_contact.lab.scenarios.schema import Scenario


def as_scenario(scenario: str | Path | Scenario) -> Scenario:
    """Return a scenario itself, or load it by name or path, see `load_scenario`.

    Raises:
        ScenarioError: there is no such scenario, or errors in its file.
    """
    if isinstance(scenario, Scenario):
        return scenario
    from osc_contact.lab.scenarios.loader import load_scenario  # YAML comes with an extra

    return load_scenario(scenario)
