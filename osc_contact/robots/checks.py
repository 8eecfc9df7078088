"""Checks of limits, inertias, shapes and meshes of a URDF, without which control is impossible."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal, get_args
from urllib.parse import unquote

import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError, did_you_mean
from osc_contact.robots.elements import Element, ModelFinding
from osc_contact.robots.model import joint_names
from osc_contact.robots.urdf import LIMITS, Document, Joint
from osc_contact.spatial import Array

# Limits -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint given by hand; None keeps the file's value.

    Attributes:
        lower, upper: positions in rad (revolute) or m (prismatic); ∓inf: no end stop.
        effort: largest |torque| in N m, or |force| in N.
        velocity: largest speed in rad/s or m/s.

    Raises:
        InvalidInputError: NaN; lower > upper; effort or velocity not finite or not > 0.
    """

    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None

    def __post_init__(self) -> None:
        """Refuse limits that are not positive and an empty range of positions."""
        for key in ("effort", "velocity"):
            value = getattr(self, key)
            if value is not None and not 0 < value < math.inf:
                raise InvalidInputError(f"JointLimits: {key} {value} must be finite and > 0")
        low = -math.inf if self.lower is None else self.lower
        high = math.inf if self.upper is None else self.upper
        if not low <= high or low == math.inf or high == -math.inf:
            raise InvalidInputError(f"JointLimits: no position lies in [{low}, {high}]")

    @classmethod
    def parse(cls, text: str) -> tuple[str, JointLimits]:
        """Parse a joint name or pattern and its limits.

        Args:
            text: text such as "joint1:effort=5,velocity=3".

        Returns:
            The name or pattern, and the limits.

        Raises:
            InvalidInputError: a text of another form, or impossible limits.
        """
        name, colon, assignments = text.rpartition(":")
        pairs = [part.partition("=") for part in assignments.split(",")]
        values = {key.strip(): value for key, _, value in pairs}
        if not colon or not values.keys() <= set(LIMITS):
            raise InvalidInputError(
                f"{text!r}: expected JOINT:key=number,… with the keys {', '.join(LIMITS)}"
            )
        try:
            return (name, cls(**{key: float(value) for key, value in values.items()}))
        except ValueError as error:
            raise InvalidInputError(f"{text!r}: {error}") from error


def matching_limits(
    names: Iterable[str], limits: Mapping[str, JointLimits]
) -> dict[str, dict[str, float]]:
    """Find the limits of each joint by the first key that is its name or matches it.

    Args:
        names: names of the moving joints.
        limits: limits by joint name or pattern ("finger*").

    Returns:
        For each joint name the limits that are not None, by "lower", "upper", "effort" and
        "velocity".

    Raises:
        InvalidInputError: a key that no moving joint matches.
    """
    moving_joints = list(names)
    by_joint: dict[str, dict[str, float]] = {}
    for key, joint_limits in reversed(list(limits.items())):  # earlier keys replace later ones
        matches = [name for name in moving_joints if name == key or fnmatchcase(name, key)]
        if not matches:
            raise InvalidInputError(
                f"limits: no moving joint matches {key!r}; {did_you_mean(key, moving_joints)}"
            )
        numbers = asdict(joint_limits)
        values = {limit: value for limit, value in numbers.items() if value is not None}
        by_joint |= dict.fromkeys(matches, values)
    return by_joint


def check_limits(document: Document) -> None:
    """Note missing limits, effort and velocity ≤ 0, and empty ranges (lower ≥ upper) as findings.

    A continuous joint needs effort and velocity; its positions are unbounded even if the file
    limits them.

    Args:
        document: document of the URDF.
    """
    for joint in document.joints.values():
        if joint.kind != "fixed":
            _check_limits_of(joint)


