"""The torques of `Controller.tick`, put into one KKT system of arms, object and touched bodies.

The law is asked for nothing but its torques; `kkt_oracle` answers with accelerations and contact
forces. On more than 2,000 random states, all moving, these must be

    contact forces    those wished for, α_d: what the force law commands where it has no integral
    the object        of all accelerations that arms and contacts leave it, the one nearest to
                      p̈_d + K_d ė + K_p e in the metric of the motion filter

Where columns nearly depend on one another, σ from it, forces answer accelerations with 1/σ²: the
tolerance grows with that. `GapFunctions` knows N and n_γ to 1e-11 … 1e-9 only. Near singular
postures the law gives up motion, never force. Two arms whose grasps pass on no squeeze are held.
All of these are counted by themselves: the 2,000 states are without them.
"""

from __future__ import annotations

import copy
import os
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from grasp_rigs import KINDS, Case, random_case
from kkt_oracle import BODIES, PAIRS, PLAIN, Contact, State, Touched, touch
from rigs import random_state, scara_pair
from test_decoupling import strong

import osc_contact as osc
from benchmarks.cases import random_rig
from osc_contact.control.friction import Friction

K_P, K_D = 400.0, 40.0
GAINS = osc.Gains(osc.MotionGains(K_P, K_D), osc.ForceGains(0.0, 5.0))
STATES = 84  # of each rig and surroundings, well apart and in ordinary postures
RTOL, FADED_RTOL, ROUGH_RTOL = 1e-9, 1e-7, 1e-6
APART, LEAST_APART = 0.1, 0.03
FASTEST, SLOWEST = 5.0, 0.02  # m/s, rad/s; of what slides
ROUGH = {"bead_on_a_wire", "point_on_a_saddle"}  # gap functions
COLUMNS = {name: make(np.random.default_rng(0), PLAIN)[2] for name, make in PAIRS.items()}


# Arms ---------------------------------------------------------------------------------------------


def rigid_case(chain, q, X_WO):
    return Case(strong(chain), q, X_WO, [("rigid", grasp.X_TO, None) for grasp in chain.grasps])


def alike(kind):
    """One to four arms of a kind that permit the object the same motions."""

    def make(rng):
        rig = random_rig([kind] * rng.integers(1, 5), rng)
        return rigid_case(rig.chain, rig.q, rig.X_WO)

    return make


def paper(rng):
    q, v = random_state(scara_pair(), rng)
    return rigid_case(scara_pair(), q, scara_pair().state(q, v).X_WO)


def any_arms(*grasps):
    """One to four arms of different kinds, in any posture."""

    def make(rng):
        while True:
            n = rng.integers(1, 5)
            arms = list(rng.choice(["ur5", "panda", "scara"], n))
            case = random_case(arms, list(rng.choice(grasps, n)), rng)
            try:
                chain = strong(case.chain)
                chain.state(case.q, np.zeros(chain.nq))
                osc.Controller(chain, [])
            except osc.ModelError:  # motions that no motor drives, or that no joint measures
                continue
            return replace(case, chain=chain)

    return make


@dataclass(frozen=True)
class Rig:
    """How random arms are made, and in how many ways they let the object move."""

    make: Callable
    d: set
    grasps: tuple = ("rigid",)


ALL_GRASPS = (*KINDS, "screw", "plane")
RIGS = {
    "planar": Rig(alike("planar"), {3}),
    "scara": Rig(alike("scara"), {4}),
    "paper": Rig(paper, {5}),
    "ur5": Rig(alike("ur5"), {6}),
    "any arms": Rig(any_arms("rigid"), {5, 6}),
    "any grasps": Rig(any_arms(*ALL_GRASPS), {5, 6}, ALL_GRASPS),
}

# Contacts -----------------------------------------------------------------------------------------


def in_the_world(rng, contacts):
    return None


def on_bodies(rng, contacts):
    """A new body of any kind, or now and then one that is touched already, or the world."""
    chance = rng.random()
    if chance < 0.15:
        return None
    if contacts and chance < 0.5:
        return contacts[rng.integers(len(contacts))].on
    return Touched.random(rng.choice(sorted(BODIES)), rng, rng.uniform(-0.5, 0.5, 3))


def on_one(rng, contacts):
    """The body of the other contacts: how columns that depend share moves it nowhere else."""
    return contacts[0].on if contacts else on_bodies(rng, contacts)


@dataclass(frozen=True)
class Surroundings:
    """What is touched: where, with which friction, and whether every contact counts twice."""

    on: Callable
    pairs: tuple = tuple(sorted(COLUMNS))
    mu: float = 0.0
    copied: bool = False


SURROUNDINGS = {
    "world": Surroundings(in_the_world),
    "bodies": Surroundings(on_bodies),
    "friction": Surroundings(on_bodies, ("vertex_on_face",), 0.3),
    "dependent": Surroundings(on_one, copied=True),
}


