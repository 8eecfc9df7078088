"""Where robots come from: packaged files, the data package example-robot-data, own folders."""

import importlib.metadata
from functools import cache
from pathlib import Path

import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.robots.findings import suggest

ROBOT_DATA = "example-robot-data"
_PACKAGE = Path(__file__).resolve().parent.parent


def urdf_path(name: str) -> Path:
    """Path of a URDF packaged with this library, such as ``"rod.urdf"`` (suffix optional).

    Raises:
        ModelError: no packaged file has that name.
    """
    packaged = _packaged()
    file = packaged.get(name) or packaged.get(f"{name}.urdf")
    if file is None:
        raise ModelError(f"no packaged URDF is called {name!r}. {suggest(name, packaged)}")
    return file


def find_robot(name: str) -> tuple[Path, Path]:
    """(URDF file, package folder) of a robot of the data package ``example-robot-data``.

    ``name`` is a file name without suffix (``"panda"``, ``"ur5_gripper"``), the same without
    ``_robot`` (``"ur5"``), a folder with a single robot (``"xarm"``) or, where two folders hold
    the same file name, ``"anymal_c_simple_description/anymal"``. Addresses of the form
    ``package://example-robot-data/...`` resolve below the returned package folder.

    Raises:
        ModelError: the data package is absent, or the name is unknown or ambiguous.
    """
    root = _robot_data_root()
    files = {f"{p.parent.parent.name}/{p.stem}": p for p in sorted(root.glob("*/*/*.urdf"))}
    rules = (
        lambda key, path: name in (key, path.stem),
        lambda key, path: path.stem == f"{name}_robot",
        lambda key, path: key.split("/")[0] in (f"{name}_description", f"{name}_data"),
    )
    for rule in rules:
        hits = [key for key, path in files.items() if rule(key, path)]
        if len(hits) == 1:
            return files[hits[0]], root.parent.parent
        if hits:
            raise ModelError(
                f"{name!r} is ambiguous in {ROBOT_DATA}: name one of {', '.join(hits)}"
            )
    stems = {path.stem.removesuffix("_robot") for path in files.values()}
    raise ModelError(f"{ROBOT_DATA} has no robot {name!r}. {suggest(name, stems)}")


def resolve_urdf(reference: str, relative_to: Path | None = None) -> tuple[Path, tuple[Path, ...]]:
    """(URDF file, package folders) of a reference as a scenario file writes it.

    ``"example-robot-data:panda"``, the name of a packaged file, or a path relative to the folder
    ``relative_to`` (default: the working folder). A packaged name wins over a file of the same
    name; write ``"./rod.urdf"`` for the latter.

    Raises:
        ModelError: nothing is found; the message names the places searched.
    """
    package, colon, name = reference.partition(":")
    if colon and package == ROBOT_DATA:
        path, package_dir = find_robot(name)
        return path, (package_dir,)
    packaged = _packaged()
    if reference in packaged:
        return packaged[reference], ()
    path = ((relative_to or Path.cwd()) / reference).resolve()
    if path.is_file():
        return path, (path.parent,)
    raise ModelError(
        f"URDF {reference!r} is neither the file {path} nor packaged; a robot of the data package "
        f"is written '{ROBOT_DATA}:panda'. {suggest(reference, packaged)}"
    )


def locate(reference: str) -> tuple[Path, tuple[Path, ...]]:
    """As `resolve_urdf`, for people: a file, a packaged name, or a robot's name as it is ("panda").

    Raises:
        ModelError: nothing is found; the message names the places searched.
    """
    plain = "/" not in reference and "\\" not in reference and not Path(reference).is_file()
    packaged = _packaged()
    if plain and (file := packaged.get(reference) or packaged.get(f"{reference}.urdf")):
        return file, ()
    if plain and ":" not in reference and not reference.endswith((".urdf", ".xml")):
        path, package_dir = find_robot(reference)
        return path, (package_dir,)
    return resolve_urdf(reference)


def _packaged() -> dict[str, Path]:
    """Packaged URDFs by file name: inside the installed package, or beside it in a checkout."""
    places = _PACKAGE / "urdf", _PACKAGE.parent / "urdf"
    return _urdfs_in(next((folder for folder in places if folder.is_dir()), places[0]))


@cache
def _urdfs_in(folder: Path) -> dict[str, Path]:
    return {path.name: path for path in sorted(folder.glob("*.urdf"))}


def _robot_data_root() -> Path:
    """Folder ``share/example-robot-data/robots``."""
    prefixes = [Path(pin.__file__).resolve().parents[4]]
    try:
        data = importlib.metadata.distribution(ROBOT_DATA)
        prefixes.insert(0, Path(str(data.locate_file("cmeel.prefix"))))
    except importlib.metadata.PackageNotFoundError:
        pass  # another packager may have put the data beside Pinocchio
    for prefix in prefixes:
        root = prefix / "share" / ROBOT_DATA / "robots"
        if root.is_dir():
            return root
    raise ModelError(f"the data package {ROBOT_DATA} is not installed: pip install {ROBOT_DATA}")