def _check_limits_of(joint: Joint) -> None:
    """Note missing or wrong limits of a joint that moves as findings of its element.

    Effort and velocity must be positive (N m or N, rad/s or m/s), and the lower position limit
    below the upper one; a continuous joint has no position limits.

    Args:
        joint: joint of any kind except "fixed".
    """
    by_hand = f", or give limits={{{joint.name!r}: JointLimits(…)}} when loading"
    element = joint.element.part("limit")
    limits = joint.limits
    required_keys = ("effort", "velocity") if joint.kind == "continuous" else LIMITS
    missing = [key for key in required_keys if key not in limits]
    # no <limit> at all is one finding; otherwise each missing attribute is one
    if element is joint.element and len(missing) == len(required_keys):
        keys = " ".join(f'{key}="…"' for key in required_keys)
        element.note("limit", "has no <limit>", f"add <limit {keys}/>{by_hand}")
        return
    for key in missing:
        reason = f"{key} is missing: a reader would take 0"
        element.note("limit", reason, f'write {key}="…"{by_hand}')
    # efforts and speeds must be positive, and positions a range
    units = ("N", "m/s") if joint.kind == "prismatic" else ("N m", "rad/s")
    for key, unit in zip(("effort", "velocity"), units, strict=True):
        if key in limits and not limits[key] > 0:
            reason = f"{key} limit {limits[key]:g} {unit} must be > 0"
            cure = f"write what the joint can bear, passive joints too{by_hand}"
            element.note("limit", reason, cure, key)
    low = limits.get("lower", -math.inf)
    high = limits.get("upper", math.inf)
    if joint.kind != "continuous" and low >= high:
        word = "is above" if low > high else "equals"
        cure = "exchange them" if low > high else 'make the joint fixed or "continuous"'
        reason = f"lower limit {low:g} {word} the upper limit {high:g}"
        element.note("limit", reason, f"{cure}{by_hand}", "lower")


# Inertias -----------------------------------------------------------------------------------------

Inertias = Literal["possible", "positive"]
"""Level of the check of inertias.

"possible": every link has the inertia of a possible body: mass ≥ 0, principal moments ≥ 0, none
larger than the sum of the others. "positive": only the kinetic energy of the moving bodies (links
joined by fixed joints taken together) must not be negative. Then the mass matrix is positive
definite, though no body need have such moments.
"""

_TENSOR_ELEMENTS = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")  # row by row
_RELATIVE_SLACK = 1e-6
"""Tolerance of a link's moments, relative to its largest one: files have rounded numbers."""
_ABSOLUTE_SLACK = 1e-12
"""Tolerance of a link's moments, relative to the largest one of the robot."""


def require_level(inertias: str) -> None:
    """Refuse an unknown level of the check of inertias.

    Raises:
        InvalidInputError: the level is none of `Inertias`.
    """
    levels = get_args(Inertias)
    if inertias not in levels:
        raise InvalidInputError(f"inertias={inertias!r}; there is: {', '.join(levels)}")


def _principal_moments(tensors: Sequence[Array] | Sequence[Sequence[float]]) -> tuple[Array, Array]:
    """Compute principal moments (k, 3), ascending, and tolerances (k,) of k inertias (kg m²).

    Args:
        tensors: k tensors, (3, 3) or (9,).
    """
    moments = np.linalg.eigvalsh(np.array(tensors).reshape(-1, 3, 3))
    sizes = np.abs(moments).max(axis=1, initial=0.0)
    return (moments, _RELATIVE_SLACK * sizes + _ABSOLUTE_SLACK * sizes.max(initial=0.0))


def check_inertias(document: Document, inertias: Inertias) -> None:
    """Note negative masses and, at the level "possible", inertias that no body can have.

    Args:
        document: document of the URDF, to whose findings errors are added.
        inertias: level.
    """
    bodies = [link.inertial for link in document.links.values() if link.inertial is not None]
    for body in bodies:
        if body.mass < 0:
            reason = f"mass {body.mass:g} kg is negative"
            body.element.part("mass").note("inertia", reason, "weigh the link", "value")
    if inertias == "positive":
        return
    # principal moments of all bodies at once; `slack` is the rounding error of those of a body
    tensors = [[body.moments[key] for key in _TENSOR_ELEMENTS] for body in bodies]
    for body, moments, slack in zip(bodies, *_principal_moments(tensors), strict=True):
        moments_text = f"principal moments {_moments_text(moments)} kg m²"
        # of a real body no moment exceeds the sum of the other two, as each is a sum of the squared
        # distances along two axes; moments are in ascending order
        excess = moments[2] - moments[0] - moments[1]
        if body.mass < 0:
            continue
        if body.mass == 0 and np.abs(moments).max() > slack:
            reason = f"mass 0 kg with {moments_text}"
            cure = "give it a mass"
        elif moments[0] < -slack:
            reason = f"the inertia is not positive: {moments_text}"
            cure = "check the signs of ixy, ixz, iyz"
        elif excess > slack:
            reason = (
                f"no body has the {moments_text}: the largest exceeds the sum of the others by "
                f"{excess:.3g}"
            )
            cure = "check the units (kg m², about the centre of mass)"
        else:
            continue
        relax = ', or load with inertias="positive" if the other links make up for it'
        body.element.part("inertia").note("inertia", reason, cure + relax)


