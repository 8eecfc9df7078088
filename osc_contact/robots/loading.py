"""Loading of URDF files as Pinocchio models; a file is checked before Pinocchio reads it."""

import importlib.metadata
import re
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import pinocchio as pin

from osc_contact.errors import ModelError, did_you_mean
from osc_contact.robots.checks import (
    Inertias,
    JointLimits,
    check_geometry,
    check_inertias,
    check_limits,
    check_mesh_files,
    check_moving_bodies,
    matching_limits,
    require_level,
)
from osc_contact.robots.elements import read_bytes, refuse, refuse_file
from osc_contact.robots.mjcf import compile_mjcf, couplings, is_mjcf, load_mjcf
from osc_contact.robots.model import build_model, check_mass_matrix, joint_names
from osc_contact.robots.urdf import Document, check_mimics, check_tree, read_document


class Loaded(NamedTuple):
    """Model of a robot that passed all checks, and its links and joints as written.

    Loads of the same file share it: it must not be changed.
    """

    model: pin.Model
    document: Document


def load(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
) -> Loaded:
    """Load and check a URDF; return its model and the document from which it was built.

    A file whose content has passed before is not checked again, since studies build thousands of
    rigs from the same files.

    Args:
        path: the URDF.
        limits: limits that replace those of the file, by joint name or pattern.
        inertias: level of the check of inertias.
        package_dirs: folders in which `package://` paths of meshes are searched.

    Raises:
        ModelError: the file cannot be read, or the robot has errors.
        InvalidInputError: a limit belongs to no joint, or the level does not exist.
    """
    file = Path(path)
    digest = sha256(read_bytes(file)).digest()
    by_hand = tuple((limits or {}).items())
    folders = tuple(Path(folder) for folder in package_dirs)
    return _load_by_content(file, file.absolute(), digest, by_hand, inertias, folders)


@lru_cache(maxsize=32)
def _load_by_content(
    file: Path,
    place: Path,
    digest: bytes,
    limits: Sequence[tuple[str, JointLimits]],
    inertias: Inertias,
    folders: Sequence[Path],
) -> Loaded:
    """Load and check a URDF; results are cached by all arguments, so once for each content.

    Args:
        file: the URDF.
        place: absolute path of the file, part of the cache's key.
        digest: hash of its content, part of the cache's key.
        limits: joint names or patterns with the limits that replace those of the file.
        inertias: level of the check of inertias.
        folders: folders in which its meshes are searched.
    """
    require_level(inertias)
    document = _read_and_check(file, folders)
    joint_names_moving = [joint.name for joint in document.joints.values() if joint.kind != "fixed"]
    for name, values in matching_limits(joint_names_moving, dict(limits)).items():
        document.joints[name].limits.update(values)
    check_limits(document)
    check_inertias(document, inertias)
    document.require()
    model = build_model(document)
    check_moving_bodies(document, model)
    document.require()
    check_mass_matrix(model, document)
    return Loaded(model, document)


def load_model(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
) -> pin.Model:
    """Build the fixed-base Pinocchio model of a URDF after checking that it can be controlled.

    Continuous joints become revolute joints without end stops (nq = nv = 1, limits ∓inf).

    Args:
        path: the URDF.
        limits: limits given by hand, by joint name or pattern ("finger*"), where the file has none
            or wrong ones.
        inertias: "possible" requires bodies that can exist; "positive" only a positive
            kinetic energy of the bodies that move (identified or rounded parameters).
        package_dirs: folders of the meshes, besides the URDF's own.

    Raises:
        ModelError: errors of the file, each with file, line, element, reason and cure; the list is
            in `ModelError.findings`.
        InvalidInputError: limits for joints that do not exist.
    """
    loaded = load(path, limits=limits, inertias=inertias, package_dirs=package_dirs)
    return loaded.model.copy()  # the loaded model is shared


