"""Landings: expected peak forces when contacts are made."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from osc_contact.contacts.feet import feet
from osc_contact.contacts.pairs.pair import count_forces, pushes_only
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.scenarios.bodies import CartSpec


@dataclass(frozen=True)
class Landing:
    """Expected landing of a contact, for one of its forces.

    Attributes:
        name: name of the force.
        speed: speed v_a of the approach (m/s).
        mass: effective mass along the normal, 1 / NᵀΦ₀N (kg).
        stiffness: stiffness of contact and face in series (N/m).
        command: largest command (N).
        peak: expected peak force, v √(k m) or the command, whichever is larger (N).
        free: whether the contact is open at the beginning of the run.
    """

    name: str
    speed: float
    mass: float
    stiffness: float
    command: float
    peak: float
    free: bool

    @property
    def sentence(self) -> str:
        """Sentence on speed, mass, stiffness and peak force."""
        return (
            f"'{self.name}' lands at {1e3 * self.speed:.3g} mm/s with {self.mass:.3g} kg behind it "
            f"on {1e-3 * self.stiffness:.3g} kN/m: up to {self.peak:.3g} N"
        )


def landings(rig: Rig) -> list[Landing]:
    """Expected landings of all forces that can only push; empty without contact phases.

    The peak is v √(k m), with √(k m) = m ω as the impedance of the contact: MuJoCo's contacts are
    springs with the natural frequency ω of `solref` for any mass, k = m ω²; Drake's k is given. A
    face of mass m_e on a spring causes two peaks, by its mass and by its spring; the larger one
    counts.

    Args:
        rig: rig of a scenario, at rest in contact.
    """
    life = rig.life
    if life is None or not rig.pairs:
        return []
    plant = rig.scenario.plant
    state = rig.state
    contact = rig.contact
    directions = np.vstack([feet(pair, state.X_WO)[1] for pair in rig.pairs])
    commands = rig.references.overview[1].commands
    columns = zip(rig.force_names, rig.owners, directions, (contact.N @ contact.R).T, strict=True)
    results = []
    # mass (kg) of object and arms along the force, and stiffness of the plant's contact for it
    for (name, owner, direction, N), desired in zip(columns, commands.T, strict=True):
        if not pushes_only(rig.pairs[owner]):
            continue
        mass = 1.0 / (N @ state.Phi @ N)
        stiffness = plant.contact_stiffness(mass, count_forces(rig.pairs[owner]))
        omega = sqrt(stiffness / mass)
        impedance = mass * omega
        motion = rig.bodies[rig.on[owner]].motion
        # of a body on a spring rail only the component of its motion along the force counts
        if isinstance(motion, CartSpec) and (share := (direction @ motion.direction) ** 2):
            impedance = omega / (1.0 / mass + share / motion.mass)
            if motion.stiffness > 0.0:
                stiffness = 1.0 / (1.0 / stiffness + share / motion.stiffness)
                impedance = max(impedance, sqrt(stiffness * mass))
        command = desired.max()
        peak = max(life.speed * impedance, command)
        is_open = rig.scenario.tare is not None or not desired[0] > 0.0
        results.append(Landing(name, life.speed, mass, stiffness, command, peak, is_open))
    return results