def check_moving_bodies(document: Document, model: pin.Model) -> None:
    """Note moving bodies whose kinetic energy can be negative as findings.

    A moving body consists of all links that fixed joints connect.

    Args:
        document: document of the URDF.
        model: Pinocchio model of it.
    """
    bodies = list(model.inertias)[1:]
    rows = _principal_moments([body.inertia for body in bodies])
    for name, body, moments, slack in zip(joint_names(model), bodies, *rows, strict=True):
        if body.mass < 0 or moments[0] < -slack:
            reason = (
                f"the body that it moves has mass {body.mass:g} kg and principal moments "
                f"{_moments_text(moments)} kg m²: its energy can be negative"
            )
            document.joints[name].element.note(
                "inertia", reason, "correct the <inertial> of its links"
            )


def _moments_text(moments: Array) -> str:
    """Moments (3,) with four digits, for messages."""
    return ", ".join(f"{moment:.4g}" for moment in moments)


# Shapes and mesh addresses ------------------------------------------------------------------------

MESH_TYPES = (".stl", ".obj", ".dae")  #: suffixes of meshes that are read
MAX_MESH_BYTES = 256 * 2**20
#: attributes of a shape that are lengths
_SIZES = {"cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",)}
_TEXTURE = re.compile(rb"<init_from>\s*(?:<ref>)?\s*([^<]*?)\s*<")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")
_PACKAGE = "package://"


def check_geometry(document: Document, package_dirs: Sequence[Path]) -> None:
    """Note shapes without size, poses that are not numbers, and mesh addresses outside the folders.

    No mesh is opened. All addresses, ``package://name/...`` included, must be in the URDF's folder
    or in one of `package_dirs`.

    Args:
        document: document of the URDF.
        package_dirs: further folders of meshes.
    """
    for link in document.links.values():
        for part in link.element.findall("visual", "collision"):
            part.origin()  # notes numbers that are wrong
            shapes = [shape for geometry in part.findall("geometry") for shape in geometry.children]
            if len(shapes) != 1:
                part.note("geometry", f"<{part.tag}> needs one <geometry> with one shape")
            else:
                _check_shape(shapes[0], package_dirs)


def check_mesh_files(
    document: Document, package_dirs: Sequence[Path]
) -> tuple[list[ModelFinding], list[ModelFinding]]:
    """Check the mesh files of a robot.

    Unusable are links that lead outside of the robot's folders, files larger than
    `MAX_MESH_BYTES`, and Collada files with textures outside of these folders.

    Args:
        document: document of the URDF.
        package_dirs: further folders of meshes.

    Returns:
        Findings on unusable files, and findings on missing files.
    """
    meshes = {mesh.get("filename"): mesh for mesh in document.root.iter("mesh")}
    roots = _mesh_folders(document.file, package_dirs)
    unusable = []
    missing = []
    for mesh in meshes.values():
        places = _possible_files(mesh, roots)
        file = next((path for path in places if path.is_file()), None)
        if file is None:
            reason = f"the mesh is not there; looked for {', '.join(map(str, places))}"
            missing.append(mesh.finding("mesh", reason, "pass package_dirs", "filename"))
        elif problem := _file_problem(file, roots):
            unusable.append(mesh.finding("mesh", *problem, "filename"))
    return (unusable, missing)


