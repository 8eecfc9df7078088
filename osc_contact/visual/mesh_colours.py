"""Colours of a COLLADA mesh, which readers of collision libraries leave out."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["triangle_colours", "vertex_colours"]

Array = NDArray[np.float64]
SPACE = {"c": "http://www.collada.org/2005/11/COLLADASchema"}
GROUPS = ("triangles", "polylist", "polygons")
LOST_SHARE = 0.005
"""Readers drop triangles without area: a few may be missing."""


def vertex_colours(
    file: str | Path, triangles: NDArray[np.integer], vertices: int
) -> NDArray[np.float32] | None:
    """(vertices, 3) colours in 0..1 of a mesh as it was read, None if its file has none.

    Args:
        file: of the mesh.
        triangles: (k, 3) indices, in the order of the file.
        vertices: how many there are.
    """
    of_triangles = triangle_colours(file, len(triangles))
    if of_triangles is None:
        return None
    colours = np.ones((vertices, 3), dtype=np.float32)
    colours[np.asarray(triangles)] = of_triangles[:, None, :]
    return colours


def triangle_colours(file: str | Path, count: int) -> Array | None:
    """(count, 3) colours in 0..1, None if the file is no COLLADA or has no colours.

    White is drawn at 0.88 and black at 0.14: their shapes are seen by light and shade.
    """
    if Path(file).suffix.lower() != ".dae":
        return None
    try:
        root = ET.parse(file).getroot()
        groups = [(colour, size) for colour, size in _groups(root) if size]
    except (OSError, ET.ParseError, ValueError):
        return None
    total = sum(size for _, size in groups)
    if not total or abs(total - count) > LOST_SHARE * total:
        return None
    colours = np.vstack([np.tile(colour, (size, 1)) for colour, size in groups])
    places = np.linspace(0, total - 1, count).round().astype(int)
    return 0.14 + 0.74 * np.clip(colours[places], 0.0, 1.0)


def _groups(root: ET.Element) -> Iterator[tuple[list[float], int]]:
    """Colour and number of the triangles of one material, as the file shows them."""
    geometries = {g.get("id"): g for g in root.findall(".//c:geometry", SPACE)}
    for instance in root.findall(".//c:visual_scene//c:instance_geometry", SPACE):
        bound = {
            one.get("symbol"): one.get("target", "")[1:]
            for one in instance.findall(".//c:instance_material", SPACE)
        }
        mesh = geometries[instance.get("url", "")[1:]].find("c:mesh", SPACE)
        for part in mesh if mesh is not None else ():
            if part.tag.split("}")[-1] in GROUPS:
                yield _colour(root, bound.get(part.get("material"), "")), int(part.get("count", 0))


def _colour(root: ET.Element, material: str) -> list[float]:
    """Diffuse colour of a material."""
    effect = root.find(f".//c:material[@id='{material}']/c:instance_effect", SPACE)
    url = "" if effect is None else effect.get("url", "")[1:]
    diffuse = root.findtext(f".//c:effect[@id='{url}']//c:diffuse/c:color", None, SPACE)
    return [float(word) for word in diffuse.split()[:3]] if diffuse else [0.8, 0.8, 0.8]