def load_robot(
    path: Path | str, tip: str | None = None, package_dirs: Sequence[Path | str] = ()
) -> tuple[pin.Model, dict[str, str]]:
    """Load the model of a URDF or MJCF file, and its dependent joints.

    Args:
        path: the file.
        tip: body or site of an MJCF file, see `load_mjcf`.
        package_dirs: folders of the meshes of a URDF, see `load_model`.

    Returns:
        The model, and the name of the master of each joint that follows another joint by <mimic>
        or <equality>.

    Raises:
        ModelError: see `load_model` and `load_mjcf`.
    """
    if is_mjcf(path):
        mj = compile_mjcf(path)
        return (load_mjcf(mj, tip), couplings(mj))
    model, document = load(path, package_dirs=package_dirs)
    joints = document.joints.values()
    return (model.copy(), {joint.name: joint.mimic for joint in joints if joint.mimic is not None})


def load_body(path: Path | str) -> pin.Inertia:
    """Load the inertia of a single body from a URDF, in the frame of the file's root link.

    Args:
        path: the URDF.

    Raises:
        ModelError: an error of the file, see :func:`load_model`; or a joint moves; or not exactly
            one link has mass.
    """
    model, document = load(path)
    links = document.links.values()
    massive_links = [link.name for link in links if link.inertial and link.inertial.mass > 0]
    if model.nv > 0:
        joints = ", ".join(joint_names(model))
        raise ModelError(f"{path}: one rigid body is expected, but these joints move: {joints}")
    if len(massive_links) != 1:
        raise ModelError(
            f"{path}: exactly one link with mass is expected, found {len(massive_links)} "
            f"({', '.join(massive_links) or 'none'}); merge them into one <inertial>"
        )
    return pin.Inertia(model.inertias[0])


def load_geometry(
    path: Path | str, kind: pin.GeometryType, package_dirs: Sequence[Path | str] = ()
) -> tuple[pin.Model, pin.GeometryModel, Document]:
    """Load kinematics, shapes and document of a URDF, for drawing or collisions.

    Limits and inertias are not checked. Meshes are read from the URDF's folder and `package_dirs`
    only.

    Args:
        path: the URDF.
        kind: visual or collision shapes.
        package_dirs: folders of the meshes.

    Raises:
        ModelError: an error of the file other than limits and inertias, see :func:`load_model`; or
            a mesh cannot be read.
    """
    file = Path(path)
    folders = [Path(folder) for folder in package_dirs]
    document = _read_and_check(file, folders)
    if wrong := list(chain(*check_mesh_files(document, folders))):
        refuse(wrong)
    model = build_model(document)
    try:
        geometry = pin.buildGeomFromUrdf(
            model, str(file), kind, package_dirs=[str(f) for f in (*folders, file.parent)]
        )
    except (ValueError, RuntimeError) as error:
        refuse_file("mesh", file, f"Pinocchio cannot read the shapes: {error}")
    return (model, geometry, document)


def _read_and_check(file: Path, package_dirs: Sequence[Path]) -> Document:
    """Read a URDF, and check its words, numbers, tree and mesh addresses.

    Args:
        file: the URDF.
        package_dirs: further folders of meshes.

    Raises:
        ModelError: a check failed.
    """
    document = read_document(file, read_bytes(file))
    document.require()
    check_tree(document)
    document.require()
    check_mimics(document)
    check_geometry(document, package_dirs)
    document.require()
    return document


# Files of robots: packaged ones, those of the data package example-robot-data, own folders.


ROBOT_DATA = "example-robot-data"
_ROBOT = re.compile(r"[\w-]+")  #: name of a robot, without folder and suffix
_PACKAGE = Path(__file__).resolve().parent.parent


def urdf_path(name: str) -> Path:
    """Path of a URDF packaged with this library, such as ``"rod.urdf"`` (suffix optional).

    Raises:
        ModelError: no packaged file has that name.
    """
    file = _find_packaged(name)
    if file is None:
        raise ModelError(
            f"no packaged URDF is called {name!r}; {did_you_mean(name, _packaged_urdfs())}"
        )
    return file


