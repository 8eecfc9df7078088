"""Ticks of the law, judged by one KKT system of arms, object and touched bodies.

`kkt_oracle` shares nothing with the law: it takes contacts from differences of gaps and arms from
Pinocchio. On more than 2,000 random states, all moving, brought about by any torques, it judges

    N, n_γ            of every contact
    α                 found in the wrist readings that these torques cause
    contact forces    that new torques bring: α_d and the first step of the force integral
    the object        of all accelerations that arms and contacts leave it, the one nearest to
                      p̈_d + K_d ė + K_p e + K_i ∫e in the metric of the motion filter
    squeeze           that arms of one kind exert on one another
    effort            of all torques that do this, with the squeeze and the posture, the least
    what is lost      of motion and forces where motors are too weak, and what is reported of it

Where columns nearly depend on one another, σ from it, forces answer accelerations with 1/σ²: the
tolerance grows with that. Near singular postures the law gives up motion, never force. Two arms
whose grasps pass on no squeeze are held. All of these are counted by themselves: the 2,000 states
are without them. `GapFunctions` has n_γ from differences, to 1e-9 only, and the inertia of an arm
near a singular posture makes 50 µN of 1e-10 m/s²: once compared, its n_γ is the oracle's, too.
"""

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice

import numpy as np
import pinocchio as pin
from grasp_rigs import BODY, KINDS, Case, random_case
from kkt_oracle import BODIES, PAIRS, PLAIN, WORLD, Answer, Body, Contact, State, touch
from numpy.linalg import inv, lstsq, norm, pinv, solve, svd
from numpy.random import default_rng
from processes import python
from pytest import mark, param
from rigs import (
    STILL,
    UNLIMITED,
    assert_near,
    data_at,
    displacement,
    largest,
    miss,
    posed,
    product,
    scara_pair,
    strong,
    touched_of,
    with_motors,
)
from samples import aligned, parametrize
from scipy.linalg import null_space
from test_linkage import bars_of

import osc_contact as osc
from benchmarks.cases import RandomRig
from osc_contact.settings.control import Friction, PostureTask

K_P = 400.0
K_D = 40.0
K_I = 2000.0
K_F = 30.0
DT = 1e-3
STATES = 84  # of each rig and surroundings, well apart and in ordinary postures
SOME = 6  # that every `make test` judges, of any kind; the others are slow
RTOL = 1e-9
FADED_RTOL = 1e-7
APART = 0.1
LEAST_APART = 0.03
FASTEST = 5.0
SLOWEST = 0.02  # m/s, rad/s; of what slides
ROUGH = {"bead_on_a_wire", "point_on_a_saddle"}  # gap functions


@cache
def columns(name):
    """r of a kind of pair."""
    return PAIRS[name](default_rng(0), PLAIN)[2]


# Arms ---------------------------------------------------------------------------------------------


def rigid_case(chain, q, X_WO):
    return Case(strong(chain), q, X_WO, [("rigid", grasp.X_TO, None) for grasp in chain.grasps])


def alike(kind):
    """One to four arms of a kind that permit the object the same motions."""

    def make(rng):
        rig = RandomRig([kind] * rng.integers(1, 5), rng)
        return rigid_case(rig.chain, rig.q, rig.X_WO)

    return make


def paper(rng):
    q, _, X_WO = posed(scara_pair(), rng)
    return rigid_case(scara_pair(), q, X_WO)


def any_arms(*grasps):
    """One to four arms of different kinds, in any posture."""

    def make(rng):
        while True:
            n = rng.integers(1, 5)
            arms = list(rng.choice(["ur5", "panda", "scara"], n))
            case = random_case(arms, list(rng.choice(grasps, n)), rng)
            try:
                chain = strong(case.chain)
                chain.state(case.q)
                osc.Controller(chain, [])
            except osc.ModelError:  # motions that no motor drives, or that no joint measures
                continue
            return replace(case, chain=chain)

    return make


