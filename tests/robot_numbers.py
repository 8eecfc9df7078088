"""Numbers of robots: of URDFs, read from their text by the standard library; of MuJoCo's models."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from osc_contact import robots


def mass_matrix(model, data):
    """MuJoCo's own."""
    M = np.zeros((model.nv, model.nv))
    for row, unit in zip(M, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return M


def element(name, link):
    """A link of a file, or of a packaged file by its name."""
    path = name if isinstance(name, Path) else robots.urdf_path(name)
    return ElementTree.parse(path).find(f"link[@name='{link}']")


def numbers(text):
    return np.array((text or "0 0 0").split(), dtype=float)


def placement(owner):
    origin = owner.find("origin")
    values = {} if origin is None else origin.attrib
    return pin.SE3(pin.rpy.rpyToMatrix(numbers(values.get("rpy"))), numbers(values.get("xyz")))


def written_inertia(link):
    inertial = link.find("inertial")
    tensor = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        float(tensor.get(f"i{axes}")) for axes in ["xx", "xy", "xz", "yy", "yz", "zz"]
    )
    I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass = float(inertial.find("mass").get("value"))
    return placement(inertial).act(pin.Inertia(mass, np.zeros(3), I))
