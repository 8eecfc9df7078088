"""Numbers of the packaged URDFs, read from their text by the standard library."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact import robots


def element(file, link):
    """A link of a file, or of a packaged file by its name."""
    path = file if isinstance(file, Path) else robots.urdf_path(file)
    found = ElementTree.parse(path).find(f"link[@name='{link}']")
    assert found is not None
    return found


def numbers(text):
    return np.array((text or "0 0 0").split(), dtype=float)


def placement(owner):
    origin = owner.find("origin")
    values = {} if origin is None else origin.attrib
    return pin.SE3(pin.rpy.rpyToMatrix(numbers(values.get("rpy"))), numbers(values.get("xyz")))


def written_inertia(link):
    inertial = link.find("inertial")
    assert inertial is not None
    mass = inertial.find("mass")
    tensor = inertial.find("inertia")
    assert mass is not None and tensor is not None
    xx, xy, xz, yy, yz, zz = (
        float(tensor.get(k, "nan")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    at_com = pin.Inertia(
        float(mass.get("value", "nan")),
        np.zeros(3),
        np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
    )
    return placement(inertial).act(at_com)