def find_robot(name: str) -> tuple[Path, Path]:
    """URDF file and package folder of a robot of the data package ``example-robot-data``.

    Addresses of the form ``package://example-robot-data/...`` are resolved in the package folder.

    Args:
        name: a file name without suffix (``"panda"``, ``"ur5_gripper"``), a file name without
            suffix and ``_robot`` (``"ur5"``), a folder with a single robot (``"xarm"``) or, if two
            folders have files of the same name, ``"anymal_c_simple_description/anymal"``.

    Raises:
        ModelError: the data package is absent, or the name is unknown or ambiguous.
    """
    root = _robot_data_root()
    files = {f"{p.parent.parent.name}/{p.stem}": p for p in sorted(root.glob("*/*/*.urdf"))}
    # rules in the order of precedence: whether a file, by its key "folder/stem" and path, is meant
    rules = (
        lambda key, path: name in (key, path.stem),
        lambda key, path: path.stem == f"{name}_robot",
        lambda key, path: key.split("/")[0] in (f"{name}_description", f"{name}_data"),
    )
    for rule in rules:
        matches = [key for key, path in files.items() if rule(key, path)]
        if len(matches) == 1:
            return (files[matches[0]], root.parent.parent)
        if matches:
            raise ModelError(
                f"{name!r} is ambiguous in {ROBOT_DATA}: name one of {', '.join(matches)}"
            )
    stems = sorted({path.stem.removesuffix("_robot") for path in files.values()})
    hint = did_you_mean(name, stems, most=0)
    raise ModelError(
        f"{ROBOT_DATA} has no robot {name!r}; {hint + ' ' if hint else ''}its robots: "
        f"{', '.join(stems)}; packaged: {', '.join(_packaged_urdfs())}"
    )


def resolve_urdf(reference: str, relative_to: Path | None = None) -> tuple[Path, tuple[Path, ...]]:
    """Find the file and the package folders of a robot by a reference as in a scenario.

    Args:
        reference: the name of a packaged file (suffix optional), a path, or a robot of the data
            package: ``"panda"``, or ``"example-robot-data:panda"`` if a file has that name, too. A
            packaged name has priority over a file of the same name; write ``"./rod.urdf"`` for
            the latter.
        relative_to: folder to which a path is relative; None: the working folder.

    Raises:
        ModelError: nothing is found; the message names the places searched.
    """
    packaged_file = _find_packaged(reference)
    if packaged_file is not None:
        return (packaged_file, ())
    path = ((relative_to or Path.cwd()) / reference).resolve()
    if path.is_file():
        return (path, (path.parent,))
    name = reference.removeprefix(f"{ROBOT_DATA}:")
    if name != reference or _ROBOT.fullmatch(name):
        file, package_dir = find_robot(name)
        return (file, (package_dir,))
    raise ModelError(
        f"URDF {reference!r} is neither the file {path} nor packaged; a robot of the data package "
        f"is written '{ROBOT_DATA}:panda'; {did_you_mean(reference, _packaged_urdfs())}"
    )


def _find_packaged(name: str) -> Path | None:
    """Path of a packaged URDF by its name with or without suffix; None if no file has the name."""
    urdfs = _packaged_urdfs()
    return urdfs.get(name) or urdfs.get(f"{name}.urdf")


def _packaged_urdfs() -> dict[str, Path]:
    """Packaged URDFs by file name, from the installed package or the checkout."""
    places = (_PACKAGE / "urdf", _PACKAGE.parent / "urdf")
    return _urdfs_in(next((folder for folder in places if folder.is_dir()), places[0]))


@cache
def _urdfs_in(folder: Path) -> dict[str, Path]:
    """URDFs of a folder by file name."""
    return {path.name: path for path in sorted(folder.glob("*.urdf"))}


def _robot_data_root() -> Path:
    """Folder ``share/example-robot-data/robots`` of the data package.

    Raises:
        ModelError: the data package is not installed.
    """
    prefixes = [Path(pin.__file__).resolve().parents[4]]
    try:
        data = importlib.metadata.distribution(ROBOT_DATA)
        prefixes.insert(0, Path(str(data.locate_file("cmeel.prefix"))))
    except importlib.metadata.PackageNotFoundError:
        pass  # other package managers install the data in the folder of Pinocchio
    for prefix in prefixes:
        root = prefix / "share" / ROBOT_DATA / "robots"
        if root.is_dir():
            return root
    raise ModelError(f"the data package {ROBOT_DATA} is not installed: pip install {ROBOT_DATA}")
