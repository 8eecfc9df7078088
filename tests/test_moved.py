"""Old names of modules that moved: the one module, with a warning, for one release."""

import importlib.util
import pickle
import sys

from processes import python
from pytest import mark, raises, warns
from samples import ROOT

from osc_contact import moved
from osc_contact.lab.scenarios.schema import Scenario

EVERY = [*moved.MOVED.items(), ("visual.plots", "lab.visual.plots")]
EVERY += [("scenarios.files", "lab.scenarios.files")]


def forget(monkeypatch, name):
    """Let an old name be looked for anew."""
    for known in [known for known in sys.modules if f"{known}.".startswith(f"{name}.")]:
        monkeypatch.delitem(sys.modules, known)


@mark.parametrize("old, new", moved.MOVED.items())
def test_an_old_name_is_the_module_of_the_new_one_with_a_warning(old, new, monkeypatch):
    forget(monkeypatch, f"osc_contact.{old}")
    with warns(FutureWarning) as caught:
        found = importlib.import_module(f"osc_contact.{old}")
    assert str(caught[-1].message).startswith(f"osc_contact.{old} is now osc_contact.{new}; ")
    assert found is importlib.import_module(f"osc_contact.{new}")


@mark.parametrize("old, new", EVERY)
def test_new_names_exist_and_old_ones_do_not(old, new):
    assert moved.new_name(f"osc_contact.{old}") == f"osc_contact.{new}"
    assert (ROOT / "osc_contact" / new.replace(".", "/")).with_suffix(".py").exists() or (
        ROOT / "osc_contact" / new.replace(".", "/")
    ).is_dir()
    assert not (ROOT / "osc_contact" / old.replace(".", "/")).with_suffix(".py").exists()
    assert not (ROOT / "osc_contact" / old.replace(".", "/")).exists()


@mark.parametrize(
    "module, name, new",
    [(module, name, new) for module, own in moved.MOVED_NAMES.items() for name, new in own.items()],
)
def test_a_name_that_left_its_module_is_found_with_a_warning(module, name, new):
    old = importlib.import_module(f"osc_contact.{module}")
    assert name not in vars(old)
    with warns(FutureWarning, match=f"{module}.{name} is now osc_contact.{new}.{name}; "):
        found = getattr(old, name)
    assert found is getattr(importlib.import_module(f"osc_contact.{new}"), name)
    with raises(AttributeError, match="has no attribute 'nothing'"):
        old.nothing  # noqa: B018


def test_a_module_below_an_old_package_is_not_loaded_twice():
    program = (
        "from osc_contact.plants.rigid import RigidPlant as old\n"
        "from osc_contact.lab.plants.rigid import RigidPlant as new\n"
        "import osc_contact.visual.plots\n"
        "print(old is new, osc_contact.visual.plots.__name__)"
    )
    done = python("-c", program)
    assert done.stdout.split() == ["True", "osc_contact.lab.visual.plots"]
    assert "osc_contact.plants.rigid is now osc_contact.lab.plants.rigid" in done.stderr


def test_what_was_pickled_under_an_old_name_is_read():
    held = pickle.dumps(Scenario, protocol=0)
    old = held.replace(b"osc_contact.lab.scenarios.schema", b"osc_contact.scenarios.schema")
    assert old != held
    sys.modules.pop("osc_contact.scenarios.schema", None)
    with warns(FutureWarning, match=r"osc_contact\.scenarios"):
        assert pickle.loads(old) is Scenario


@mark.filterwarnings("ignore:osc_contact.visual is now:FutureWarning")
def test_other_names_are_left_to_python():
    assert moved.new_name("osc_contact.contacts.contact") is None
    assert moved.new_name("visual.plots") is None
    assert moved.new_name("osc_contact") is None
    with raises(ModuleNotFoundError, match=r"osc_contact\.nothing"):
        importlib.import_module("osc_contact.nothing")
    with raises(ModuleNotFoundError, match=r"osc_contact\.lab\.visual\.nothing"):
        importlib.import_module("osc_contact.visual.nothing")


def test_the_changelog_lists_every_move():
    table = (ROOT / "CHANGELOG.md").read_text().partition("### Moved")[2].partition("###")[0]
    for old, new in moved.MOVED.items():
        assert f"| `{old}` | `{new}` |" in table
