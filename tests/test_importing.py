"""What `import osc_contact` costs: what is only for figures, studies and simulators stays out."""

from __future__ import annotations

import subprocess
import sys

import pytest

LATER = (
    "matplotlib", "mujoco", "meshcat", "tornado", "PIL", "yourdfpy", "ruckig", "rich", "typer",
    "urllib.request", "ssl", "osc_contact.paper", "osc_contact.bench", "osc_contact.cli",
    "osc_contact.visual.plots",
)  # fmt: skip


@pytest.fixture(scope="module")
def loaded() -> set[str]:
    program = "import osc_contact, sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


@pytest.mark.parametrize("module", LATER)
def test_what_few_programs_need_is_imported_where_it_is_used(loaded: set[str], module: str) -> None:
    assert "osc_contact.control.controller" in loaded
    assert module not in loaded


def test_scenario_models_are_built_when_they_are_first_used() -> None:
    program = (
        "import osc_contact as osc; G = osc.Scenario;"
        "print(G.__pydantic_complete__); osc.load_scenario('two_contact_rod');"
        "print(G.__pydantic_complete__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "True"]
