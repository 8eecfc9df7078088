"""Sequences of active sets of a controller with contact phases, which unloads contacts that leave.

The scene is that of `active_set_cases`. Which contacts are in N is decided by the controller: named
ones, and those that are unloaded. The arms move and are read with exactly these, under random
torques that last for some ticks, so that contacts are made and lost, too.
"""

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from active_set_cases import GAINS, K_I, K_V, KNOWN, Scene, Tick
from numpy.random import default_rng

import osc_contact as osc

RISE = 0.02  #: s, of steps of desired forces, in which contacts are unloaded
LASTING = 15.0  #: mean number of ticks of a named set
LOADED = 8.0  #: mean number of ticks of a load
LIFE = osc.PhaseSettings(rise=0.01, lag=0.001)  # s: loads are short
STEPPED = osc.Gains(GAINS.motion, osc.ForceGains(K_I, K_V, rise=RISE, brake=0.0))


@dataclass
class Sequence:
    """Ticks of a controller with phases, and what it did.

    Attributes:
        scene: arms and contacts.
        ticks: inputs of each tick; `active` has the contacts that are in N.
        tau: (n, 7) torques (N m).
        phases: (n, 12) phases of the contacts.
        errors: largest errors against the KKT oracle, by kind.
    """

    scene: Scene
    ticks: list
    tau: np.ndarray
    phases: np.ndarray
    errors: dict

    @property
    def named(self):
        """Flags (n, 12) of the contacts that the references name."""
        return np.array([tick.reference.active for tick in self.ticks], dtype=bool)

    def arrays(self):
        """Inputs of all ticks, by the name of the argument of a batch."""
        return {
            "q": np.array([tick.measured.q for tick in self.ticks]),
            "v": np.array([tick.measured.v for tick in self.ticks]),
            "wrenches": np.array([tick.measured.wrenches for tick in self.ticks]),
            "X_WD": np.array([tick.reference.X_WD.homogeneous for tick in self.ticks]),
            "V_D": np.array([tick.reference.V_D for tick in self.ticks]),
            "A_D": np.array([tick.reference.A_D for tick in self.ticks]),
            "alpha_d": np.array([tick.reference.alpha_d for tick in self.ticks]),
            "active": np.array([tick.reference.active for tick in self.ticks]),
        }


def made_for(scene, reading):
    """Controller of the scene's contacts with phases and shaped steps."""
    return scene.controller(gains=STEPPED, life=LIFE, reading=reading)


def phased(seed, count, reading="filter"):
    """Sequence of `count` ticks; every tick is judged by the KKT oracle of the contacts in N.

    Args:
        seed: seed of the random numbers.
        count: number of ticks.
        reading: reading of the contact forces.
    """
    rng = default_rng(seed)
    scene = Scene.random(rng)
    controller = made_for(scene, reading)
    owners = controller.records.model.columns.contact
    named = scene.draw(rng)
    alpha_d = np.zeros(len(owners))
    state = None
    last = None  # contacts in N in the last tick
    load = np.zeros(7)
    ticks, torques, phases = ([], [], [])
    errors = {}
    for _ in range(count):
        if rng.random() < 1.0 / LASTING:  # a part is released, or another set is named
            named = named & (rng.random(KNOWN) < 0.5) if rng.random() < 0.6 else scene.draw(rng)
        if rng.random() < 1.0 / LASTING:
            alpha_d = rng.uniform(0.0, 20.0, len(owners)) * (rng.random(len(owners)) < 0.8)
        reference = osc.Reference(
            scene.rest.case.X_WO * pin.exp6(0.02 * rng.standard_normal(6)),
            0.1 * rng.standard_normal(6),
            rng.standard_normal(6),
            alpha_d,
            active=named.astype(float),
        )
        ahead = deepcopy(controller)  # the set depends on the past and the reference alone
        still = osc.Measurement(scene.rest.case.q, 0.0 * load, np.zeros((1, 6)))
        ahead.tick(still, reference)
        here = ahead.active.copy()
        if state is None or (here != last).any():
            state = scene.state(here, rng)
            last = here
        if rng.random() < 1.0 / LOADED:
            load = 20.0 * rng.standard_normal(7)
        truth = state.answer(load + rng.standard_normal(7))
        measured = osc.Measurement(scene.rest.case.q, state.v, state.readings(truth))
        torques.append(controller.tick(measured, reference))
        assert controller.status is osc.Status.OK, controller.reason
        assert (controller.active == here).all()
        phases.append(controller.phases().copy())
        result = controller.result()
        # commanded forces by column of N; the oracle gives what the torques cause
        commanded = controller.records.work.alpha_u[: here[owners].sum()].copy()
        tick = Tick(here, state, measured, reference, truth.alpha, commanded)
        ticks.append(tick)
        found = result.alpha[here[owners]]
        looser = max(1.0, (0.1 / state.apart()) ** 2)
        for name, error in tick.misses(torques[-1], found).items():
            errors[name] = max(errors.get(name, 0.0), error / looser)
    return Sequence(scene, ticks, np.array(torques), np.array(phases), errors)


def repeated(controller, inputs):
    """Torques (n, 7) of a controller for the inputs of `Sequence.arrays`."""
    torques = []
    for k in range(len(inputs["q"])):
        one = {name: values[k] for name, values in inputs.items()}
        measured = osc.Measurement(one["q"], one["v"], one["wrenches"])
        pose = pin.SE3(one["X_WD"])
        reference = osc.Reference(
            pose, one["V_D"], one["A_D"], one["alpha_d"], active=one["active"]
        )
        torques.append(controller.tick(measured, reference))
    return np.array(torques)


def repeat(seed, reading, inputs, outputs):
    """Save the torques of the controller of a sequence for inputs from a file.

    Args:
        seed: seed of the sequence.
        reading: reading of the contact forces.
        inputs: file with the arrays of `Sequence.arrays`.
        outputs: file that is written.
    """
    scene = Scene.random(default_rng(seed))
    np.save(outputs, repeated(made_for(scene, reading), dict(np.load(inputs))))


def packaged(seed):
    """Seed of a sequence whose pairs a file can hold."""
    while any("compiled" in one.name for one in Scene.random(default_rng(seed)).contacts):
        seed += 100
    return seed