@dataclass(frozen=True)
class Rig:
    """Properties of random arms, and number of motions that they leave to the object."""

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
    return WORLD


def on_bodies(rng, contacts):
    """A new body of any kind, or now and then one that is touched already, or the world."""
    chance = rng.random()
    if chance < 0.15:
        return WORLD
    if contacts and chance < 0.5:
        return contacts[rng.integers(len(contacts))].on
    return Body.random(rng.choice(sorted(BODIES)), rng, rng.uniform(-0.5, 0.5, 3))


def on_one(rng, contacts):
    """The body of the other contacts: how columns that depend share moves it nowhere else."""
    return contacts[0].on if contacts else on_bodies(rng, contacts)


@dataclass(frozen=True)
class Surroundings:
    """Touched bodies: positions, friction, and whether every contact occurs twice."""

    on: Callable
    pairs: tuple = tuple(sorted(PAIRS))
    mu: float = 0.0
    copied: bool = False


SURROUNDINGS = {
    "world": Surroundings(in_the_world),
    "bodies": Surroundings(on_bodies),
    "friction": Surroundings(on_bodies, ("vertex_on_face",), 0.3),
    "dependent": Surroundings(on_one, copied=True),
}


def touching_state(rest, i, rng, where):
    """In motion, with independent columns: the number gives the kind of the first, and r."""
    X_WO = rest.case.X_WO
    contacts = []
    N = np.zeros((0, 6))
    first = where.pairs[i % len(where.pairs)]
    most = rest.S.shape[1] - (where.mu > 0.0)  # what is held fast does not slide
    least = min(most, columns(first))
    r = least + (i // len(where.pairs)) % (most - least + 1)
    for attempt in range(100):
        if contacts and len(N) == r:
            break
        fit = [
            name for name in where.pairs if 0 < columns(name) <= r - len(N) and name not in ROUGH
        ]
        name = rng.choice(fit) if contacts or attempt > 4 else first
        body = where.on(rng, contacts)
        pair = touch(name, rng, body.X.actInv(X_WO))
        near = pair.contact(X_WO, STILL, body.X).N.T
        if rest.apart(np.vstack((N, near))) > LEAST_APART:
            contacts = [*contacts, Contact(name, pair, body, X_WO)]
            N = np.vstack((N, near))
    state = State(rest.case, contacts, where.mu, rest)
    state.move(rng)
    return state


# Ticks --------------------------------------------------------------------------------------------


@dataclass
class Tick:
    """A state, what acted on it before, what a controller was given there, and its torques."""

    state: State
    truth: Answer
    contacts: list
    controller: osc.Controller
    measured: osc.Measurement
    reference: osc.Reference
    B: object
    tau: np.ndarray
    controller_of: Callable  # a chain ↦ such a controller

    @property
    def copied(self):
        """Whether a contact counts twice."""
        return len(self.contacts) > len(self.state.contacts)


def tick(state, contacts, i, rng):
    """A controller's first tick at a state that any torques brought about; `contacts`: its own."""
    A = rng.standard_normal((6, 6))
    case = state.case
    k = len(case.chain.arms)
    rigid = all(grasp.is_rigid for grasp in case.chain.grasps)
    B = ("object", "chain", A @ A.T + np.eye(6))[i % 3]
    # the inertia of a chain in motions that it cannot make is no matter of the oracle's
    k_i = 0.0 if i % 3 == 1 and state.S.shape[1] < 6 else K_I
    controller_of = partial(
        osc.Controller,
        contacts=[c.pair for c in contacts],
        gains=osc.Gains(osc.MotionGains(K_P, K_D, k_i), osc.ForceGains(K_F, 5.0)),
        B=B,
        bodies=[c.on.given for c in contacts],
        friction=Friction(state.mu, slip=1e-9) if state.mu else None,
        reading=("filter", "filter", None)[i // 2 % 3],
        posture=case.q + 0.1 * rng.standard_normal(case.chain.nq),
        safety=UNLIMITED,  # random speeds are above the joints' limits
    )
    controller = controller_of(case.chain)
    touched = None
    if any(body is not WORLD for body in state.bodies):
        touched = touched_of([c.on.seen() for c in contacts])
    # six numbers an arm whatever its motors: the states that follow are the same for every rig
    truth = state.answer(np.resize(20.0 * rng.standard_normal((k, 6)), case.chain.n_a))
    measured = osc.Measurement(case.q, state.v, state.readings(truth), touched)
    squeeze = rng.uniform(-5.0, 5.0, k * (k - 1) // 2) * rigid
    reference = osc.Reference(
        case.X_WO * pin.exp6(0.02 * rng.standard_normal(6)),
        # with friction the measured slip is the commanded one, now and to come
        state.V if state.mu else 0.1 * rng.standard_normal(6),
        rng.standard_normal(6) * (state.mu == 0.0),
        rng.uniform(5.0, 20.0, sum(len(c.along_object) for c in contacts)),
        squeeze if rigid and k > 2 else squeeze.sum() if k == 2 else 0.0,
    )
    tau = controller.tick(measured, reference)
    return Tick(state, truth, contacts, controller, measured, reference, B, tau, controller_of)


def ticks(rig, surroundings):
    """Ticks at random states without end, always the same ones."""
    names = [*RIGS, *SURROUNDINGS]
    where = SURROUNDINGS[surroundings]
    rng = default_rng([names.index(rig), names.index(surroundings)])
    i = 0
    while True:
        if i % 4 == 0:
            rest = State(RIGS[rig].make(rng), [])
        state = touching_state(rest, i, rng, where)
        if max(largest(state.v), largest(state.V)) > FASTEST:
            continue
        if where.mu and min(norm(c.slip(state.V)[0]) for c in state.contacts) < SLOWEST:
            continue
        copies = rng.integers(len(state.contacts), size=3 if where.copied else 0)
        yield tick(state, state.contacts + [state.contacts[j] for j in copies], i, rng)
        i += 1


def parts_of_contacts(t):
    """Results of the law for each contact, with the contact."""
    contacts = [c for c in t.contacts if len(c.along_object)]  # not what may move in every way
    return aligned(t.controller.signals.parts, contacts)


def miss_of_geometry(t):
    """Errors of N and n_γ of every contact."""
    errors = [0.0]
    for part, c in parts_of_contacts(t):
        errors += [miss(part.N, -c.along_object.T), miss(part.n_gamma, c.n_gamma(t.state.V))]
    return max(errors)


def miss_of_forces(t, got, magnitudes):
    """Error of the contact forces; how dependent columns share them is not determined."""
    if not t.copied:
        return miss(got, magnitudes)
    N = np.vstack([c.along_object for c in t.contacts]).T
    return miss(t.state.N.T @ got, N @ magnitudes)


def miss_of_reading(t):
    """Error of the contact forces found in the wrist readings."""
    found = t.controller.result()
    if t.controller.reading != "filter":
        return 0.0
    return max(
        miss(found.f_c, -t.state.N.T @ t.truth.alpha),
        0.0 if t.copied else miss(found.alpha_meas, t.truth.alpha),
    )


def commanded_forces(t):
    """α_d and its first integral, of all columns."""
    found = t.controller.result()
    alpha_d = t.reference.alpha_d
    measured = found.alpha_meas
    if t.copied:
        N = np.vstack([c.along_object for c in t.contacts]).T
        measured = lstsq(-N, found.f_c, rcond=1e-9)[0]
    return alpha_d + K_F * DT * (alpha_d - measured)


def miss_of_response(t, answer):
    """Errors of eqs. 14 to 20 in six-vectors: what these torques make of object and contacts."""
    s = t.controller.signals
    got = osc.contact_response(s.state, s.contact, s.environment, tau=t.tau)
    spatial = answer.a - product(t.state.V)
    return max(miss(got.acceleration, spatial), miss(got.f_c, -t.state.N.T @ answer.alpha))


def metric_of(t):
    """(6, 6) B⁻¹ of the motion filter."""
    known = {"object": lambda: t.state.system.I, "chain": t.state.inertia_of_all}
    return known.get(str(t.B), lambda: inv(t.B))()


def commanded_motion(t, a):
    """The acceleration nearest to the motion law, a (6,) along the contacts."""
    state = t.state
    reference = t.reference
    error = displacement(t.state.case.X_WO, reference.X_WD)
    metric = metric_of(t)
    command = reference.A_D + K_D * (reference.V_D - state.V) + K_P * error
    if k_i := t.controller.gains.motion.integral:  # of the part of the error that contacts permit
        mobile = solve(metric, state.N.T)
        blocked = lstsq(state.N @ mobile, state.N @ error, rcond=1e-12)[0]
        command = command + k_i * DT * (error - mobile @ blocked)
    command = state.nearest(state.system.I, command, state.N @ command)
    return state.nearest(metric, command, state.N @ a)


def bars(t):
    """E⁺ (bars, 3 arms): by how much arms that push so press their grasps together, and E."""
    chain = t.state.case.chain
    if len(chain.arms) < 2:
        return (np.zeros((0, 3)), np.zeros((3, 0)))
    tips = chain.tip_poses(data_at(chain.model, t.state.case.q))
    E = bars_of([X.translation for X in tips])
    return (pinv(E, rcond=1e-6), E)


def miss_of_squeeze(t, answer):
    """Error of the bar forces, of those that the bars determine."""
    share, E = bars(t)
    pulls = np.concatenate([loop[:3] for loop in answer.loops])
    return miss(share @ (pulls - E @ np.broadcast_to(t.reference.squeeze_d, E.shape[1])), 0.0)


def miss_of_what_weaker_motors_cost(t, answer):
    """Errors of the motion and the forces that a saturated controller reports as given up."""
    controller = t.controller_of(with_motors(t.state.case.chain, 0.7 * np.abs(t.tau) + 1e-3))
    came = t.state.answer(controller.tick(t.measured, t.reference))
    assert controller.status is osc.Status.SATURATED, controller.reason
    lost = controller.given_up
    motion = largest(answer.a - came.a - lost.acceleration) / max(1.0, largest(answer.a))
    return max(motion, largest(answer.alpha - came.alpha - lost.force))


def effort_in_vain(t):
    """Share of the torques' effort that could be spared: same motion, forces and squeeze."""
    chain = t.state.case.chain
    state = t.state
    scale = chain.tau_max
    M = state.system.M
    pull = PostureTask().stiffness * (t.controller.posture - state.case.q)
    pull = state.system.h + M @ (pull - PostureTask().damping * state.v)
    idle = null_space(state.grasps[:, : chain.nq]).T  # what moves no tip
    posture = M @ idle.T @ solve(idle @ M @ idle.T, idle @ pull)
    idle = idle[:, chain.actuated]
    posture = posture[chain.actuated]
    share = bars(t)[0]

    def outcome(tau):
        x = state.answer(tau)
        pulls = np.concatenate([loop[:3] for loop in x.loops])
        return np.concatenate((x.a, state.N.T @ x.alpha, share @ pulls, idle @ tau))

    at = outcome(t.tau)
    columns = [outcome(t.tau + size * np.eye(len(scale))[i]) - at for i, size in enumerate(scale)]
    _, sizes, Vh = svd(np.array(columns).T / largest(columns))
    spare = Vh[np.count_nonzero(sizes > 1e-8) :]
    task = (t.tau - posture) / scale
    assert largest(idle @ (t.tau - pull[chain.actuated])) < 1e-6 * max(scale)
    return largest(spare @ task) / largest(task)


def judge(t):
    """Count a tick by its kind after everything that the oracle gives of it has been compared."""
    state = t.state
    status = t.controller.status
    names = {c.name for c in t.contacts}
    if status is osc.Status.HELD:
        assert "motors cannot drive" in t.controller.reason, t.controller.reason
        assert len(state.case.grasps) == 2
        assert not all(grasp.is_rigid for grasp in state.case.chain.grasps)
        return "held"
    apart = state.apart()
    looser = max(1.0, (APART / apart) ** 2)
    rtol = looser * RTOL
    geometry = miss_of_geometry(t)
    for part, c in parts_of_contacts(t):
        if c.name in ROUGH:
            c.bent = part.n_gamma - c.n_gamma(state.V) + c.bend(state.V)
    answer = state.answer(t.tau)
    misses = {
        "geometry": 0.01 * geometry,  # differences, where edges are all but parallel
        "reading": 0.01 * miss_of_reading(t),
        "force": miss_of_forces(t, answer.alpha, commanded_forces(t)),
        "response": 0.0 if state.mu else miss_of_response(t, answer),
    }
    kind = "near" if apart < APART else "well apart"
    if status is osc.Status.DEGRADED:
        rtol = max(rtol, FADED_RTOL * looser)
        kind = "faded"
    else:
        assert status is osc.Status.OK
        misses["motion"] = miss(answer.a, commanded_motion(t, answer.a))
        chain = state.case.chain
        alike = len({arm.model.nv for arm in chain.arms}) == 1
        if alike and all(grasp.is_rigid for grasp in chain.grasps):  # else structure may carry some
            misses["squeeze"] = miss_of_squeeze(t, answer)
        if not t.copied:
            misses["given up"] = 0.01 * miss_of_what_weaker_motors_cost(t, answer)
    assert max(misses.values()) < rtol, (misses, rtol, state.S.shape, names, apart)
    return kind


@parametrize("surroundings", SURROUNDINGS)
@parametrize("rig", RIGS)
def test_a_state(rig, surroundings):
    """Fast without compilation: judges small faults put into the law."""
    for t, _ in zip(ticks(rig, surroundings), range(SOME), strict=False):
        judge(t)
        if rig != "any grasps" and t.controller.status is osc.Status.OK:
            assert effort_in_vain(t) < 1e-6


@mark.slow
@parametrize("surroundings", SURROUNDINGS)
@parametrize("rig", RIGS)
def test_torques_bring_the_commanded_forces_and_motion(rig, surroundings):
    count = Counter()
    seen = defaultdict(set)
    where = SURROUNDINGS[surroundings]
    for t in islice(ticks(rig, surroundings), 8 * STATES):
        state = t.state
        count[judge(t)] += 1
        if t.controller.status is not osc.Status.OK:
            continue
        seen["d"].add(state.S.shape[1])
        seen["r"].add(len(state.N))
        seen["arms"].add(len(state.case.chain.arms))
        seen["grasps"].update(kind for kind, *_ in state.case.grasps)
        seen["pairs"].update(c.name for c in t.contacts)
        seen["bodies"].update(body.name for body in state.bodies)
        if count["well apart"] >= STATES and seen["grasps"] == set(RIGS[rig].grasps):
            break  # of arms that hold by a plane one in fourteen is far from singular
    d = max(RIGS[rig].d)
    mixed = len(RIGS[rig].d) > 1
    assert seen["d"] >= RIGS[rig].d if mixed else seen["d"] == RIGS[rig].d
    assert seen["r"] >= set(range(mixed or where.mu > 0.0, d + 1 - (where.mu > 0.0)))
    assert seen["arms"] >= ({2} if rig == "paper" else {2, 3, 4} if mixed else {1, 2, 3, 4})
    assert seen["grasps"] == set(RIGS[rig].grasps)
    assert seen["bodies"] == ({"world"} if where.on is in_the_world else {"world", *BODIES})
    assert seen["pairs"] >= {name for name in where.pairs if rig == "ur5" or columns(name) < 2}
    assert count["near"] < 2 * STATES
    assert count["held"] < 4 * STATES * mixed + 1
    assert (
        count["faded"] < 4 * STATES * mixed + 5
    )  # one drawn planar arm is near a singular posture


@parametrize("arms", [3, 5])
def test_arms_that_differ_and_hold_with_balls_squeeze_as_commanded(arms):
    """Five arms have ten bars, nine of which are independent."""
    rng = default_rng([70, arms])
    for i in range(3):
        kinds = ["ball", "rigid", *rng.choice(["rigid", "ball"], arms - 2)]
        case = random_case(["ur5", *rng.choice(["ur5", "panda"], arms - 2), "panda"], kinds, rng)
        rest = State(replace(case, chain=strong(case.chain)), [])
        state = touching_state(rest, i, rng, SURROUNDINGS["world"])
        t = tick(state, state.contacts, i, rng)
        for squeeze in (20.0 * rng.standard_normal(arms * (arms - 1) // 2), 7.5):
            reference = replace(t.reference, squeeze_d=squeeze)
            controller = t.controller_of(state.case.chain)
            tau = controller.tick(t.measured, reference)
            t = replace(t, reference=reference, controller=controller, tau=tau)
            assert judge(t) != "held"
            assert miss_of_squeeze(t, state.answer(tau)) < 1e-8


# Near singular postures ---------------------------------------------------------------------------


def nearly_singular(rng, n, weight):
    """One to three UR5s, the elbow of the first straight, and now and then its wrist."""
    body = pin.Inertia(weight * BODY.mass, BODY.lever, weight * BODY.inertia)
    bends = [10.0 ** rng.uniform(-4.5, -1.0), *rng.uniform(0.5, 1.5, n - 1)]
    case = random_case(["ur5"] * n, ["rigid"] * n, rng, bends=bends, body=body)
    return replace(case, chain=strong(case.chain))


@parametrize("weight", [1.0, 1e-2])
@parametrize("n", [1, 2, 3])
def test_near_singular_postures_motion_is_given_up_and_force_is_not(n, weight):
    """Down to where rounding locks a direction, with one to six columns, an object light or not."""
    rng = default_rng([n, int(1.0 / weight)])
    found = defaultdict(list)
    for i in range(48):
        if i % 4 == 0:
            rest = State(nearly_singular(rng, n, weight), [])
        state = touching_state(rest, i, rng, SURROUNDINGS["world"])
        if max(largest(state.v), largest(state.V)) > FASTEST:
            continue
        t = tick(state, state.contacts, i, rng)
        assert t.controller.status is osc.Status.DEGRADED, t.controller.reason
        least = min(lost.chi for lost in t.controller.signals.state.singular_directions)
        off = miss_of_forces(t, state.answer(t.tau).alpha, commanded_forces(t))
        assert off < 1e-12 / (state.apart() * least) ** 2 + 1e-9, (off, least, state.apart())
        found[len(state.N)].append(least)
    assert set(found) == set(range(7))
    assert min(map(min, found.values())) < 3e-4


# Without compilation ------------------------------------------------------------------------------


def some_torques():
    """Torques of the first ticks of each rig and surroundings, one behind the other."""
    return [
        next(made).tau for rig in RIGS for where in SURROUNDINGS for made in [ticks(rig, where)]
    ]


@parametrize("how", ["NUMBA_DISABLE_JIT", param("NUMBA_BOUNDSCHECK", marks=mark.slow)])
def test_the_same_without_compilation_and_with_checked_bounds(how, tmp_path):
    words = "import sys, numpy as np; from test_law_kkt import some_torques; "
    words += "np.savez(sys.argv[1], *some_torques())"
    file = tmp_path / "tau.npz"
    where = {how: "1", "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "OSC_CONTACT_LAW": "jit"}
    python("-c", words, file, **where)
    found = np.load(file)
    for name, expected in aligned(found.files, some_torques()):
        assert_near(found[name], expected, atol=1e-12 * largest(expected), rtol=0)
