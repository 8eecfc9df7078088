"""Description of a state of contact in words: d, r, free motions, controllable forces."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.feet import contact_at, feet
from osc_contact.contacts.pairs.pair import ContactPair, has_known_points, pushes_only
from osc_contact.contacts.pairs.points_on_planes import VertexOnFace
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.files import Json
from osc_contact.lab.checks.states import undistinguished
from osc_contact.lab.rig.dither import gain_in_words, known_to
from osc_contact.lab.rig.landings import landings
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.visual.screws import common_perpendicular, echelon
from osc_contact.law.joint_friction import LAG
from osc_contact.plan.ends import End
from osc_contact.plan.stage import Stage
from osc_contact.robots.summary import friction_warnings, joint_losses, loss_words
from osc_contact.spatial import Array, norm


@dataclass(frozen=True)
class Inspection:
    """The contact state of a scenario at its start, of the contacts that are active there.

    Attributes:
        d: motions the object can make.
        r: independent contact forces.
        lines: the report, one sentence each.
        N, T: bases (6, r), (6, 6−r), columns of N named by `contacts` (``pad.1``, … if several).
        free: (6, d−r) the motions that are both possible for the arms and permitted by the contact.
        conditioning: largest over smallest apparent mobility of the contact forces, unit-free.
    """

    d: int
    r: int
    lines: tuple[str, ...]
    contacts: tuple[str, ...]
    N: Array
    T: Array
    free: Array
    conditioning: float

    def as_dict(self) -> Json:
        """JSON-able form."""
        values = {name: np.asarray(value).tolist() for name, value in vars(self).items()}
        return values | {"free_motions": self.d - self.r}


def inspect_rig(rig: Rig) -> Inspection:
    """Describe the contact state of a rig at its start: d, r, forces, free motions, conditioning.

    The contacts are those that are active first. Conditioning is the ratio of the largest to the
    least eigenvalue of the mobility NᵀΦN, scaled to a diagonal of 1: 1 for independent forces.

    Args:
        rig: rig of a scenario.

    Returns:
        Numbers d and r, N and T (at O in world axes), and lines of text.
    """
    state = rig.state
    active = rig.references.stages[0][1] if rig.references.stages else np.ones(len(rig.pairs))
    pairs = [rig.pairs[i] for i in np.flatnonzero(active)]
    contact = contact_at(pairs, state.X_WO)
    free = _free_motions(state, contact)
    mobility = contact.N.T @ state.Phi @ contact.N
    scale = np.sqrt(np.diag(mobility))
    values = np.linalg.eigvalsh(mobility / np.outer(scale, scale)) if contact.r else np.ones(1)
    conditioning = float(values[-1] / values[0])
    motors = rig.chain.n_a
    arm_motions = sum(t.J.shape[1] - t.rank for t in state.arms)  # motions of an arm alone
    internal = motors - arm_motions - (int(np.linalg.matrix_rank(state.G)) if state.d else 0)
    lines = (
        f"{len(rig.chain.arms)} arm(s), {rig.chain.nq} joints, {motors} motors; "
        f"the object can make d = {state.d} independent motions.",
        *(
            f"the arms' structure carries the wrench {_wrench_words(c)}: it cannot be controlled."
            for c in state.C.T
        ),
        f"{len(pairs)} contact(s) constrain r = {contact.r} of them; "
        f"{state.d - contact.r} motions stay free, {contact.r} contact forces can be controlled.",
        *(
            f"joints of '{arm.name}': {loss_words(joint_losses(arm.model))}"
            for arm in rig.chain.arms
        ),
        *_friction_sentences(rig),
        *(_stage_sentences(rig) if rig.scenario.plan is None else _plan_stages(rig)),
        *_contact_lines(rig),
        *(f"{one.sentence} (v √(k m))." for one in landings(rig)),
        *_line_distances(rig),
        *_normal_sentences(rig),
        *undistinguished(rig),
        *(f"free motion {i + 1}: {_twist_words(t)}" for i, t in enumerate(free.T)),
        *_redundancy_sentences(len(rig.chain.arms), internal, arm_motions),
        f"conditioning of the contact forces: {conditioning:.3g} (1 = independent of each other)",
    )
    return Inspection(
        d=state.d,
        r=contact.r,
        lines=lines,
        contacts=tuple(np.array(rig.force_names)[active[rig.owners] != 0.0].tolist()),
        N=contact.N,
        T=contact.T,
        free=free,
        conditioning=conditioning,
    )


def _stage_sentences(rig: Rig) -> Iterator[str]:
    """Sentences on the sets of contacts that are named active, one after the other.

    Args:
        rig: rig of the scenario.
    """
    stages = rig.references.stages
    ends = [begin for begin, _ in stages[1:]] + [rig.scenario.duration]
    for (begin, active), end in zip(stages, ends, strict=False):  # none if no set is named
        active_pairs = [
            pair for pair, is_active in zip(rig.pairs, active, strict=True) if is_active
        ]
        inactive_names = [
            f"'{pair.name}'"
            for pair, is_active in zip(rig.pairs, active, strict=True)
            if not is_active
        ]
        r = contact_at(active_pairs, rig.state.X_WO).r
        names = ", ".join(f"'{pair.name}'" for pair in active_pairs) or "none"
        inactive_text = (
            f"; known, not active: {', '.join(inactive_names)}." if inactive_names else "."
        )
        free = f"(r = {r}, {rig.state.d - r} motions free)"
        yield f"active from {begin:.4g} s to {end:.4g} s: {names} {free}{inactive_text}"


def _plan_stages(rig: Rig) -> Iterator[str]:
    """Sentences on the stages of a plan: contacts and forces, motion, ends, stages that follow.

    Args:
        rig: rig of a scenario with a plan.
    """
    assert rig.scenario.plan is not None
    plan = rig.scenario.plan.made()
    for k, stage in enumerate(plan.stages):
        pairs = [pair for pair in rig.pairs if pair.name in stage.forces]
        r = contact_at(pairs, rig.state.X_WO).r
        forces = ", ".join(f"'{name}' {_force_words(f)} N" for name, f in stage.forces.items())
        last = k + 1 == len(plan.stages)
        then = stage.then or ("end" if last else plan.stages[k + 1].name)
        fails = stage.fails or "end, failed"
        yield (
            f"stage '{stage.name}': {forces or 'no contacts'} (r = {r}, {rig.state.d - r} motions "
            f"free), {stage.motion.words}; ends by: {_end_words(stage.until)} → {then}; "
            f"fails after {stage.within:g} s{_failure_words(stage)} → {fails}."
        )


def _end_words(condition: object) -> str:
    """Words of a condition, which a stage has made an `End`."""
    assert isinstance(condition, End)
    return condition.words


def _force_words(force: float | Sequence[float]) -> str:
    """Forces of a contact in words, with + between several (N)."""
    return " + ".join(f"{value:g}" for value in np.atleast_1d(force))


def _failure_words(stage: Stage) -> str:
    """Conditions besides time with which a stage fails, in words."""
    words = "" if stage.unless is None else f", or by: {_end_words(stage.unless)}"
    return words + ("" if stage.largest == np.inf else f", or above {stage.largest:g} N")


def _friction_sentences(rig: Rig) -> Iterator[str]:
    """Sentences on modelled friction and rotors that limit accuracy or stability of control.

    Args:
        rig: rig of the scenario.
    """
    how = rig.joint_friction
    for arm, joints in zip(rig.model.arms, rig.model.slices, strict=True):
        share = how.share if how and (how.learning or how.errors) else 0.0
        q = rig.q_contact[joints]
        passive = arm.passive_joints
        for words in friction_warnings(arm.model, q, share, 1.0 / LAG, passive):
            yield f"joints of '{arm.name}': {words}"


def _normal_sentences(rig: Rig) -> Iterator[str]:
    """Sentences on contact normals that the motion does not reveal, and the resulting errors.

    Args:
        rig: rig of the scenario.
    """
    std = 0.5 * rig.gains.force.tilt
    if std == 0.0:
        return
    moves = rig.references.overview[1].V_D.any()
    for pair in rig.pairs:
        if has_known_points(pair) and not moves:
            yield (
                f"the normal of '{pair.name}' cannot be observed: no motion is commanded; it is "
                "taken as given."
            )
    share = known_to(rig.pairs, rig.state, 1.0)
    if rig.scenario.control.dither is None and (words := gain_in_words(share, std)):
        yield f"with normals known to {np.rad2deg(std):.3g} deg (gains.force.tilt / 2), {words}."


def _free_motions(state: ChainState, contact: Contact) -> Array:
    """Basis of range(S) ∩ T, echelon form: translations first, as simple as they come."""
    Vh = np.linalg.svd(contact.N.T @ state.S)[2]
    return echelon(state.S @ Vh[contact.r :].T)


def _redundancy_sentences(arms: int, internal: int, arm_motions: int) -> Iterator[str]:
    """Sentences on internal forces and null-space motions.

    Args:
        arms: number of arms.
        internal: number of internal forces.
        arm_motions: number of null-space motions.
    """
    if internal or arms > 1:
        yield (
            f"{internal} internal force(s) can be set without moving the object or pressing harder"
            + (" (squeeze along the grasp line is one)." if arms == 2 else ".")
        )
    if arm_motions:
        yield f"{arm_motions} motion(s) of arms leave the object where it is: postures to choose."


def _contact_lines(rig: Rig) -> Iterator[str]:
    """Sentences on each contact of a rig: directions, points (m) and signs of its forces.

    Directions are in world axes, points from the object's origin.

    Args:
        rig: rig of a scenario.
    """
    X = rig.state.X_WO
    for i, pair in enumerate(rig.pairs):
        points, directions = feet(pair, X)
        if len(points) == 1:
            kind = (
                "the face"
                if isinstance(pair, VertexOnFace)
                else f"the {_pair_words(pair).split()[-1]} of '{_touched_body(rig, i)}'"
            )
            yield (
                f"contact '{pair.name}': force along {_vector_text(directions[0])} into {kind}, "
                f"through {_vector_text(points[0])} m."
            )
            continue
        sign = "pushing only" if pushes_only(pair) else "of either sign"
        yield (
            f"contact '{pair.name}' ({_pair_words(pair)} of '{_touched_body(rig, i)}'): "
            f"{len(points)} forces at once, {sign}; any force and couple it transmits is made of "
            "them:"
        )
        for k, (p, d) in enumerate(zip(points, directions, strict=True)):
            yield f"  {pair.name}.{k + 1} along {_vector_text(d)} through {_vector_text(p)} m"


def _pair_words(pair: ContactPair) -> str:
    """FaceOnFace → face on face."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", type(pair).__name__).lower()


