"""Numbers of robots: from texts of URDFs by the standard library, and from MuJoCo's models."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from osc_contact import robots


def mass_matrix(model, data):
    """Mass matrix (nv, nv) by MuJoCo at the positions in `data`."""
    M = np.zeros((model.nv, model.nv))
    for row, unit in zip(M, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return M


def element(name, link):
    """Element of a link in a URDF, given by its path or by the name of a packaged file."""
    path = name if isinstance(name, Path) else robots.urdf_path(name)
    return ElementTree.parse(path).find(f"link[@name='{link}']")


def numbers(text):
    """Array of the numbers in a text; three zeros without a text."""
    return np.array((text or "0 0 0").split(), dtype=float)


def placement(owner):
    """Pose of the <origin> of an element; the identity without it."""
    origin = owner.find("origin")
    values = {} if origin is None else origin.attrib
    return pin.SE3(pin.rpy.rpyToMatrix(numbers(values.get("rpy"))), numbers(values.get("xyz")))


def written_inertia(link):
    """Inertia of a link in the link's frame, as the file has it."""
    inertial = link.find("inertial")
    tensor = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        float(tensor.get(f"i{axes}")) for axes in ["xx", "xy", "xz", "yy", "yz", "zz"]
    )
    I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass = float(inertial.find("mass").get("value"))
    return placement(inertial).act(pin.Inertia(mass, np.zeros(3), I))
