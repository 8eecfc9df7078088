"""Shapes and mesh addresses: sizes that exist, files that stay inside the robot's folders."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from osc_contact.robots.attributes import number, vector
from osc_contact.robots.document import Document
from osc_contact.robots.findings import ModelFinding
from osc_contact.robots.xml_tree import Element

__all__ = ["MESH_TYPES", "check_geometry", "check_mesh_files"]

MESH_TYPES = (".stl", ".obj", ".dae")
MAX_MESH_BYTES = 256 * 2**20
_SIZES = {"cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",)}
_TEXTURE = re.compile(rb"<init_from>\s*(?:<ref>)?\s*([^<]*?)\s*<")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")


def check_geometry(document: Document, package_dirs: Sequence[Path]) -> None:
    """Note shapes without size, poses that are no numbers, and mesh addresses that lead outside.

    No mesh is opened. ``package://name/...`` and paths relative to the URDF must stay below the
    package and the URDF's folder; absolute paths must lie in that folder or in `package_dirs`.
    """
    for link in document.links.values():
        for part in link.element.children:
            if part.tag not in ("visual", "collision"):
                continue
            origin, shape = part.find("origin"), part.find("geometry")
            if origin is not None:
                for key in ("xyz", "rpy"):
                    vector(document, origin, key, (0.0, 0.0, 0.0))
            if shape is None or len(shape.children) != 1:
                document.add("geometry", part, f"<{part.tag}> needs one <geometry> with one shape")
                continue
            _check_shape(document, shape.children[0], package_dirs)


def check_mesh_files(document: Document, package_dirs: Sequence[Path]) -> list[ModelFinding]:
    """Note mesh files that lead outside through a link, are huge, or are Collada files whose
    textures lie elsewhere. Returns, without noting them, those that are not there."""
    addresses: dict[str, Element] = {}
    for mesh in document.root.iter("mesh"):
        addresses.setdefault(mesh.get("filename") or "", mesh)
    missing = []
    for address, mesh in addresses.items():
        places = _places(document, address, package_dirs)
        file = next((path for path in places if path.is_file()), None)
        if file is None:
            looked = f"the mesh is not there; looked for {', '.join(map(str, places)) or 'nothing'}"
            place = (document.file, mesh.line, mesh.column, mesh.label("filename"))
            missing.append(ModelFinding("mesh", *place, looked, "pass package_dirs"))
        elif problem := _file_problem(file, _roots(document, package_dirs)):
            document.add("mesh", mesh, *problem, "filename")
    return missing


def _file_problem(file: Path, roots: Sequence[Path]) -> tuple[str, str] | None:
    """(what is wrong with a mesh file, cure)."""
    real = file.resolve()
    if not _inside(real, [root.resolve() for root in roots]):
        return f"leads to {real}, outside of the robot's folders", "copy the file"
    size = real.stat().st_size
    if size > MAX_MESH_BYTES:
        limit = MAX_MESH_BYTES // 2**20
        return f"has {size / 2**20:.0f} MiB", f"simplify it to at most {limit} MiB"
    for found in _TEXTURE.findall(real.read_bytes()) if file.suffix.lower() == ".dae" else ():
        texture = unquote(found.decode("utf-8", "replace"))
        if _leads_out(texture):
            return (
                f"{file.name} takes a texture from {texture!r}",
                "keep textures beside the mesh, or convert it to STL or OBJ",
            )
    return None


def _check_shape(document: Document, shape: Element, package_dirs: Sequence[Path]) -> None:
    if shape.tag == "mesh":
        vector(document, shape, "scale", (1.0, 1.0, 1.0))
        problem, cure = _address_problem(document, shape.get("filename") or "", package_dirs)
        if problem:
            document.add("mesh", shape, problem, cure, "filename")
        return
    if shape.tag == "box":
        sizes = dict(zip(("x", "y", "z"), vector(document, shape, "size", None), strict=True))
    elif shape.tag in _SIZES:
        sizes = {key: number(document, shape, key) for key in _SIZES[shape.tag]}
    else:
        document.add("geometry", shape, f"unknown shape <{shape.tag}>",
                     "use box, cylinder, capsule, sphere or mesh")  # fmt: skip
        return
    negative = {key: size for key, size in sizes.items() if size < 0}
    if negative:
        listed = ", ".join(f"{key} {size:g} m" for key, size in negative.items())
        document.add("geometry", shape, f"negative size: {listed}", "sizes are lengths")


def _address_problem(
    document: Document, address: str, package_dirs: Sequence[Path]
) -> tuple[str, str]:
    """(what is wrong with a mesh address, cure), both empty for a good one."""
    cure = "keep meshes below the URDF's folder, or pass the folder in package_dirs"
    suffix = os.path.splitext(address)[1].lower()
    if not address:
        return "a mesh without filename", 'write filename="…"'
    if suffix not in MESH_TYPES:
        return (f"meshes of the type {suffix or 'without suffix'} are not read",
                f"convert it to {', '.join(MESH_TYPES)}")  # fmt: skip
    scheme = _SCHEME.match(address)
    if scheme and scheme[0] not in ("package:", "file:"):
        return f"the address has the scheme {scheme[0]!r}: only local files are read", cure
    if address.startswith("package://"):
        inside = address.removeprefix("package://").lstrip("/")
        package, slash, rest = inside.partition("/")
        if package in ("", ".", "..") or not slash or _leads_out(rest):
            return "the address leads out of its package", cure
        return "", ""
    roots = [Path(os.path.normpath(root)) for root in _roots(document, package_dirs)]
    place = Path(os.path.normpath(_plain(document, address)))
    return ("", "") if _inside(place, roots) else ("the mesh lies outside of the robot's folders",
                                                   cure)  # fmt: skip


def _places(document: Document, address: str, package_dirs: Sequence[Path]) -> list[Path]:
    if address.startswith("package://"):
        return [Path(folder) / address.removeprefix("package://") for folder in package_dirs]
    return [_plain(document, address)]


def _plain(document: Document, address: str) -> Path:
    return document.file.absolute().parent / address.removeprefix("file://")


def _roots(document: Document, package_dirs: Sequence[Path]) -> list[Path]:
    return [document.file.absolute().parent, *(Path(d).absolute() for d in package_dirs)]


def _inside(place: Path, roots: Sequence[Path]) -> bool:
    return any(place.is_relative_to(root) for root in roots)


def _leads_out(path: str) -> bool:
    """Whether a relative path climbs out of where it starts (or is absolute or an address)."""
    plain = path.replace("\\", "/")
    return bool(
        plain.startswith("/")
        or _SCHEME.match(plain)
        or os.path.normpath(plain).split("/")[0] == ".."
    )
