"""Sequences of active sets: twelve known contacts of a Panda, some of them active at each tick.

For each tick the KKT oracle of the active set gives the wrist readings under arbitrary torques, and
forces and motion under the controller's torques. Contacts are pairs that push and pairs that hold,
of all kinds, fixed to the world.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from grasp_rigs import random_case
from kkt_oracle import WORLD, Contact, State, touch
from numpy.random import default_rng
from pair_kinds import KINDS as PAIRS
from pair_kinds import PLAIN
from rigs import UNLIMITED, displacement, miss, strong
from samples import aligned

import osc_contact as osc

KNOWN = 12  #: number of known contacts
K_P, K_D, K_I, K_V = (400.0, 40.0, 30.0, 5.0)
DT = 1e-3
SLOWER = 0.1  #: factor of random velocities
LEAST_APART = 0.05  #: least distance of active columns from dependence, see `State.apart`
#: gap functions, whose n_γ is computed by differences
ROUGH = {"bead_on_a_wire", "point_on_a_saddle"}
GAINS = osc.Gains(osc.MotionGains(K_P, K_D, 0.0), osc.ForceGains(K_I, K_V, rise=0.0, brake=0.0))


@dataclass
class Scene:
    """Arms at rest, and the known contacts of the object."""

    rest: State
    contacts: list

    @classmethod
    def random(cls, rng):
        """Random Panda in a regular posture, with `KNOWN` random contacts."""
        near_singular = True
        while near_singular:
            case = random_case(["panda"], ["rigid"], rng)
            case = replace(case, chain=strong(case.chain))
            near_singular = bool(case.chain.state(case.q).singular_directions)
        rest = State(case, [])
        names = [name for name in sorted(PAIRS) if name not in ROUGH]
        sizes = {name: PAIRS[name](default_rng(0), PLAIN)[2] for name in names}
        single = [name for name in names if sizes[name] == 1]
        several = [name for name in names if sizes[name] > 1]
        contacts = []
        while len(contacts) < KNOWN:
            name = rng.choice(single if len(contacts) % 3 else several)
            pair = touch(name, rng, case.X_WO)
            contact = Contact(name, pair, WORLD, case.X_WO)
            if rest.apart(contact.along_object) > LEAST_APART:
                contacts.append(contact)
        return cls(rest, contacts)

    def draw(self, rng, most=5):
        """Random flags (12,) of active contacts: independent columns, `most` of them at most."""
        active = np.zeros(KNOWN, dtype=bool)
        N = np.zeros((0, 6))
        for number in rng.permutation(KNOWN)[: rng.integers(0, KNOWN)]:
            more = np.vstack((N, self.contacts[number].along_object))
            if len(more) <= most and self.rest.apart(more) > LEAST_APART:
                N = more
                active[number] = True
        return active

    def state(self, active, rng):
        """State of the arms in a random slow motion that the active contacts (12,) permit."""
        touched = [copy(contact) for contact, here in aligned(self.contacts, active) if here]
        state = State(self.rest.case, touched, 0.0, self.rest)
        state.move(rng)
        state.at(SLOWER * state.v, SLOWER * state.V)
        for contact in touched:
            contact.bent = contact.bend(state.V)
        return state

    def controller(self, **how):
        """Controller of all known contacts, without limits and joint friction."""
        settings = {"gains": GAINS, "reading": "filter", "safety": UNLIMITED}
        controller = osc.Controller(
            self.rest.case.chain,
            [contact.pair for contact in self.contacts],
            posture=self.rest.case.q,
            joint_friction=False,
            **settings | how,
        )
        controller.records.model.phase_rate = 1e9  # torques may jump
        return controller


@dataclass
class Tick:
    """Inputs of a controller in a tick, and the expected effects of its torques.

    Attributes:
        active: (12,) flags of active contacts.
        state: state of the arms with these contacts.
        measured, reference: inputs of the tick.
        alpha: (r,) contact forces in the wrist readings (N).
        forces: (r,) contact forces that the torques have to cause (N).
    """

    active: np.ndarray
    state: State
    measured: osc.Measurement
    reference: osc.Reference
    alpha: np.ndarray
    forces: np.ndarray

    def misses(self, tau, found):
        """Relative errors of measured forces, and of forces and motion under the torques.

        Args:
            tau: (n_a,) torques of the controller (N m).
            found: (r,) forces that it measured (N).
        """
        answer = self.state.answer(tau)
        X_WO = self.state.case.X_WO
        reference = self.reference
        error = displacement(X_WO, reference.X_WD)
        command = reference.A_D + K_D * (reference.V_D - self.state.V) + K_P * error
        inertia = self.state.system.I
        motion = self.state.nearest(inertia, command, self.state.N @ answer.a)
        return {
            "reading": miss(found, self.alpha),
            "forces": miss(answer.alpha, self.forces),
            "motion": miss(answer.a, motion),
        }


def sequence(seed, count, lasting=4):
    """Scene and ticks whose active sets last for some ticks each.

    Args:
        seed: seed of the random numbers.
        count: number of ticks.
        lasting: mean number of ticks of an active set.
    """
    rng = default_rng(seed)
    scene = Scene.random(rng)
    owners = np.repeat(np.arange(KNOWN), [len(c.along_object) for c in scene.contacts])
    integrals = np.zeros(len(owners))
    ticks = []
    state = None
    for _ in range(count):
        if state is None or rng.random() < 1.0 / lasting:
            active = scene.draw(rng)
            state = scene.state(active, rng)
        here = active[owners]
        truth = state.answer(20.0 * rng.standard_normal(7))
        measured = osc.Measurement(scene.rest.case.q, state.v, state.readings(truth))
        alpha_d = rng.uniform(0.0, 20.0, len(owners)) * (rng.random(len(owners)) < 0.7)
        reference = osc.Reference(
            scene.rest.case.X_WO * pin.exp6(0.02 * rng.standard_normal(6)),
            0.1 * rng.standard_normal(6),
            rng.standard_normal(6),
            alpha_d,
            active=active,
        )
        integrals[~here] = 0.0
        integrals[here] += K_I * DT * (alpha_d[here] - truth.alpha)
        forces = alpha_d[here] + integrals[here]
        ticks.append(Tick(active, state, measured, reference, truth.alpha, forces))
    return (scene, ticks)


def torques(seed, count, **how):
    """Torques (count, 7) of a controller in a sequence; `how` has arguments of the controller."""
    scene, ticks = sequence(seed, count)
    controller = scene.controller(**how)
    return np.array([controller.tick(one.measured, one.reference) for one in ticks])


def worst(seed, count):
    """Largest errors of a sequence of `count` ticks, by kind, and the set of its active sets."""
    scene, ticks = sequence(seed, count)
    controller = scene.controller()
    owners = controller.records.model.columns.contact
    errors = {}
    sets = set()
    for one in ticks:
        tau = controller.tick(one.measured, one.reference)
        assert controller.status is osc.Status.OK, controller.reason
        sets.add(one.active.tobytes())
        found = controller.result().alpha[one.active[owners]]
        looser = max(1.0, (0.1 / one.state.apart()) ** 2)
        for name, error in one.misses(tau, found).items():
            errors[name] = max(errors.get(name, 0.0), error / looser)
    return (errors, sets)
