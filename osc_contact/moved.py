"""Old names of modules and old places of names, which remain for one release with a warning.

`MOVED` and `MOVED_NAMES` are the only lists of them. A module below an old package is found below
the new package.
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

#: New name of each module or package that moved, by its old name, both below this package.
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

#: Names that moved out of a module, with their present modules, by the old module.
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
    "lab.sweeps.sweep": {
        "RigBuilder": "lab.sweeps.rows",
        "available_cores": "lab.sweeps.workers",
        "end_with_parent": "lab.sweeps.workers",
        "record_sample": "lab.sweeps.rows",
        "robot_key": "lab.sweeps.rows",
        "without_logged_doubts": "lab.sweeps.rows",
    },
    "lab.visual.live": {"Shows": "loop.loop"},
    "loop.loop": {
        "latency": "loop.realtime",
    },
    "settings.control": {
        "ForceGains": "settings.gains",
        "Gains": "settings.gains",
        "MotionGains": "settings.gains",
    },
}


def new_name(name: str) -> str | None:
    """Look up the present name of a module; None if it did not move.

    Args:
        name: full name, such as osc_contact.visual.plots.
    """
    if not name.startswith(PACKAGE):
        return None
    package = name.removeprefix(PACKAGE)
    remainder = ""  # the part of the name below the package that moved
    while package:
        if package in MOVED:
            return f"{PACKAGE}{MOVED[package]}{remainder}"
        package, _, last = package.rpartition(".")
        remainder = f".{last}{remainder}"
    return None


class MovedModules(MetaPathFinder, Loader):
    """Finder and loader of modules by their old names; a module is one object under both names."""

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find the spec of a module that moved, or out of which names moved; else None.

        Args:
            fullname: name that is imported.
            path, target: see `importlib.abc.MetaPathFinder`.
        """
        if new_name(fullname) is not None:
            return ModuleSpec(fullname, self, is_package=True)
        if fullname.removeprefix(PACKAGE) not in MOVED_NAMES:
            return None
        spec: Any = PathFinder.find_spec(fullname, path, target)  # type: ignore[arg-type]
        spec.loader.exec_module = partial(_exec_with_old_names, spec.loader.exec_module)
        return spec

    def exec_module(self, module: ModuleType) -> None:
        """Replace an empty module with an old name by the module with the new name, and warn."""
        old = module.__name__
        new = str(new_name(old))  # never None: `find_spec` has found it
        present = import_module(new)
        warnings.warn(
            f"{old} is now {new}; the old name goes with the next release",
            FutureWarning,
            stacklevel=2,  # the import: `warnings` does not count the frames of Python's importer
        )
        sys.modules[old] = present


def _exec_with_old_names(exec_module: Callable[[ModuleType], None], module: ModuleType) -> None:
    """Execute a module, and let it find names that moved out of it in their present modules.

    Args:
        exec_module: method of its loader.
        module: the empty module.
    """
    exec_module(module)
    module.__getattr__ = partial(_name_elsewhere, module.__name__)  # type: ignore[method-assign]


def _name_elsewhere(module: str, name: str) -> Any:
    """Import a name that moved out of a module, and warn; return the object.

    Args:
        module: full name of the old module.
        name: the name.

    Raises:
        AttributeError: the module never had this name.
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
    """Register the finder of old names before Python's own finders; repeated calls do nothing.

    Python's finders would load a module below an old package a second time under its old name.
    """
    if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
        sys.meta_path.insert(0, MovedModules())
