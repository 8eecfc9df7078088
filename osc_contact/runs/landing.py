"""How hard contacts are met: the peak of the force that a landing is expected to have."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.runs.contacts import feet
from osc_contact.runs.rig import Rig
from osc_contact.scenarios.bodies import CartSpec, magnitude_names

__all__ = ["Landing", "landings"]


@dataclass(frozen=True)
class Landing:
    """One force of a contact that is approached.

    Attributes:
        name: of the force. speed: v_a of the approach (m/s).
        mass: behind the contact along its normal, 1 / NᵀΦ₀N (kg).
        stiffness: of contact and face in series (N/m). command: the largest (N).
        peak: expected, v √(k m) (N), or the command where that is more.
        free: whether the contact is still to be made when the run begins.
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
        """For people."""
        return (
            f"'{self.name}' lands at {1e3 * self.speed:.3g} mm/s with {self.mass:.3g} kg behind it "
            f"on {1e-3 * self.stiffness:.3g} kN/m: up to {self.peak:.3g} N"
        )


def landings(rig: Rig) -> list[Landing]:
    """Of every force that can only push; none where contacts are not approached.

    MuJoCo's contacts are springs with the rate ω of `solref`, whatever the mass: k = m ω². A face
    of mass m_e on a spring is met twice, by its mass and by its spring.
    """
    life = rig.life
    if life is None or not rig.pairs:
        return []
    plant = rig.scenario.plant
    rate = 1.0 / (plant.solref[0] * plant.solref[1] * sqrt(plant.solimp[1]))
    state = rig.state()
    contact = rig.contact()
    lines = [feet(pair, state.X_WO)[1] for pair in rig.pairs]
    names = magnitude_names({p.name: len(d) for p, d in zip(rig.pairs, lines, strict=True)})
    commands = rig.references.overview[1].alpha_d
    columns = zip(names, rig.owners, np.vstack(lines), (contact.N @ contact.R).T, strict=True)
    out = []
    for (name, owner, direction, N), wanted in zip(columns, commands.T, strict=True):
        mass = 1.0 / float(N @ state.Phi @ N)
        stiffness = mass * rate**2
        met = mass * rate
        motion = rig.bodies[rig.on[owner]].motion
        if isinstance(motion, CartSpec) and (along := float(direction @ motion.direction) ** 2):
            met = rate / (1.0 / mass + along / motion.mass)
            if motion.stiffness > 0.0:
                stiffness = 1.0 / (1.0 / stiffness + along / motion.stiffness)
                met = max(met, sqrt(stiffness * mass))
        command = float(wanted.max())
        free = rig.scenario.tare is not None or not wanted[0] > 0.0
        peak = max(life.speed * met, command)
        if pushes_only(rig.pairs[owner]):
            out.append(Landing(name, life.speed, mass, stiffness, command, peak, free))
    return out
