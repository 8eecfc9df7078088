"""Contact states recognised during insertions of a square peg, against the true contacts.

    python -m benchmarks.recognition [--count 5] [--seed 7000] [--folder out/insertions]
        [--clearance 0.2]

The insertions are those of `benchmarks.assembly`, recorded once for each seed; their rows and
their summary are printed, too. The recogniser reads
the pose of the peg from the encoders and the wrench, low-passed with 5 ms, every 10 ms; it believes
the hole at its modelled pose and does not know its friction. A state counts from 50 ms after a
change on, until the peg is in the hole. Contacts that carry less than the friction of the others
are not distinguished from it: true ones need not be in the recognised state, and recognised ones
need not be true. The share without this rule stands beside. Shares are averaged over the groups.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from time import perf_counter

import numpy as np
import pinocchio as pin
import typer
from rich.console import Console

from benchmarks.assembly import row_of, summary
from benchmarks.measuring import without_log
from benchmarks.recorded_insertions import CLEARANCE, recorded, result_in
from osc_contact.contacts.insertion import Hole, Peg, pairs_between
from osc_contact.lab.tasks.insertion import BASE, LENGTH, WIDTH, Insertion
from osc_contact.lab.tasks.pegs import peg_plan, peg_start
from osc_contact.recognition.recogniser import Recogniser
from osc_contact.recognition.states import ContactStates, WrenchErrors
from osc_contact.spatial import Array

EVERY = 10  #: ticks of 1 ms between two instants
SMOOTHING = 5e-3  #: time constant of the low-pass of the wrench (s)
SETTLED = 0.05  #: time after a change from which on a state counts (s)
NOTICED = 0.1  #: time within which a contact that a stage does not assume is to be noticed (s)
FORCE = 3.5  #: force of contacts of the plan, for which groups are stated (N)
LEAST = 0.3  #: force from which on a true contact counts (N)
NEAR = 1e-3  #: distance from rims and mouth within which a contact is at a rim (m)
FLAT = 0.7  #: least component along the hole's axis of the normal of the face and of its edges
INSIDE = "inside"  #: contacts with walls, bottom and other rims, with which the search has ended
OTHER = "elsewhere"  #: contacts that are none of these
#: Errors that are believed: the wrench is low-passed, friction is at most this.
ERRORS = WrenchErrors(
    force=0.1,
    torque=0.01,
    sensor=(0.0, 0.0, -BASE - LENGTH),
    position=1.2e-3,
    angle=0.02,
    friction=0.3,
    expected=2.0,
)
#: Contacts of the search, each by its pairs; those with a rim act anywhere between two points.
SEARCH = {
    "corner": ["corner +x+y on face"],
    "edge -x": ["edge +y on rim -x"],
    "edge -y": ["edge +x on rim -y"],
    "side +x": ["side +x on rim +x, a", "side +x on rim +x, b"],
    "side +y": ["side +y on rim +y, a", "side +y on rim +y, b"],
}
#: Contacts that each stage assumes. The tip on the face is carried by edges of the tip.
ASSUMED = {
    "find": frozenset({"corner"}),
    "slide": frozenset({"corner"}),
    "drop": frozenset({"corner"}),
    "two points": frozenset({"edge -x", "edge -y"}),
    "corner": frozenset({"edge -x", "edge -y", "side +x", "side +y"}),
    "upright": frozenset({"edge -x", "edge -y", "side +x", "side +y"}),
    "turn on": frozenset({"edge -x", "edge -y", "side +x", "side +y"}),
}


def square_peg_states() -> dict[str, list[str]]:
    """Names of the pairs of the 17 states of the search: free, corner, and edges and sides."""
    states: dict[str, list[str]] = {"free": [], "corner": SEARCH["corner"]}
    for count in (1, 2, 3, 4):
        for chosen in combinations(list(SEARCH)[1:], count):
            states[" + ".join(chosen)] = [pair for one in chosen for pair in SEARCH[one]]
    return states


def true_forces(contacts: Array, hole: Hole) -> dict[str, float]:
    """True force of each contact of a millisecond, by name (N).

    Args:
        contacts: (k, 9) point, normal and force of each, world axes; NaN beyond the last one.
        hole: true hole.
    """
    half = 0.5 * hole.width
    found: dict[str, float] = defaultdict(float)
    for row in contacts[np.isfinite(contacts[:, 0])].astype(np.float64):
        p = hole.pose.actInv(row[:3])
        n = np.abs(hole.pose.rotation.T @ row[3:6])
        if n[2] > FLAT:
            name = "edge -x" if p[0] < NEAR - half else "edge -y" if p[1] < NEAR - half else OTHER
            if max(abs(p[0]), abs(p[1])) > half + NEAR or min(p[0], p[1]) > 0.0:
                name = "corner"
            if p[2] > 0.5 * hole.depth:
                name = INSIDE
        else:
            axis = int(n[1] > n[0])
            name = f"side {'+' if p[axis] > 0.0 else '-'}{'xy'[axis]}"
            if p[2] > NEAR or name not in SEARCH:
                name = INSIDE
        found[name] += float(np.linalg.norm(row[6:]))
    return found


@dataclass(frozen=True)
class Truth:
    """True contacts at an instant, by their median forces within 9 ms.

    Attributes:
        forces: force of each contact (N).
        touched: names of the contacts that carried a force at any time within the last 5 ms. One
            that closes and opens every millisecond may have a median of zero.
    """

    forces: dict[str, float]
    touched: frozenset[str] = frozenset()

    @property
    def contacts(self) -> frozenset[str]:
        """Names of the contacts that carry a force."""
        return frozenset(name for name, force in self.forces.items() if force > LEAST)

    def beyond(self, force: float) -> frozenset[str]:
        """Contacts that carry some force (N) more than the friction that is believed of others."""
        total = sum(self.forces.values())
        return frozenset(
            name
            for name in self.contacts
            if self.forces[name] > force + ERRORS.friction * (total - self.forces[name])
        )


def true_instants(contacts: Array, hole: Hole) -> list[Truth]:
    """True contacts at every instant.

    Args:
        contacts: (ticks, k, 9) true contacts of each millisecond.
        hole: true hole.
    """
    each = [true_forces(rows, hole) for rows in contacts]
    found = []
    for k in range(0, len(each), EVERY):
        near = each[max(0, k - 4) : k + 5]
        past = each[max(0, k - 4) : k + 1]
        names = sorted({name for forces in near for name in forces})
        medians = {name: float(np.median([one.get(name, 0.0) for one in near])) for name in names}
        forces = {name: force for name, force in medians.items() if force > 0.0}
        touched = frozenset(name for one in past for name in one if one[name] > LEAST)
        found.append(Truth(forces, touched))
    return found


def smoothed(wrenches: Array) -> Array:
    """Wrenches (ticks, 6), low-passed."""
    share = 1e-3 / (SMOOTHING + 1e-3)
    result = np.empty_like(wrenches)
    last = wrenches[0]
    for k, wrench in enumerate(wrenches):
        last = last + share * (wrench - last)
        result[k] = last
    return result


@dataclass
class Tally:
    """Counts over several insertions.

    Attributes:
        right: whether each instant was right, by the group of its true contacts that are not below
            the friction of others.
        strict: the same with all contacts above 0.3 N.
        confused: counts of true and recognised states.
        delays: time from the beginning of a contact that the stage does not assume, and that
            carries 1 N more than friction explains, to the alarm (s); inf: none.
        alarms: alarms without a touch of such a contact.
        alarms_by_median: alarms where no such contact had a median force.
        watched: time of the watch (s).
        costs: computing times of an instant (s).
    """

    right: dict[str, list[bool]] = field(default_factory=lambda: defaultdict(list))
    strict: dict[str, list[bool]] = field(default_factory=lambda: defaultdict(list))
    confused: Counter[str] = field(default_factory=Counter)
    delays: list[float] = field(default_factory=list)
    alarms: int = 0
    alarms_by_median: int = 0
    watched: float = 0.0
    costs: list[float] = field(default_factory=list)

    def judge(self, truth: Truth, recogniser: Recogniser, group: dict[str, str]) -> None:
        """Compare a recognised state with the truth.

        Args:
            truth: true contacts.
            recogniser: filter.
            group: name of the group of each state.
        """
        state = recogniser.state
        whole = name_of(truth.contacts)
        if whole in group:
            self.strict[group[whole]].append(group[state] == group[whole])
        strong = truth.beyond(0.0)
        name = name_of(strong)
        certain = Truth(seen_forces(recogniser)).beyond(0.0)
        right = strong <= contacts_of(state) and certain <= frozenset(truth.forces)
        right = right or group[state] == group[name]
        self.right[group[name]].append(right)
        if not right:
            self.confused[f"{name}, recognised as {state}"] += 1


def seen_forces(recogniser: Recogniser) -> dict[str, float]:
    """Force of each contact of the recognised state (N)."""
    forces = recogniser.forces
    return {
        name: sum(forces[pair] for pair in pairs)
        for name, pairs in SEARCH.items()
        if set(pairs) <= set(forces)
    }


def name_of(contacts: frozenset[str]) -> str:
    """Name of the state with some contacts."""
    return " + ".join(name for name in SEARCH if name in contacts) or "free"


def contacts_of(state: str) -> frozenset[str]:
    """Contacts of a state by its name."""
    return frozenset(() if state == "free" else state.split(" + "))


def states_of(peg: Peg, hole: Hole) -> ContactStates:
    """Candidates for a peg and the hole in the model, with the errors that are believed."""
    return ContactStates(square_peg_states(), pairs_between(peg, hole), ERRORS)


def groups_of(states: ContactStates, peg: Peg, hole: Hole) -> dict[str, str]:
    """Name of the group of each state, with a corner of the peg in the mouth of the hole."""
    rotation = (hole.pose.actInv(peg_start(peg, hole))).rotation
    X = hole.pose * pin.SE3(rotation, np.array([0.0, 0.0, 1e-3]))
    return {name: ", ".join(group) for group in states.groups(X, force=FORCE) for name in group}


def follow(task: Insertion, rows: dict[str, Array], tally: Tally) -> None:
    """Recognise the states of one insertion until the peg is in the hole.

    Args:
        task: peg and hole.
        rows: columns of the recorded insertion.
        tally: counts, updated.
    """
    states = states_of(task.peg, task.hole)
    group = groups_of(states, task.peg, task.hole)
    stages = [stage.name for stage in peg_plan(task.peg, task.hole).stages]
    recogniser = Recogniser(states, 1e-3 * EVERY)
    wrenches = smoothed(rows["wrench"])
    watch = Watch(tally)
    since = 0.0
    last: frozenset[str] | None = None
    for i, truth in enumerate(true_instants(rows["contacts"], task.true_hole)):
        k = EVERY * i
        stage = stages[rows["stage"][k]]
        if stage == "weigh":
            continue
        if truth.contacts & {INSIDE, OTHER}:
            return
        start = perf_counter()
        recogniser.update(pin.SE3(rows["X_WO"][k]), wrenches[k])
        tally.costs.append(perf_counter() - start)
        since = since + 1e-3 * EVERY if truth.contacts == last else 1e-3 * EVERY
        last = truth.contacts
        if since > SETTLED:
            tally.judge(truth, recogniser, group)
        watch.step(truth, ASSUMED.get(stage, frozenset()), recogniser)


@dataclass
class Watch:
    """Watch for contacts that a stage does not assume.

    Attributes:
        tally: counts, updated.
        since: time since such a contact with enough force began (s); None: there is none.
        noticed: whether it was noticed.
        alarmed: whether the alarm is on.
        changed: time since contacts or stage changed (s).
    """

    tally: Tally
    since: float | None = None
    noticed: bool = False
    alarmed: bool = False
    assumed: frozenset[str] = frozenset()

    def step(self, truth: Truth, assumed: frozenset[str], recogniser: Recogniser) -> None:
        """Compare the alarm of an instant with the truth.

        Args:
            truth: true contacts.
            assumed: contacts of the stage.
            recogniser: filter.
        """
        period = 1e-3 * EVERY
        pairs = {pair for name in assumed for pair in SEARCH[name]}
        alarm = recogniser.unexpected(pairs) != ""
        if assumed != self.assumed:  # another stage: another question
            self.since, self.noticed, self.alarmed = None, False, alarm
            self.assumed = assumed
        tally = self.tally
        tally.watched += period
        if truth.beyond(1.0) - assumed:
            self.since = period if self.since is None else self.since + period
            if alarm and not self.noticed:
                tally.delays.append(self.since)
                self.noticed = True
        else:
            if self.since is not None and not self.noticed and self.since > NOTICED:
                tally.delays.append(np.inf)
            self.since, self.noticed = None, False
            if alarm and not self.alarmed:
                tally.alarms += not truth.touched - assumed
                tally.alarms_by_median += not truth.contacts - assumed
        self.alarmed = alarm


@without_log()
def main(
    count: int = 5,
    seed: int = 7000,
    folder: Path = Path("out/insertions"),
    clearance: float = 1e3 * CLEARANCE,
) -> None:
    """Print a row for each insertion, then shares, confusions and times; clearance in mm."""
    console = Console(width=140, highlight=False)
    tally = Tally()
    results = []
    simulated = 0.0  # time of all insertions (s)
    peg = Peg("square", WIDTH)
    for k in range(seed, seed + count):
        rows = recorded(k, folder, 1e-3 * clearance)
        follow(Insertion(peg, 1e-3 * clearance, k), rows, tally)
        results.append(result_in(rows))
        simulated += results[-1].time
        console.print(
            f"{row_of(k, results[-1])}; false alarms so far: {tally.alarms} in "
            f"{tally.watched:.0f} s, {tally.alarms_by_median} by medians",
            soft_wrap=True,
        )
    console.print(summary(results), soft_wrap=True)
    task = Insertion(peg, 1e-3 * clearance, seed)
    groups = sorted(set(groups_of(states_of(peg, task.hole), peg, task.hole).values()))
    console.print(f"{len(groups)} groups of the states, with contacts of {FORCE:g} N")
    for title, shares in (("right", tally.right), ("right, all contacts", tally.strict)):
        each = {name: float(np.mean(values)) for name, values in shares.items()}
        samples = [one for values in shares.values() for one in values]
        mean = np.mean(list(each.values()))
        console.print(
            f"{title}: {100 * mean:.1f} % averaged over {len(each)} groups that were met, "
            f"{100 * np.mean(samples):.1f} % of {len(samples)} instants"
        )
    for name in groups:
        values = tally.right.get(name, [])
        share = f"{100 * np.mean(values):.0f} % of {len(values)}" if values else "not met"
        console.print(f"  {name}: {share}", soft_wrap=True)
    for words, times in tally.confused.most_common(6):
        console.print(f"  {times}: {words}", soft_wrap=True)
    delays = np.array(tally.delays)
    if len(delays):
        console.print(
            f"contacts that the stage does not assume: {np.mean(delays <= NOTICED):.0%} of "
            f"{len(delays)} noticed within 100 ms, median {1e3 * np.median(delays):.0f} ms"
        )
    console.print(
        f"false alarms: {tally.alarms} in {tally.watched:.0f} s of {simulated:.0f} s of insertion; "
        f"{tally.alarms_by_median} by the medians of forces"
    )
    console.print(f"computing time of an instant: median {1e3 * np.median(tally.costs):.1f} ms")


if __name__ == "__main__":
    typer.run(main)
