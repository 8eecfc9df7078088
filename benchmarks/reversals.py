"""Straight reversals with friction: the share of the force error that is due to the simulator.

    python -m benchmarks.reversals

A Panda slides a ball-nosed peg to and fro on a tilted face with 10 N, along a line across the arm
and along the steepest one. Printed is the rms force error of each line on four plants:

    mujoco        as packaged: a small impedance of the contacts, see `lab.plants.mujoco`
    elliptic      solref and solimp for normal forces and friction alike, MuJoCo's elliptic cone
    + impratio    the same with impratio 100; + noslip: with ten iterations against slip
    exact         rigid contact and regularised Coulomb friction, no part of MuJoCo
"""

from itertools import product
from typing import Any

import numpy as np

import osc_contact as osc
from benchmarks.cases import POINT
from osc_contact.lab.plants.rigid import RigidPlant, Solution
from osc_contact.lab.rig.rig import PLANTS, MakesPlant, Rig, register_plant
from osc_contact.spatial import Array, carry_wrench, cross, skew

STROKES = ((20, 2), (5, 4))  #: mm, Hz
LINES = {"across": [0, 1, 0], "steepest": [0.93969, 0, 0.34202]}
DURATION = 3.0  #: s
SLIP = 1e-3  #: m/s, at which the exact plant's friction has 1/√2 of its size


class SlidingPlant(RigidPlant):
    """The exact plant of one arm whose points of contact rub: μ α v_t / √(v_t² + v_0²).

    The motors of an arm without passive joints make any wrench at O: friction f is −Jᵀf in place of
    torques, and is added to what the wrist reads.
    """

    mu = 0.0
    rounds = 3  #: of α and friction, which determine one another

    def _solve_motion(
        self, tau: Array, with_wrenches: bool = False, ahead: float = 0.0
    ) -> Solution:
        solution = super()._solve_motion(tau, with_wrenches, ahead)
        X, V = self._object_state()
        J = self._jacobian(X)
        lines = []
        pairs: tuple[Any, ...] = self.contacts
        for pair in pairs:
            p = pair.points_of_contact(X) - X.translation[:, None]
            n = pair.contact(X, V).N[:3]
            v = V[:3, None] + skew(V[3:]) @ p
            v = v - n * (n * v).sum(axis=0)
            along = v / np.sqrt((v * v).sum(axis=0) + SLIP**2)
            lines.append(np.concatenate((along, cross(p, along))))
        friction = np.zeros(6)
        for _ in range(self.rounds):
            friction = self.mu * np.hstack(lines) @ solution.alpha
            solution = super()._solve_motion(tau - J.T @ friction, with_wrenches, ahead)
        if with_wrenches:
            sensor = self._wrist_cuts[0]
            assert sensor is not None
            at = self.data.oMi[sensor.joint] * sensor.placement
            f = carry_wrench(friction, X.translation, at.translation).reshape(2, 3)
            solution.wrenches[0] += (f @ at.rotation).ravel()
        return solution


def _sliding(rig: Rig, seed: int) -> RigidPlant:
    plant = SlidingPlant(rig.chain, rig.pairs, rig.scenario.plant.step)
    plant.mu = rig.scenario.plant.friction
    return plant


def _plain(**options: float) -> MakesPlant:
    """A plant in MuJoCo with contacts as declared, for forces and friction alike."""

    def make(rig: Rig, seed: int) -> Any:
        plant: Any = PLANTS["mujoco"](rig, seed)
        spec = rig.scenario.plant
        model = plant.model
        model.pair_solref[:] = spec.solref
        model.pair_solreffriction[:] = 0.0
        model.pair_solimp[:] = [*spec.solimp, 0.5, 2.0]
        model.opt.impratio = 1.0
        for name, value in options.items():
            setattr(model.opt, name, value)
        return plant

    return make


def register_plants() -> None:
    """Enter the plants that are compared here."""
    register_plant("sliding", exact=True)(_sliding)
    register_plant("elliptic")(_plain())
    register_plant("+ impratio")(_plain(impratio=100.0))
    register_plant("+ noslip")(_plain(noslip_iterations=10, cone=0))


KINDS = ("mujoco", "exact", "elliptic", "+ impratio", "+ noslip")


def reversing(
    kind: str, stroke: tuple[int, int], line: str, mu: float, known: bool
) -> osc.Scenario:
    """The scenario of one entry.

    Args:
        kind: name in `KINDS`.
        stroke: amplitude (mm), frequency (Hz).
        line: name in `LINES`.
        mu: coefficient of friction.
        known: whether the controller is given it.
    """
    amplitude, frequency = stroke
    sine = {
        "type": "sine",
        "amplitude": f"{amplitude} mm",
        "frequency": f"{frequency} Hz",
        "ramp": "1 s",
    }
    plant = POINT["plant"] | {"type": "sliding" if kind == "exact" else kind, "friction": mu}
    control = POINT["control"] | ({"friction": {"mu": mu}} if known else {})
    motion = [{"kind": "linear", "direction": LINES[line], "signals": [sine]}]
    changes = {"plant": plant, "control": control, "motion": motion, "gains": {}}
    return osc.Scenario.from_dict(POINT | changes)


def main() -> None:
    """Print the table."""
    register_plants()
    print(f"{'stroke':14}{'line':10}{'mu':14}" + "".join(f"{kind:>12}" for kind in KINDS))
    for stroke, line, mu, known in product(STROKES, LINES, (0.2, 0.3), (False, True)):
        cells = []
        for kind in KINDS if mu == 0.2 and known else KINDS[:1]:
            recording = osc.run(reversing(kind, stroke, line, mu, known), duration=DURATION)
            force = osc.metrics(recording)["force"]["nose"]
            cells.append(f"{force['rms_error_rel']:12.2%}")
        move = f"{stroke[0]} mm {stroke[1]} Hz"
        print(
            f"{move:14}{line:10}{mu} {'known' if known else 'unknown':10}" + "".join(cells),
            flush=True,
        )


if __name__ == "__main__":
    main()
