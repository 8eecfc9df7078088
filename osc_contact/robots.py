"""URDF in, checked Pinocchio model out; every file is judged before it reaches the dynamics.

Files come from three places: the URDFs packaged with this library, the robots of the data package
``example-robot-data``, and the user's own folders. :func:`resolve_urdf` knows all three.
"""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.robot_checks import (
    check_inertia,
    check_joints,
    check_limits,
    check_mass_matrix,
    frame_id,
    link_mass,
    placement_difference,
    random_configurations,
    read_urdf,
    suggest,
)

__all__ = [
    "urdf_path",
    "find_robot",
    "resolve_urdf",
    "load_model",
    "frame_id",
    "load_body",
    "cross_check",
]

ROBOT_DATA = "example-robot-data"
_MASS_MATRIX_SAMPLES = 10
_CROSS_CHECK_TOLERANCE = 1e-9


# Where the files are ------------------------------------------------------------------------------


def urdf_path(name: str) -> Path:
    """Path of a URDF packaged with this library, such as ``"rod.urdf"`` (suffix optional).

    Raises:
        ModelError: no packaged file has that name.
    """
    packaged = _packaged()
    found = packaged.get(name) or packaged.get(f"{name}.urdf")
    if found is None:
        raise ModelError(f"no packaged URDF is called {name!r}. {suggest(name, packaged)}")
    return found


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
            raise ModelError(f"{name!r} is ambiguous in {ROBOT_DATA}: say one of {', '.join(hits)}")
    stems = {path.stem for path in files.values()}
    raise ModelError(f"{ROBOT_DATA} has no robot {name!r}. {suggest(name, stems)}")


def resolve_urdf(reference: str, relative_to: Path | None = None) -> tuple[Path, tuple[Path, ...]]:
    """(URDF file, package folders) of a reference as a scenario file writes it.

    ``"example-robot-data:panda"``, the name of a packaged file, or a path relative to the folder
    ``relative_to`` (default: the working folder). A packaged name wins over a file of the same
    name; write ``"./rod.urdf"`` for the latter.

    Raises:
        ModelError: nothing is found; the message says where was looked.
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


# What is in them ----------------------------------------------------------------------------------


def load_model(path: Path | str) -> pin.Model:
    """Build the fixed-base Pinocchio model of a URDF after checking that it can be controlled.

    Raises:
        ModelError: the file is missing or not a URDF; a limit is missing, not finite, ≤ 0 (effort,
            velocity) or empty (lower > upper); a joint has nq ≠ nv; the inertia of a link is not
            that of a body; the mass matrix is not positive definite at the neutral or at one of
            ten seeded random configurations.
    """
    file = Path(path)
    links, joints = read_urdf(file)
    for joint in joints:
        check_limits(file, joint)
    for link in links:
        check_inertia(file, link)
    try:
        model = pin.buildModelFromUrdf(str(file))
    except (ValueError, RuntimeError) as error:
        raise ModelError(
            f"{file}: Pinocchio refuses the file: {error} (details: stderr)"
        ) from error
    check_joints(file, model)
    for q in (pin.neutral(model), *random_configurations(model, _MASS_MATRIX_SAMPLES)):
        check_mass_matrix(file, model, q)
    return model


def load_body(path: Path | str) -> pin.Inertia:
    """Inertia of the single body of a URDF, expressed in the frame of the file's root link.

    Raises:
        ModelError: as :func:`load_model`; or a joint moves; or not exactly one link has mass.
    """
    file = Path(path)
    model = load_model(file)
    heavy = [link.get("name", "") for link in read_urdf(file)[0] if link_mass(file, link) > 0]
    if model.nv > 0:
        moving = ", ".join(list(model.names)[1:])
        raise ModelError(f"{file}: one rigid body is wanted, but these joints move: {moving}")
    if len(heavy) != 1:
        raise ModelError(
            f"{file}: exactly one link with mass is wanted, found {len(heavy)} "
            f"({', '.join(heavy) or 'none'}); merge them into one <inertial>"
        )
    return pin.Inertia(model.inertias[0])


def cross_check(path: Path | str) -> float:
    """Largest difference of all link placements between Pinocchio and a second URDF reader.

    Five seeded random configurations; the entries of the 4×4 placements are compared (rotations
    without unit, translations in m). Mimic joints follow their master in both.

    Raises:
        ModelError: as :func:`load_model`; or the difference exceeds 1e-9, with link and size.
    """
    worst, where = placement_difference(load_model(path), Path(path))
    if not worst <= _CROSS_CHECK_TOLERANCE:
        raise ModelError(
            f"{path}: two URDF readers place link {where!r} {worst:.3g} apart (allowed "
            f"{_CROSS_CHECK_TOLERANCE:g}); look for an axis that is not a unit vector or a rpy "
            "with few digits"
        )
    return worst


def _packaged() -> dict[str, Path]:
    """Packaged URDFs by file name: inside the installed package, or beside it in a checkout."""
    here = Path(__file__).resolve().parent
    folder = next((f for f in (here / "urdf", here.parent / "urdf") if f.is_dir()), here / "urdf")
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