def _file_problem(file: Path, roots: Sequence[Path]) -> tuple[str, str] | None:
    """Check a mesh file; return the reason and the cure of an unusable file, else None.

    Args:
        file: the file.
        roots: folders of the robot.
    """
    if not _is_in_folders(file, roots, os.path.realpath):
        return (f"leads to {file.resolve()}, outside of the robot's folders", "copy the file")
    size = file.stat().st_size
    if size > MAX_MESH_BYTES:
        limit = f"simplify it to at most {MAX_MESH_BYTES / 2**20:.0f} MiB"
        return (f"has {size / 2**20:.0f} MiB", limit)
    if file.suffix.lower() != ".dae":
        return None
    for address in _TEXTURE.findall(file.read_bytes()):
        texture = unquote(address.decode("utf-8", "replace"))
        if _SCHEME.match(texture) or not _is_in_folders(
            file.parent / texture, roots, os.path.realpath
        ):
            cure = "keep textures beside the mesh, or convert it to STL or OBJ"
            return (f"{file.name} takes a texture from {texture!r}", cure)
    return None


def _check_shape(shape: Element, package_dirs: Sequence[Path]) -> None:
    """Note an unknown shape, negative sizes, and a mesh address that cannot be used.

    Args:
        shape: child of a <geometry>.
        package_dirs: further folders of meshes.
    """
    if shape.tag == "mesh":
        shape.vector("scale", (1.0, 1.0, 1.0))
        if problem := _address_problem(shape, _mesh_folders(shape.file, package_dirs)):
            shape.note("mesh", *problem, "filename")
        return
    if shape.tag == "box":
        sizes = dict(zip("xyz", shape.vector("size"), strict=True))
    elif shape.tag in _SIZES:
        sizes = {key: shape.number(key) for key in _SIZES[shape.tag]}
    else:
        shape.note(
            "geometry", f"unknown shape <{shape.tag}>", "use box, cylinder, capsule, sphere or mesh"
        )
        return
    negative_sizes = ", ".join(f"{key} {size:g} m" for key, size in sizes.items() if size < 0)
    if negative_sizes:
        shape.note("geometry", f"negative size: {negative_sizes}", "sizes are lengths")


def _address_problem(mesh: Element, roots: Sequence[Path]) -> tuple[str, str] | None:
    """Check the address of a mesh; return reason and cure of an unusable address, else None.

    Args:
        mesh: the <mesh>.
        roots: folders of the robot.
    """
    address = mesh.get("filename")
    cure = "keep meshes below the URDF's folder, or pass the folder in package_dirs"
    suffix = os.path.splitext(address)[1].lower()
    scheme = _SCHEME.match(address)
    if not address:
        return ("a mesh without filename", 'write filename="…"')
    if suffix not in MESH_TYPES:
        reason = f"meshes of the type {suffix or 'without suffix'} are not read"
        return (reason, f"convert it to {', '.join(MESH_TYPES)}")
    if scheme and scheme[0] not in ("package:", "file:"):
        return (f"the address has the scheme {scheme[0]!r}: only local files are read", cure)
    if not all(
        _is_in_folders(place, roots, os.path.normpath) for place in _possible_files(mesh, roots)
    ):
        return ("the mesh lies outside of the robot's folders", cure)
    return None


def _possible_files(mesh: Element, roots: Sequence[Path]) -> list[Path]:
    """Possible files of a mesh: one in each folder for a package:// address, else a single file.

    Args:
        mesh: the <mesh>.
        roots: folders of the robot.
    """
    address = mesh.get("filename")
    path = address.removeprefix(_PACKAGE)
    if path != address:
        return [root / path.lstrip("/") for root in roots]
    return [mesh.file.absolute().parent / address.removeprefix("file://")]


def _mesh_folders(urdf: Path, package_dirs: Sequence[Path]) -> list[Path]:
    """Folders in which meshes may be: `package_dirs` and the folder of the file `urdf`."""
    return [folder.absolute() for folder in (*package_dirs, urdf.parent)]


def _is_in_folders(file: Path, roots: Sequence[Path], resolved: Callable[[Path], str]) -> bool:
    """Return whether a file is in one of the robot's folders.

    Args:
        file: path of the file.
        roots: folders of the robot.
        resolved: `os.path.realpath`, which follows links, or `os.path.normpath`.
    """
    return any(Path(resolved(file)).is_relative_to(resolved(root)) for root in roots)
