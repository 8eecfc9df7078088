"""A ball that slides in Drake without any controller, under each approximation of its contact.

    python -m benchmarks.gliding    (in the environment of make worlds for Drake)

A ball of 1 kg is pressed on a plane by a constant force and driven along it at a constant speed; it
cannot turn. Depth and force are those of Drake. `similar` and `sap` lift a sliding ball, see
`DrakeSpec.lift`; where they lift it by more than its depth, the contact opens and the ball bounces.
Columns: lift; expected depth, less the lift; mean depth; rms difference of the force from the load;
share of the steps in contact.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
import typer
from pydrake.common import configure_logging
from pydrake.geometry import AddContactMaterial, HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from rich.console import Console

from osc_contact.lab.scenarios.hardware import DrakeSpec
from paper.study import table_of

LOAD, MASS, RADIUS = 10.0, 1.0, 0.01  #: N, kg, m
FRICTION, SPEED = 0.2, 0.3  #: coefficient, m/s
SERVO = 2000.0  #: gain of the velocity servo along the plane (N s/m)
DURATION, SETTLING = 2.0, 1.0  #: of a run, and what is left out of it (s)
#: Approximation, relaxation time of each material (s), stiffness (N/m) and step (s) of each run.
CASES = (
    ("lagged", 0.0, 1e5, 5e-4),
    ("tamsi", 0.0, 1e5, 5e-4),
    ("similar", 0.0, 1e5, 5e-4),
    ("similar", 0.0, 3e5, 5e-4),
    ("similar", 0.0, 3e5, 1e-4),
    ("sap", 0.0, 1e5, 5e-4),
    ("sap", 0.1, 1e5, 5e-4),
)


@dataclass(frozen=True)
class Slid:
    """Depths and contact forces of a sliding ball.

    Attributes:
        depths: depth of the ball at each step (m), negative in the air.
        forces: its contact force (N).
    """

    depths: np.ndarray
    forces: np.ndarray


def slide(spec: DrakeSpec, step: float, friction: float = FRICTION, speed: float = SPEED) -> Slid:
    """Let the ball slide.

    Args:
        spec: contact of Drake.
        step: step of the simulation (s).
        friction: coefficient between ball and plane.
        speed: speed of the ball (m/s).
    """
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(
        time_step=step,
        discrete_contact_approximation=spec.contact,
        contact_model="point",
        stiction_tolerance=spec.stiction,
        use_sampled_output_ports=False,
    )
    plant, _ = AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    carriage = _add_ball(plant, "carriage", 1e-6)
    ball = _add_ball(plant, "ball", MASS)
    along = plant.AddJoint(
        PrismaticJoint("along", plant.world_frame(), carriage.body_frame(), [1.0, 0.0, 0.0])
    )
    up = plant.AddJoint(
        PrismaticJoint("up", carriage.body_frame(), ball.body_frame(), [0.0, 0.0, 1.0])
    )
    for body, shape in ((ball, Sphere(RADIUS)), (plant.world_body(), HalfSpace())):
        plant.RegisterCollisionGeometry(
            body, RigidTransform(), shape, body.name(), _material(spec, friction)
        )
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    up.set_translation(context, RADIUS - LOAD / spec.stiffness)
    along.set_translation_rate(context, speed)
    port = plant.get_applied_generalized_force_input_port()
    pressed = np.zeros(plant.num_velocities())
    pressed[up.velocity_start()] = -LOAD
    depths, forces = [], []
    for k in range(round(DURATION / step)):
        slow = speed - along.get_translation_rate(context)
        pressed[along.velocity_start()] = SERVO * slow + friction * LOAD
        port.FixValue(context, pressed)
        simulator.AdvanceTo((k + 0.5) * step)  # Drake makes a step when it leaves its time
        if k * step >= SETTLING:
            depths.append(RADIUS - up.get_translation(context))
            forces.append(_force(plant, context))
    return Slid(np.array(depths), np.array(forces))


def _add_ball(plant: Any, name: str, mass: float) -> Any:
    """Add a body with the inertia of a ball, without a shape.

    Args:
        plant: Drake's plant, changed.
        name: name of the body.
        mass: its mass (kg).
    """
    inertia = SpatialInertia(mass, np.zeros(3), UnitInertia.SolidSphere(RADIUS))
    return plant.AddRigidBody(name, inertia)


def _material(spec: DrakeSpec, friction: float) -> ProximityProperties:
    """Material of both bodies, as in the drake plant.

    Args:
        spec: contact of Drake.
        friction: coefficient.
    """
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=spec.dissipation,
        point_stiffness=2.0 * spec.stiffness,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    properties.AddProperty("material", "relaxation_time", spec.relaxation)
    return properties


def _force(plant: Any, context: Any) -> float:
    """Sum of the normal forces (N)."""
    results = plant.get_contact_results_output_port().Eval(context)
    points = range(results.num_point_pair_contacts())
    return float(sum(abs(results.point_pair_contact_info(i).contact_force()[2]) for i in points))


def main(friction: float = FRICTION, speed: float = SPEED) -> None:
    """Print the table.

    Args:
        friction: coefficient between ball and plane.
        speed: speed of the ball (m/s).
    """
    configure_logging()
    logging.getLogger("drake").setLevel(logging.ERROR)  # it announces the end of TAMSI
    rows: list[list[object]] = []
    for contact, relaxation, stiffness, step in CASES:
        spec = DrakeSpec.model_validate(
            {"contact": contact, "relaxation": relaxation, "stiffness": stiffness}
        )
        slid = slide(spec, step, friction, speed)
        lift = spec.lift(friction, speed, step)
        expected = spec.depth(LOAD, stiffness, friction, speed) - lift
        error = np.sqrt(np.mean((slid.forces - LOAD) ** 2)) / LOAD
        rows.append(
            [
                f"{contact}, {relaxation:g} s" if contact == "sap" else contact,
                f"{stiffness:g}",
                f"{1e3 * step:g}",
                f"{1e6 * lift:.0f}",
                f"{1e6 * expected:.1f}",
                f"{1e6 * slid.depths.mean():.1f}",
                f"{100 * error:.2f}",
                f"{np.mean(slid.forces > 0.0):.2f}",
            ]
        )
    heads = (
        "contact; stiffness (N/m); step (ms); lift (µm); expected depth (µm); depth (µm); "
        "force rms (%); in contact"
    )
    title = (
        f"a ball of {MASS:g} kg, {LOAD:g} N, friction {friction:g}, {speed:g} m/s, no controller"
    )
    Console(width=130).print(table_of(title, heads, rows))


if __name__ == "__main__":
    typer.run(main)