def some_contacts(rest, i, rng, where):
    """Independent columns: the kind of the first and r as the number of the state says."""
    X_WO, d, contacts, N = rest.case.X_WO, rest.S.shape[1], [], np.zeros((0, 6))
    first, turn = where.pairs[i % len(where.pairs)], i // len(where.pairs)
    most = d - (where.mu > 0.0)  # what is held fast does not slide
    least = min(most, COLUMNS[first])
    r = least + turn % (most - least + 1)
    for attempt in range(100):
        if contacts and len(N) == r:
            break
        fit = [
            name for name in where.pairs if 0 < COLUMNS[name] <= r - len(N) and name not in ROUGH
        ]
        name = rng.choice(fit) if contacts or attempt > 4 else first
        body = where.on(rng, contacts)
        pair = touch(name, rng, X_WO if body is None else body.X.actInv(X_WO))
        near = pair.contact(X_WO, np.zeros(6), None if body is None else body.X).N.T
        if rest.apart(np.vstack((N, near))) > LEAST_APART:
            contacts, N = [*contacts, Contact(name, pair, body, X_WO)], np.vstack((N, near))
    return contacts


# Ticks --------------------------------------------------------------------------------------------


@dataclass
class Tick:
    """A state, what a controller was asked there, and its torques."""

    state: State
    contacts: list
    controller: osc.Controller
    before: osc.Controller
    measured: osc.Measurement
    wanted: osc.Reference
    B: object
    tau: np.ndarray


