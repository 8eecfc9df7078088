"""Cost of `import osc_contact`: that of Python itself; a name costs only its own modules."""

from processes import python
from pytest import mark, raises
from samples import module_fixture

import osc_contact as osc
from osc_contact.contacts.pairs import PAIRS
from osc_contact.law import jit

LATER = (
    "matplotlib",
    "mujoco",
    "meshcat",
    "tornado",
    "PIL",
    "yourdfpy",
    "ruckig",
    "rich",
    "typer",
    "urllib.request",
    "ssl",
    "paper",
    "benchmarks",
    "osc_contact.lab.cli.app",
    "osc_contact.lab.visual.plots",
)


def printed(program):
    """The words that a new Python prints."""
    return python("-c", program).stdout.split()


@module_fixture
def loaded():
    program = "import osc_contact as o, sys; o.Controller, o.load_scenario, o.run, o.MujocoRobot"
    return set(printed(f"{program}; print(*sys.modules)"))


@mark.parametrize("module", LATER)
def test_what_few_programs_need_is_imported_where_it_is_used(loaded, module):
    assert "osc_contact.control.controller" in loaded
    assert module not in loaded


def test_nothing_is_loaded_before_a_name_is_used():
    program = "import sys; before = {*sys.modules}; import osc_contact; print(*sys.modules)"
    assert not {"numpy", "pinocchio", "numba", "pydantic"} & set(printed(program))


def test_a_recording_is_judged_without_compiler_and_simulator():
    program = "import osc_contact as o, sys; o.Recording, o.metrics; print(*sys.modules)"
    assert not {"numba", "mujoco"} & set(printed(program))


@mark.skipif(not jit.HAS_LIBRARY, reason="numba stands in place of the library")
def test_names_of_the_core_need_no_extra(monkeypatch):
    monkeypatch.setenv("OSC_CONTACT_LAW", jit.the_library().__file__)
    program = """
import sys
from osc_contact.errors import EXTRAS
sys.modules.update(dict.fromkeys(EXTRAS))
import osc_contact as osc
for name in osc.__all__:
    try:
        getattr(osc, name)
    except ModuleNotFoundError as error:
        assert "pip install 'osc-contact[" in str(error), error
        print(name)
"""
    assert set(printed(program)) == {"load_scenario", "list_scenarios", "sweep", "make_vector_env"}


def test_every_public_name_is_found_and_listed():
    assert all(hasattr(osc, name) for name in osc.__all__)
    assert set(osc.__all__) <= set(dir(osc))
    assert set(PAIRS) <= set(osc.__all__), "name the pair in osc_contact"
    with raises(AttributeError, match="no attribute 'Contorller'"):
        osc.Contorller  # noqa: B018


def test_a_pair_that_is_only_a_file_beside_the_others_is_a_name(monkeypatch):
    monkeypatch.setattr(osc.contacts.pairs, "Dovetail", osc.Prismatic, raising=False)
    assert osc.Dovetail is osc.Prismatic
    del osc.Dovetail


def test_scenarios_know_the_kinds_of_the_layers_above_by_themselves():
    program = (
        "from osc_contact.lab.scenarios.loader import load_scenario;"
        "print(*(type(c).__name__ for c in load_scenario('scara_peg').contacts))"
    )
    assert printed(program) == ["SphereOnPlaneSpec", "SphereOnPlaneSpec"]


def test_scenario_models_are_built_when_they_are_first_used():
    program = (
        "import osc_contact as osc; G = osc.Scenario;"
        "print(G.__pydantic_complete__); osc.load_scenario('two_contact_rod');"
        "print(G.__pydantic_complete__)"
    )
    assert printed(program) == ["False", "True"]
