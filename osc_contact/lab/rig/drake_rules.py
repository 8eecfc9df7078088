"""Rules that a rig has to meet before its scenario runs in Drake."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import feet
from osc_contact.contacts.pairs.pair import ContactPair, count_forces
from osc_contact.errors import ScenarioError
from osc_contact.lab.rig.contacts import EnvironmentBody
from osc_contact.lab.rig.references import References
from osc_contact.lab.scenarios.hardware import PlantSpec
from osc_contact.spatial import Array, carry_twist


def require_bodies_at_rest(bodies: Sequence[EnvironmentBody]) -> None:
    """Refuse bodies of the environment that move.

    Args:
        bodies: bodies of the environment.

    Raises:
        ScenarioError: a body has a motion.
    """
    for body in bodies:
        if body.motion is not None:
            raise ScenarioError(
                f"'{body.name}' has a motion, and the bodies of the drake plant are at rest; leave "
                "it out, or take plant.type mujoco"
            )


def slip_speeds(pairs: Sequence[ContactPair], references: References) -> Array:
    """Largest commanded slip speed (k, contacts) of each contact's points on faces at rest (m/s).

    Args:
        pairs: contacts.
        references: references, whose `overview` gives the k instants.
    """
    plan = references.overview[1]
    speeds = np.zeros((len(plan.X_WD), len(pairs)))
    for row, pose, V in zip(speeds, plan.X_WD, plan.V_D, strict=True):
        X = pin.XYZQUATToSE3(pose)
        for i, pair in enumerate(pairs):
            for point, normal in zip(*feet(pair, X), strict=True):
                v = carry_twist(V, X.translation, point)[:3]
                row[i] = max(row[i], np.linalg.norm(v - normal * (normal @ v)))
    return speeds


def require_closed_slip(
    pairs: Sequence[ContactPair], references: References, owners: Array, plant: PlantSpec
) -> None:
    """Refuse commands under which Drake's `similar` or `sap` lifts a sliding object off a contact.

    Args:
        pairs: contacts.
        references: references with the commanded forces.
        owners: (r,) contact of each force.
        plant: settings of the plant.

    Raises:
        ScenarioError: the lift exceeds the depth of a contact.
    """
    drake = plant.drake
    speeds = slip_speeds(pairs, references)
    commands = references.overview[1].commands
    for i, pair in enumerate(pairs):
        forces = commands[:, owners == i].sum(axis=1)
        stiffness = drake.stiffness_of(count_forces(pair))
        moments = list(zip(forces.tolist(), speeds[:, i].tolist(), strict=True))
        frictions = [drake.largest_friction(F, stiffness, v, plant.step) for F, v in moments]
        worst = int(np.argmin(frictions))
        if plant.friction > frictions[worst]:
            force, v = moments[worst]
            time = "step" if drake.contact == "similar" else "(2 relaxation + step)"
            lift = drake.lift(plant.friction, v, plant.step)
            depth = drake.depth(force, stiffness, plant.friction, v)
            raise ScenarioError(
                f"plant.drake.contact: {drake.contact} lifts a sliding body by {time} friction "
                f"slip speed = {1e3 * lift:.3g} mm, and contact '{pair.name}' is only "
                f"{1e3 * depth:.3g} mm deep ({force:.3g} N, {v:.3g} m/s): it would open and bounce "
                "without any fault of the controller; choose lagged, a smaller "
                f"{'step' if drake.contact == 'similar' else 'relaxation'}, or a friction below "
                f"{frictions[worst]:.2g}"
            )
