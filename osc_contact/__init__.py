"""Dynamically decoupled force/motion control for any state of contact.

Names in reading order; `osc_contact.spatial` is the page of conventions.
"""

from typing import TYPE_CHECKING, Any

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.detection import detect
from osc_contact.contacts.pairs import (
    PAIRS,
    ConeInGroove,
    ContactPair,
    CylinderInHole,
    CylinderOnPlane,
    EdgeOnEdge,
    EdgeOnFace,
    FaceOnFace,
    FaceOnVertex,
    Fixed,
    Free,
    GapFunctions,
    Prismatic,
    Revolute,
    Screw,
    SphereOnPlane,
    VertexOnFace,
    register_pair,
)
from osc_contact.contacts.raibert_craig import RaibertCraig
from osc_contact.control.batch import BatchController
from osc_contact.control.controller import Controller, Gains, Status
from osc_contact.control.force import ForceGains
from osc_contact.control.laws import Laws
from osc_contact.control.motion import MotionGains
from osc_contact.control.safety import SafetySettings, SafetyState
from osc_contact.control.set_point import PoseSetPoint, SetPoint, SetPointState
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.dynamics.environment import Environment
from osc_contact.dynamics.grasp import Grasp
from osc_contact.dynamics.payload import RigidObject
from osc_contact.errors import (
    ContactError,
    Interrupted,
    InvalidInputError,
    ModelError,
    OscContactError,
    PlantError,
    RecordingError,
    ScenarioError,
    SolverError,
    ViewerError,
)
from osc_contact.interface import Measurement, Reference, Robot, pose_reference
from osc_contact.jerk_limits import JerkLimits
from osc_contact.plants.faces import Rail
from osc_contact.plants.judge import Judge
from osc_contact.plants.own_mujoco import MujocoRobot
from osc_contact.recorder import Recording
from osc_contact.response import ContactResponse, contact_response
from osc_contact.runs.faces import OwnMotion
from osc_contact.runs.loop import run_loop
from osc_contact.runs.metrics import metrics
from osc_contact.runs.plants import register_plant
from osc_contact.runs.preflight import Finding, preflight
from osc_contact.runs.recorder import Recorder
from osc_contact.runs.recovery import recover
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.runs.run import run
from osc_contact.runs.viewing import open_viewer
from osc_contact.scenarios import Scenario, list_scenarios, load_scenario
from osc_contact.visual.live import Viewer

if TYPE_CHECKING:
    from osc_contact.sweeps.sweep import sweep
    from osc_contact.sweeps.vector_env import make_vector_env

__version__ = "0.2.0"

__all__ = [
    "Arm",
    "RigidObject",
    "Grasp",
    "ClosedChain",
    "ChainState",
    "Contact",
    "RaibertCraig",
    "ContactPair",
    "VertexOnFace",
    "FaceOnVertex",
    "SphereOnPlane",
    "EdgeOnEdge",
    "EdgeOnFace",
    "CylinderOnPlane",
    "FaceOnFace",
    "CylinderInHole",
    "ConeInGroove",
    "Revolute",
    "Prismatic",
    "Screw",
    "Fixed",
    "Free",
    "GapFunctions",
    "register_pair",
    "detect",
    "Environment",
    "ContactResponse",
    "contact_response",
    "Controller",
    "BatchController",
    "Gains",
    "MotionGains",
    "ForceGains",
    "Laws",
    "Status",
    "SafetySettings",
    "SafetyState",
    "Measurement",
    "Reference",
    "pose_reference",
    "SetPoint",
    "SetPointState",
    "PoseSetPoint",
    "JerkLimits",
    "load_scenario",
    "list_scenarios",
    "register_plant",
    "Scenario",
    "OwnMotion",
    "Rail",
    "Rig",
    "build_rig",
    "preflight",
    "Finding",
    "run",
    "Robot",
    "Judge",
    "run_loop",
    "Recorder",
    "open_viewer",
    "Viewer",
    "MujocoRobot",
    "Recording",
    "recover",
    "metrics",
    "sweep",
    "make_vector_env",
    "OscContactError",
    "InvalidInputError",
    "ModelError",
    "ContactError",
    "ScenarioError",
    "SolverError",
    "PlantError",
    "RecordingError",
    "ViewerError",
    "Interrupted",
]

# Contact pairs that registered themselves, beyond those that type checkers know by name.
globals().update(PAIRS)
_end = __all__.index("GapFunctions") + 1
__all__[_end:_end] = [name for name in PAIRS if name not in __all__]

#: Names whose modules few programs need.
_LATER = {
    "sweep": "osc_contact.sweeps.sweep",
    "make_vector_env": "osc_contact.sweeps.vector_env",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_LATER[name]), name)
