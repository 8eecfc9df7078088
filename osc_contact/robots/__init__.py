"""Robots: the files of their models, and the checks before a model is used.

A URDF passes, in this order: strict XML with line numbers (`elements`), words, numbers and tree
(`urdf`), shapes and mesh addresses, limits, inertias (`checks`), Pinocchio and its mass matrix
(`model`). docs/robots.md: refusals and reasons.
"""

from osc_contact.robots.checks import Inertias, JointLimits
from osc_contact.robots.elements import ModelFinding
from osc_contact.robots.loading import (
    ROBOT_DATA,
    Loaded,
    find_robot,
    load,
    load_body,
    load_geometry,
    load_model,
    load_robot,
    resolve_urdf,
    urdf_path,
)
from osc_contact.robots.mjcf import compile_mjcf, couplings, is_mjcf, load_mjcf
from osc_contact.robots.model import check_mass_matrix, ends_of, frame_id, random_configurations
from osc_contact.robots.summary import RobotReport, RobotSummary, check_robot, summarise

__all__ = [
    "ROBOT_DATA",
    "urdf_path",
    "find_robot",
    "resolve_urdf",
    "load_model",
    "load_robot",
    "load_mjcf",
    "compile_mjcf",
    "couplings",
    "is_mjcf",
    "load_body",
    "load_geometry",
    "load",
    "Loaded",
    "JointLimits",
    "Inertias",
    "ModelFinding",
    "frame_id",
    "ends_of",
    "random_configurations",
    "check_mass_matrix",
    "check_robot",
    "RobotReport",
    "summarise",
    "RobotSummary",
]
