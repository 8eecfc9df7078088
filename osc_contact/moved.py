"""Old names of modules that moved: they are found for one release, with a warning.

`MOVED` is the only list of them. A module below an old package is found below the new one.
"""

import sys
import warnings
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

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
        """The spec of a module that moved; None: there is none of this name.

        Args:
            fullname: name that is imported. path, target: as of other finders; not used.
        """
        if new_name(fullname) is None:
            return None
        return ModuleSpec(fullname, self, is_package=True)

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


def find_moved_modules() -> None:
    """Let Python look for old names first, once.

    An old package is the new one, whose files Python would load a second time under the old name.
    """
    if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
        sys.meta_path.insert(0, MovedModules())