def tick(state, contacts, i, rng):
    """A controller's first tick at a state, `contacts` those it knows of."""
    A, case = rng.normal(size=(6, 6)), state.case
    k, rigid = len(case.chain.arms), all(grasp.is_rigid for grasp in case.chain.grasps)
    B = ("object", "chain", A @ A.T + np.eye(6))[i % 3]
    controller = osc.Controller(
        case.chain, [c.pair for c in contacts], GAINS, B=B,
        bodies=[None if c.on is None else c.on.known for c in contacts],
        friction=Friction(state.mu, slip=1e-9) if state.mu else None,
        posture=case.q + 0.1 * rng.normal(size=case.chain.nq),
        safety=osc.SafetySettings.motors_only(),  # random speeds are above the joints' limits
    )  # fmt: skip
    touched = None
    if state.bodies:
        rest = np.concatenate((np.eye(4).ravel(), np.zeros(12)))
        seen = np.array([rest if c.on is None else c.on.seen() for c in contacts])
        X_WE, V_E, A_E = np.split(seen, (16, 22), axis=1)
        touched = osc.interface.Touched(X_WE.reshape(-1, 4, 4), V_E, A_E)
    measured = osc.Measurement(case.q, state.v, 10.0 * rng.normal(size=(k, 6)), touched)
    squeeze = rng.uniform(0.0, 5.0, k * (k - 1) // 2) * rigid
    wanted = osc.Reference(
        case.X_WO * pin.exp6(pin.Motion(0.02 * rng.normal(size=6))),
        0.1 * rng.normal(size=6),
        rng.normal(size=6) * (state.mu == 0.0),  # else friction is that of a slip to come
        rng.uniform(5.0, 20.0, sum(len(c.along_object) for c in contacts)),
        squeeze if rigid and k > 2 else squeeze.sum() if k == 2 else 0.0,
    )
    before = copy.copy(controller)
    tau = controller.tick(measured, wanted)
    return Tick(state, contacts, controller, before, measured, wanted, B, tau)


def ticks(rig, surroundings):
    """Ticks at random states without end, always the same ones."""
    names = [*RIGS, *SURROUNDINGS]
    where, rng = SURROUNDINGS[surroundings], np.random.default_rng(
        [names.index(rig), names.index(surroundings)]
    )  # fmt: skip
    i = 0
    while True:
        if i % 4 == 0:
            rest = State(RIGS[rig].make(rng), [])
        state = State(rest.case, some_contacts(rest, i, rng, where), where.mu, rest)
        state.move(rng)
        if max(np.abs(state.v).max(), np.abs(state.V).max()) > FASTEST:
            continue
        if where.mu and min(np.linalg.norm(c.slip(state.V)[0]) for c in state.contacts) < SLOWEST:
            continue
        copies = rng.integers(len(state.contacts), size=3 if where.copied else 0)
        yield tick(state, state.contacts + [state.contacts[j] for j in copies], i, rng)
        i += 1


def misses(t):
    """Errors of contact forces and of the object's acceleration, relative to their size."""
    state, wanted, X_WO = t.state, t.wanted, t.state.case.X_WO
    a, alpha = state.answer(t.tau)
    forces = alpha, wanted.alpha_d
    if len(t.contacts) > len(state.contacts):  # how dependent columns share is not determined
        forces = state.N.T @ alpha, np.vstack([c.along_object for c in t.contacts]).T @ forces[1]
    turned = pin.log3(wanted.X_WD.rotation @ X_WO.rotation.T)
    error = np.concatenate((wanted.X_WD.translation - X_WO.translation, turned))
    command = wanted.A_D + K_D * (wanted.V_D - state.V) + K_P * error
    inertia = state.system.I
    metric = {"object": inertia, "chain": state.inertia_of_all()}.get(str(t.B))
    command = state.nearest(inertia, command, state.N @ command)
    motion = state.nearest(np.linalg.inv(t.B) if metric is None else metric, command, state.N @ a)
    return [
        np.abs(got - want).max(initial=0.0) / np.abs(want).max(initial=1.0)
        for got, want in (forces, (a, motion))
    ]


def same_in_a_batch(t):
    """Whether two rows of a batch give the torques of the tick bit for bit; None: no batch can."""
    if t.before._outside.needed:
        return None
    seen, m, w = t.measured.touched, t.measured, t.wanted
    twice = {"q": m.q, "v": m.v, "wrenches": m.wrenches, "X_WD": w.X_WD.homogeneous}
    twice |= {"V_D": w.V_D, "A_D": w.A_D, "alpha_d": w.alpha_d}
    if seen is not None:
        table = seen.X_WE.reshape(-1, 16), seen.V_E, seen.A_E
        twice["touched"] = np.hstack(table)
    if np.ndim(w.squeeze_d) or len(t.state.case.chain.arms) < 3:
        twice["squeeze_d"] = np.atleast_1d(w.squeeze_d)
    batch = osc.BatchController([t.before, t.before])
    tau = batch.tick(**{name: np.array([x, x]) for name, x in twice.items()})
    return (tau == t.tau).all()


@pytest.mark.parametrize("surroundings", SURROUNDINGS)
@pytest.mark.parametrize("rig", RIGS)
def test_torques_bring_the_forces_and_the_motion_asked_for(rig, surroundings):
    count, seen, where = Counter(), defaultdict(set), SURROUNDINGS[surroundings]
    for t in ticks(rig, surroundings):
        apart, status, state = t.state.apart(), t.controller.status, t.state
        if status is osc.Status.HELD:
            assert "motors cannot drive" in t.controller.reason, t.controller.reason
            assert rig == "any grasps" and len(state.case.grasps) == 2
            count["held"] += 1
            continue
        force, motion = misses(t)
        names = {c.name for c in t.contacts}
        count["rows"] += (same := same_in_a_batch(t)) is not None
        assert same is not False
        looser = max(1.0, (APART / apart) ** 2)
        what = rig, surroundings, state.S.shape, names, apart, force, motion
        if status is osc.Status.DEGRADED:
            count["faded"] += 1
            assert force < FADED_RTOL * looser, what
            continue
        assert status is osc.Status.OK
        assert max(force, motion) < (ROUGH_RTOL if names & ROUGH else RTOL) * looser, what
        count["rough" if names & ROUGH else "near" if apart < APART else "well apart"] += 1
        seen["d"].add(state.S.shape[1])
        seen["r"].add(len(state.N))
        seen["arms"].add(len(state.case.chain.arms))
        seen["grasps"].update(kind for kind, *_ in state.case.grasps)
        seen["pairs"] |= names
        seen["bodies"].update(one.name for one in state.bodies)
        if count["well apart"] == STATES:
            break
    d, mixed = max(RIGS[rig].d), len(RIGS[rig].d) > 1
    assert seen["d"] >= RIGS[rig].d if mixed else seen["d"] == RIGS[rig].d
    assert seen["r"] >= set(range(mixed or where.mu > 0.0, d + 1 - (where.mu > 0.0)))
    assert seen["arms"] >= ({2} if rig == "paper" else {2, 3, 4} if mixed else {1, 2, 3, 4})
    assert seen["grasps"] == set(RIGS[rig].grasps)
    assert seen["bodies"] == (set() if where.on is in_the_world else set(BODIES))
    assert seen["pairs"] >= {name for name in where.pairs if rig == "ur5" or COLUMNS[name] < 2}
    assert max(count["near"], count["rough"]) < 2 * STATES
    assert max(count["held"], count["faded"]) < 4 * STATES * mixed + 1


def test_there_are_two_thousand_states_on_every_pair():
    assert STATES * len(RIGS) * len(SURROUNDINGS) >= 2000
    assert set.union(*(rig.d for rig in RIGS.values())) == {3, 4, 5, 6}
    made = {type(make(np.random.default_rng(0), PLAIN)[0]).__name__ for make in PAIRS.values()}
    others = {"ContactPair", "PAIRS", "register_pair"}
    assert made >= set(osc.contacts.pairs.__all__) - others  # and what other tests register


# Without compilation ------------------------------------------------------------------------------


def some_torques():
    """Torques of the first ticks of each rig and surroundings, one behind the other."""
    return [
        next(made).tau for rig in RIGS for where in SURROUNDINGS for made in [ticks(rig, where)]
    ]


def test_plain_python_gives_the_torques_of_the_compiled_law(tmp_path):
    words = "import sys, numpy as np; from test_law_kkt import some_torques; "
    words += "np.savez(sys.argv[1], *some_torques())"
    path = os.pathsep.join((os.path.dirname(__file__), *sys.path))
    done = subprocess.run(
        [sys.executable, "-c", words, str(tmp_path / "tau.npz")], capture_output=True, text=True,
        timeout=500, env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    plain = np.load(tmp_path / "tau.npz")
    for name, want in zip(plain.files, some_torques(), strict=True):
        np.testing.assert_allclose(plain[name], want, rtol=0, atol=1e-12 * np.abs(want).max())
