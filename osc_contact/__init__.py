"""Dynamically decoupled force/motion control for any state of contact.

Names in reading order; `osc_contact.spatial` is the page of conventions. Examples of classes begin
with `import osc_contact as osc`, `import numpy as np` and `import pinocchio as pin`.
"""

import ast
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from osc_contact.moved import find_moved_modules

if TYPE_CHECKING:  # each is imported on first access, see __getattr__
    from osc_contact.contacts.contact import Contact
    from osc_contact.contacts.detection.detect import detect
    from osc_contact.contacts.insertion import Hole, Peg, pairs_between
    from osc_contact.contacts.pairs import ContactPair, register_pair
    from osc_contact.contacts.pairs.functions import CompiledPair, GapFunctions
    from osc_contact.contacts.pairs.points_on_planes import (
        CylinderInHole,
        CylinderInVGroove,
        CylinderOnPlane,
        EdgeOnFace,
        FaceOnFace,
        SphereOnPlane,
        VertexOnFace,
    )
    from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
    from osc_contact.contacts.pairs.tangent_pair import (
        ConeInGroove,
        Fixed,
        Free,
        Prismatic,
        Revolute,
        Screw,
    )
    from osc_contact.contacts.pairs.vertex_and_edge import EdgeOnEdge, FaceOnVertex
    from osc_contact.contacts.raibert_craig import RaibertCraig
    from osc_contact.contacts.surface import Surface
    from osc_contact.control.batch import BatchController
    from osc_contact.control.controller import Controller
    from osc_contact.control.custom_laws import Laws, admittance, impedance
    from osc_contact.control.goals import GoalFollower
    from osc_contact.control.set_point import PoseSetPoint, SetPoint, SetPointState
    from osc_contact.control.status import SafetyState, Status
    from osc_contact.dynamics.arm import Arm
    from osc_contact.dynamics.chain_state import ChainState, RigidObject
    from osc_contact.dynamics.closed_chain import ClosedChain
    from osc_contact.dynamics.environment import Environment, Rail
    from osc_contact.dynamics.grasp import Grasp
    from osc_contact.dynamics.learned_friction import LearnedFriction
    from osc_contact.dynamics.operational_space import OperationalSpace, operational_space
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
    from osc_contact.interface import Measurement, Reference, Robot, Stamps, pose_reference
    from osc_contact.jerk_limits import JerkLimits
    from osc_contact.lab.checks.preflight import preflight
    from osc_contact.lab.plants.mujoco_arm import MujocoArm
    from osc_contact.lab.plants.own_mujoco import MujocoRobot
    from osc_contact.lab.reports.viewing import open_viewer
    from osc_contact.lab.rig.contacts import OwnMotion
    from osc_contact.lab.rig.references import surface_references
    from osc_contact.lab.rig.rig import Rig, build_rig, register_plant
    from osc_contact.lab.runs.recovery import recover
    from osc_contact.lab.runs.run import run
    from osc_contact.lab.runs.verdict import metrics
    from osc_contact.lab.scenarios.loader import list_scenarios, load_scenario
    from osc_contact.lab.scenarios.schema import Scenario
    from osc_contact.lab.sweeps.sweep import sweep
    from osc_contact.lab.sweeps.vector_env import make_vector_env
    from osc_contact.lab.visual.live import Viewer
    from osc_contact.loop.judge import Judge
    from osc_contact.loop.loop import run_loop
    from osc_contact.loop.recorder import Recorder
    from osc_contact.loop.rules import Finding
    from osc_contact.loop.stepped import SteppedLoop
    from osc_contact.plan.plan import Plan
    from osc_contact.plan.stage import Stage, StageVerdict
    from osc_contact.recognition.place import LearnedPlace
    from osc_contact.recognition.recogniser import Recogniser, over_recording
    from osc_contact.recognition.states import ContactStates, WrenchErrors
    from osc_contact.recorder import Recording
    from osc_contact.response import ContactResponse, contact_response
    from osc_contact.settings.control import Friction, JointFriction, PhaseSettings, SafetySettings
    from osc_contact.settings.gains import ForceGains, Gains, MotionGains

find_moved_modules()

__version__ = "0.2.0"

__all__ = [
    "load_scenario",
    "run",
    "metrics",
    "Recording",
    "list_scenarios",
    "Scenario",
    "preflight",
    "Finding",
    "recover",
    "sweep",
    "make_vector_env",
    "Robot",
    "run_loop",
    "SteppedLoop",
    "surface_references",
    "MujocoRobot",
    "MujocoArm",
    "Recorder",
    "Judge",
    "open_viewer",
    "Viewer",
    "build_rig",
    "Rig",
    "OwnMotion",
    "Rail",
    "register_plant",
    "Controller",
    "BatchController",
    "Gains",
    "MotionGains",
    "ForceGains",
    "PhaseSettings",
    "Friction",
    "JointFriction",
    "Laws",
    "Status",
    "SafetySettings",
    "SafetyState",
    "Measurement",
    "Stamps",
    "Reference",
    "pose_reference",
    "SetPoint",
    "SetPointState",
    "PoseSetPoint",
    "GoalFollower",
    "JerkLimits",
    "impedance",
    "admittance",
    "Plan",
    "Stage",
    "StageVerdict",
    "ContactStates",
    "WrenchErrors",
    "Recogniser",
    "over_recording",
    "LearnedPlace",
    "ContactPair",
    "VertexOnFace",
    "FaceOnVertex",
    "SphereOnPlane",
    "SphereOnSurface",
    "EdgeOnEdge",
    "EdgeOnFace",
    "CylinderOnPlane",
    "FaceOnFace",
    "CylinderInHole",
    "CylinderInVGroove",
    "ConeInGroove",
    "Revolute",
    "Prismatic",
    "Screw",
    "Fixed",
    "Free",
    "GapFunctions",
    "CompiledPair",
    "register_pair",
    "Surface",
    "detect",
    "Peg",
    "Hole",
    "pairs_between",
    "Contact",
    "RaibertCraig",
    "Arm",
    "RigidObject",
    "Grasp",
    "ClosedChain",
    "ChainState",
    "LearnedFriction",
    "operational_space",
    "OperationalSpace",
    "Environment",
    "ContactResponse",
    "contact_response",
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


@cache
def _module_of_each_name() -> dict[str, str]:
    """Map every public name to its module, by the imports above, which only type checkers run."""
    source = __spec__.loader.get_source(__name__)  # type: ignore[union-attr]
    block = next(node for node in ast.parse(source).body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {name.name: str(node.module) for node in imports for name in node.names}


def _import_public_name(name: str) -> Any:
    """Import a public name from its module; return the object.

    Raises:
        ModuleNotFoundError: the module needs a package; the message names its extra.
    """
    try:
        return getattr(import_module(_module_of_each_name()[name]), name)
    except ModuleNotFoundError as error:
        from osc_contact.errors import missing

        if words := missing(error):
            raise ModuleNotFoundError(f"osc_contact.{name}: {words}", name=error.name) from error
        raise


def __getattr__(name: str) -> Any:
    """Import a public name, a module, or a contact pair on first access, and keep it.

    Raises:
        AttributeError: there is no such name.
    """
    if name in _module_of_each_name():
        value = _import_public_name(name)
    elif find_spec(f"{__name__}.{name}"):
        return import_module(f"{__name__}.{name}")
    elif name[0].isupper() and hasattr(
        pairs := import_module(_module_of_each_name()["ContactPair"]), name
    ):
        value = getattr(pairs, name)  # a pair whose file was added to the package
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Sorted names of the package, including those that are imported on first access."""
    return sorted({*globals(), *__all__})