def _touched_body(rig: Rig, contact: int) -> str:
    """Name of the body that a contact touches, by the index of the contact."""
    return rig.bodies[rig.on[contact]].name


def _line_distances(rig: Rig) -> Iterator[str]:
    """Describe distance and angle of the lines of force of all pairs of contacts with one line.

    Args:
        rig: rig, whose pairs are taken at the pose of its start.

    Yields:
        One sentence for two contacts: parallel, skew or meeting lines.
    """
    lines = [(pair, *feet(pair, rig.state.X_WO)) for pair in rig.pairs]
    for (a, p, d), (b, q, e) in combinations([line for line in lines if len(line[1]) == 1], 2):
        normal = common_perpendicular(p[0], d[0], q[0], e[0])
        names = f"'{a.name}' and '{b.name}'"
        gap = f"{1e3 * normal.distance:.1f} mm apart"
        if normal.angle < 1e-9:
            yield f"{names} press along parallel lines, {gap}."
            continue
        skew = normal.distance > 1e-6
        kind = "skew: no single frame's axes hold both" if skew else "they meet in a point"
        yield (
            f"the lines of force of {names} enclose {np.degrees(normal.angle):.1f}° and pass "
            f"{gap} ({kind})."
        )


def _twist_words(twist: Array) -> str:
    """Words for a twist at the object's origin: a translation, or a turn about a line with a pitch.

    A turn is described by the direction of its axis, the point of the axis nearest to the object's
    origin (m), and the advance along it (mm/rad).

    Args:
        twist: (6,) at the object's origin, in world axes; not zero.
    """
    v, w = np.split(twist, 2)
    if norm(w) < 1e-9 * max(norm(v), 1.0):
        return f"translation along {_vector_text(v / norm(v))}"
    turn = w / norm(w)
    speed = v / norm(w)
    pitch = turn @ speed
    point = np.cross(turn, speed)
    axis = f"{_vector_text(turn)} through {_vector_text(point)} m"
    words = f"turning about {axis} from the object's origin"
    return words + (f", advancing {1e3 * pitch:.1f} mm/rad" if abs(pitch) > 5e-5 else "")


def _wrench_words(wrench: Array) -> str:
    """Words for a wrench (6,) up to its size: a direction of force, or of a couple, or both."""
    force, couple = np.split(wrench, 2)
    if norm(force) < 1e-6 * norm(couple):
        return f"couple about {_vector_text(couple / norm(couple))}"
    size = norm(force)
    return f"force along {_vector_text(force / size)} with couple {_vector_text(couple / size)} m"


def _vector_text(x: Array) -> str:
    """Write a vector with three decimals, without −0."""
    return f"[{', '.join(f'{value:.3f}' for value in np.round(x, 3) + 0.0)}]"
