"""URDF in, checked Pinocchio model out; every file is judged before Pinocchio sees it."""

import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
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
from osc_contact.robots.mjcf import compile_mjcf, couplings, is_mjcf, load_mjcf
from osc_contact.robots.model import (
    build_model,
    check_mass_matrix,
    frame_id,
    joint_names,
    random_configurations,
)
from osc_contact.robots.urdf import (
    Document,
    check_mimics,
    check_tree,
    read_bytes,
    read_document,
    refuse_file,
)

CROSS_CHECK_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Loaded:
    """A robot that passed: its model and the contents of the file.

    Attributes:
        model: Pinocchio model. document: links and joints as written.
        package_dirs: folders of its meshes.
    """

    model: pin.Model
    document: Document
    package_dirs: tuple[Path, ...] = ()


def load(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
) -> Loaded:
    """As `load_model`, with the document beside the model.

    Args:
        path: of the URDF. limits, inertias, package_dirs: see `load_model`.
    """
    require_level(inertias)
    folders = tuple(Path(folder) for folder in package_dirs)
    document = _sound(Path(path), folders)
    moving = [joint.name for joint in document.joints.values() if joint.kind != "fixed"]
    for name, given in matching_limits(moving, limits or {}).items():
        document.joints[name].limits.update(given)
    check_limits(document)
    check_inertias(document, inertias)
    document.require()
    model = build_model(document)
    check_moving_bodies(document, model)
    document.require()
    check_mass_matrix(model, document)
    return Loaded(model, document, folders)


def load_model(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
) -> pin.Model:
    """Build the fixed-base Pinocchio model of a URDF after checking that it can be controlled.

    Continuous joints become revolute ones without end stops (nq = nv = 1, limits ∓inf).

    Args:
        path: the URDF.
        limits: limits given by hand, by joint name or pattern ("finger*"), where the file has none
            or wrong ones.
        inertias: "possible" requires bodies that can exist; "positive" only a positive
            kinetic energy of the bodies that move (identified or rounded parameters).
        package_dirs: folders of the meshes, besides the URDF's own.

    Raises:
        ModelError: what is wrong, each with file, line, element, reason and cure; the list is in
            `ModelError.findings`.
        InvalidInputError: limits for joints that do not exist.
    """
    if not limits and not package_dirs:
        return _judged(Path(path), inertias).model.copy()
    return load(path, limits=limits, inertias=inertias, package_dirs=package_dirs).model


def load_robot(
    path: Path | str, tip: str | None = None, package_dirs: Sequence[Path | str] = ()
) -> pin.Model:
    """The model of a URDF or of an MJCF file, whichever it is.

    Args:
        path: the file. tip: of MJCF, see `load_mjcf`. package_dirs: of a URDF, see `load_model`.

    Raises:
        ModelError: see there.
    """
    return load_mjcf(path, tip) if is_mjcf(path) else load_model(path, package_dirs=package_dirs)


def load_coupled(path: Path | str, tip: str) -> tuple[pin.Model, dict[str, str]]:
    """As `load_robot`, and which joints follow others by <mimic> or <equality>, with their masters.

    Raises:
        ModelError: see there.
    """
    if is_mjcf(path):
        mj = compile_mjcf(path)
        return load_mjcf(mj, tip), couplings(mj)
    loaded = _judged(Path(path), "possible")
    joints = loaded.document.joints.values()
    followed = {joint.name: joint.mimic for joint in joints if joint.mimic is not None}
    return loaded.model.copy(), followed


def load_body(path: Path | str) -> pin.Inertia:
    """Inertia of the single body of a URDF, expressed in the frame of the file's root link.

    Raises:
        ModelError: as :func:`load_model`; or a joint moves; or not exactly one link has mass.
    """
    file = Path(path)
    loaded = _judged(file, "possible")
    links = loaded.document.links.values()
    heavy = [link.name for link in links if link.inertial and link.inertial.mass > 0]
    if loaded.model.nv > 0:
        moving = ", ".join(joint_names(loaded.model))
        raise ModelError(f"{file}: one rigid body is expected, but these joints move: {moving}")
    if len(heavy) != 1:
        raise ModelError(
            f"{file}: exactly one link with mass is expected, found {len(heavy)} "
            f"({', '.join(heavy) or 'none'}); merge them into one <inertial>"
        )
    return pin.Inertia(loaded.model.inertias[0])


def load_geometry(
    path: Path | str, kind: pin.GeometryType, package_dirs: Sequence[Path | str] = ()
) -> tuple[pin.Model, pin.GeometryModel, Document]:
    """(kinematics, shapes, document) of a URDF for drawing or collision; dynamics is not judged.

    Meshes are read from the URDF's folder and `package_dirs` only.

    Args:
        path: of the URDF. kind: visual or collision. package_dirs: folders of its meshes.

    Raises:
        ModelError: as :func:`load_model` but for limits and inertias; or a mesh cannot be read.
    """
    file = Path(path)
    folders = [Path(folder) for folder in package_dirs]
    document = _sound(file, folders)
    document.root.findings.extend(check_mesh_files(document, folders))
    document.require()
    model = build_model(document)
    try:
        geometry = pin.buildGeomFromUrdf(
            model, str(file), kind, package_dirs=[str(f) for f in (*folders, file.parent)]
        )
    except (ValueError, RuntimeError) as error:
        refuse_file("mesh", file, f"Pinocchio cannot read the shapes: {error}")
    return model, geometry, document


