"""Old names of modules, and old places of names, that moved: found for one release, with a warning.

`MOVED` and `MOVED_NAMES` are the only lists of them. A module below an old package is found below
the new one.
"""

import sys
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

PACKAGE = "osc_contact."

#: Old name of a module or package → new one, both below this package.
MOVED = {
    "cli": "lab.cli.app",
    "cli_robots": "lab.cli.robots",
    "cli_sweeps": "lab.cli.sweeps",
    "console": "lab.cli.console",
    "plants": "lab.plants",
    "plants.judge": "loop.judge",
    "runs": "lab.runs",
    "runs.commissioning": "loop.commissioning",
    "runs.contacts": "lab.rig.contacts",
    "runs.hardware": "lab.rig.hardware",
    "runs.inspection": "lab.checks.inspection",
    "runs.loop": "loop.loop",
    "runs.preflight": "lab.checks.preflight",
    "runs.recorder": "loop.recorder",
    "runs.references": "lab.rig.references",
    "runs.report": "lab.reports.report",
    "runs.rig": "lab.rig.rig",
    "runs.rules": "loop.rules",
    "runs.scene_rules": "loop.scene_rules",
    "runs.shadow": "loop.shadow",
    "runs.start_rules": "loop.start_rules",
    "runs.viewing": "lab.reports.viewing",
    "scenarios": "lab.scenarios",
    "scenarios.control_schema": "settings.control",
    "scenarios.quantities": "settings.quantities",
    "sweeps": "lab.sweeps",
    "visual": "lab.visual",
}

#: Module → names that stood there, and their module now.
MOVED_NAMES = {
    "contacts.pairs.pair": {
        "BodyDirection": "contacts.pairs.keys",
        "BodyPoint": "contacts.pairs.keys",
        "Direction": "contacts.pairs.keys",
        "EdgeOnEdge": "contacts.pairs.vertex_and_edge",
        "Extent": "contacts.pairs.keys",
        "FaceDirection": "contacts.pairs.keys",
        "FaceOnVertex": "contacts.pairs.vertex_and_edge",
        "FacePoint": "contacts.pairs.keys",
        "LawPair": "contacts.pairs.law_pair",
        "PAIRS": "contacts.pairs",
        "PackagedPair": "contacts.pairs.register",
        "PairRow": "contacts.pairs.law_pair",
        "Point": "contacts.pairs.keys",
        "Radius": "contacts.pairs.keys",
        "check_geometry": "contacts.pairs.keys",
        "law_row": "contacts.pairs.law_pair",
        "make_pair": "lab.scenarios.contact_keys",
        "normals_over": "contacts.pairs.law_pair",
        "register_pair": "contacts.pairs.register",
        "require_object_fits": "contacts.pairs.keys",
        "shape": "contacts.pairs.law_pair",
        "store": "contacts.pairs.keys",
    },
    "control.records": {
        "Reading": "control.controller_settings",
        "Settings": "control.controller_settings",
        "choose_reading": "control.controller_settings",
        "joint_limit_margins": "control.packing",
    },
    "dynamics.closed_chain": {
        "OutboardLink": "dynamics.merged_model",
    },
    "lab.runs.run": {
        "recover": "lab.runs.recovery",
        "scenario_of": "lab.runs.recovery",
        "shown_of": "lab.reports.viewing",
    },
    "lab.visual.live": {"Shows": "loop.loop"},
    "loop.loop": {
        "latency": "loop.realtime",
    },
}


def new_name(name: str) -> str | None:
    """The name that a module has now, or None: it did not move.

    Args:
        name: full name, such as osc_contact.visual.plots.
    """
    old = name.removeprefix(PACKAGE)
    above, rest = old, ""
    while name.startswith(PACKAGE) and above:
        if above in MOVED:
            return f"{PACKAGE}{MOVED[above]}{rest}"
        above, _, last = above.rpartition(".")
        rest = f".{last}{rest}"
    return None


class MovedModules(MetaPathFinder, Loader):
    """Finds a module by its old name: the one module is there under both names."""

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a module that moved, or that names have left; None: neither.

        Args:
            fullname: name that is imported. path, target: as of other finders.
        """
        if new_name(fullname) is not None:
            return ModuleSpec(fullname, self, is_package=True)
        if fullname.removeprefix(PACKAGE) not in MOVED_NAMES:
            return None
        spec: Any = PathFinder.find_spec(fullname, path, target)  # type: ignore[arg-type]
        spec.loader.exec_module = partial(_exec_with_old_names, spec.loader.exec_module)
        return spec

    def exec_module(self, module: ModuleType) -> None:
        """Put the module of the new name in place of an empty one, and warn."""
        old = module.__name__
        new = str(new_name(old))
        found = import_module(new)
        warnings.warn(
            f"{old} is now {new}; the old name goes with the next release",
            FutureWarning,
            stacklevel=2,
        )
        sys.modules[old] = found


def _exec_with_old_names(exec_module: Callable[[ModuleType], None], module: ModuleType) -> None:
    """Fill a module; names that have left it are looked for where they are now."""
    exec_module(module)
    module.__getattr__ = partial(_name_elsewhere, module.__name__)  # type: ignore[method-assign]


def _name_elsewhere(module: str, name: str) -> Any:
    """A name that has left a module, with a warning.

    Raises:
        AttributeError: it never stood there.
    """
    new = MOVED_NAMES[module.removeprefix(PACKAGE)].get(name)
    if new is None:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(
        f"{module}.{name} is now {PACKAGE}{new}.{name}; the old place goes with the next release",
        FutureWarning,
        stacklevel=2,
    )
    return getattr(import_module(f"{PACKAGE}{new}"), name)


def find_moved_modules() -> None:
    """Let Python look for old names first, once.

    An old package is the new one, whose files Python would load a second time under the old name.
    """
    if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
        sys.meta_path.insert(0, MovedModules())