def cross_check(path: Path | str) -> float:
    """Largest difference of all link placements between Pinocchio and a second URDF reader.

    Neutral and five seeded random configurations; the entries of the 4×4 placements are compared
    (rotations without unit, translations in m). Mimic joints follow their master in both.

    Raises:
        ModelError: the file is not sound; or the difference exceeds 1e-9, with link and size.
    """
    file = Path(path)
    return compare(build_model(_sound(file, ())), file)


def compare(model: pin.Model, file: Path) -> float:
    """Largest difference of a link placement between the model and yourdfpy, see `cross_check`.

    Raises:
        ModelError: yourdfpy fails, or the difference exceeds 1e-9, with link and size.
    """
    import yourdfpy

    try:
        other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
        worst, link = _difference(model, other)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        refuse_file(
            "second reader",
            file,
            f"the second reader (yourdfpy) fails: {type(error).__name__}: {error}",
        )
    if not worst <= CROSS_CHECK_TOLERANCE:
        reason = f"link {link!r}: two URDF readers place link {link!r} {worst:.3g} apart "
        refuse_file(
            "second reader",
            file,
            f"{reason}(allowed {CROSS_CHECK_TOLERANCE:g})",
            "look at the origins and axes of the joints above it",
        )
    return worst


def _difference(model: pin.Model, other: Any) -> tuple[float, str]:
    """The largest difference between both readers, and the link that has it."""
    data = model.createData()
    root = other.base_link
    names = joint_names(model)
    worst = 0.0
    where = root
    for q in (pin.neutral(model), *random_configurations(model, 5)):
        joints = dict(zip(names, q, strict=True))
        for name in names:
            if mimic := other.joint_map[name].mimic:
                joints[name] = mimic.multiplier * joints[mimic.joint] + mimic.offset
        if joints:
            other.update_cfg({name: joints[name] for name in other.actuated_joint_names})
        pin.framesForwardKinematics(model, data, np.array(list(joints.values())))
        X_WR = data.oMf[frame_id(model, root)]
        for link in other.link_map:
            ours = X_WR.actInv(data.oMf[frame_id(model, link)]).homogeneous
            difference = float(np.abs(ours - other.get_transform(link, root)).max())
            if not difference <= worst:
                worst = difference
                where = link
    return worst, where


def _judged(file: Path, inertias: Inertias) -> Loaded:
    """As `load`; a file with the bytes of one that passed is not judged again.

    Studies build thousands of rigs from the same files. Nobody may change what is returned.
    """
    return _loaded(file, file.absolute(), sha256(read_bytes(file)).digest(), inertias)


@lru_cache(maxsize=32)
def _loaded(file: Path, place: Path, digest: bytes, inertias: Inertias) -> Loaded:
    return load(file, inertias=inertias)


def _sound(file: Path, package_dirs: Sequence[Path]) -> Document:
    """Words, numbers, tree and addresses are checked; limits and inertias are not yet."""
    document = read_document(file, read_bytes(file))
    document.require()
    check_tree(document)
    document.require()
    check_mimics(document)
    check_geometry(document, package_dirs)
    document.require()
    return document


# Where robots come from: packaged files, the data package example-robot-data, own folders.


ROBOT_DATA = "example-robot-data"
_PACKAGE = Path(__file__).resolve().parent.parent


def urdf_path(name: str) -> Path:
    """Path of a URDF packaged with this library, such as ``"rod.urdf"`` (suffix optional).

    Raises:
        ModelError: no packaged file has that name.
    """
    file = _find_packaged(name)
    if file is None:
        raise ModelError(f"no packaged URDF is called {name!r}; {did_you_mean(name, _packaged())}")
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
    raise ModelError(f"{ROBOT_DATA} has no robot {name!r}; {did_you_mean(name, sorted(stems))}")


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
        f"is written '{ROBOT_DATA}:panda'; {did_you_mean(reference, packaged)}"
    )


def locate(reference: str) -> tuple[Path, tuple[Path, ...]]:
    """As `resolve_urdf`, for people: a file, a packaged name, or a robot's name as it is ("panda").

    Raises:
        ModelError: nothing is found; the message names the places searched.
    """
    plain = "/" not in reference and "\\" not in reference and not Path(reference).is_file()
    if plain and (file := _find_packaged(reference)):
        return file, ()
    if plain and ":" not in reference and not reference.endswith((".urdf", ".xml")):
        path, package_dir = find_robot(reference)
        return path, (package_dir,)
    return resolve_urdf(reference)


def _find_packaged(name: str) -> Path | None:
    packaged = _packaged()
    return packaged.get(name) or packaged.get(f"{name}.urdf")


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
