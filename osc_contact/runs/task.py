"""What preflight knows of a task, given by a file or in Python, and how its rules are written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.control.controller import Controller
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.recorder.recording import column_names
from osc_contact.runs.contacts import contact_at, force_owners
from osc_contact.runs.rig import Rig
from osc_contact.scenarios.control_schema import Gains, SafetySettings
from osc_contact.spatial import Array

MOST_TICKS = 100_000  #: references that are looked at
_LOOKS = 400  #: of them, at which places and forces are compared

Values = Iterator[tuple[float, dict[str, Any]]]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or doubtful.

    Attributes:
        refused: whether it cannot run; else it is doubtful.
        text: a sentence with the numbers and the cure.
    """

    refused: bool
    text: str


@dataclass(frozen=True)
class Rule:
    """A quantity that is doubtful above one limit, and refused above another.

    Attributes:
        quantity: gives values, each with the words of the sentence.
        doubtful, refused: limits, in the quantity's unit.
        sentence: format of the finding's text; {value} is the quantity, {limit} what it is above.
    """

    quantity: Callable[[Any], Values]
    doubtful: float
    refused: float
    sentence: str

    def findings(self, task: Any) -> Iterator[Finding]:
        """What is above a limit; a quantity that is not a number is refused.

        Args:
            task: the `Task`, or the `Rig`, that the quantity is of.
        """
        for value, words in self.quantity(task):
            refused = not value <= self.refused
            if refused or value > self.doubtful:
                limit = self.refused if refused else self.doubtful
                words = {"value": value, "limit": limit, **words}
                yield Finding(refused, self.sentence.format(**words))


def rule(
    doubtful: float, refused: float, sentence: str
) -> Callable[[Callable[[Any], Values]], Rule]:
    """Function decorator: makes a quantity a rule.

    Args:
        doubtful, refused, sentence: see `Rule`; a refused of inf is never reached.
    """
    return lambda quantity: Rule(quantity, doubtful, refused, sentence)


def findings(rules: Iterable[Rule], task: Any) -> list[Finding]:
    """Of all rules, one after the other."""
    return [one for rule in rules for one in rule.findings(task)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A chain, its contacts and what they are to do.

    Attributes:
        chain: the true one, as far as it is known. pairs: the true contacts.
        gains, dt, posture, safety: of the controller.
        q: (n,) where the run starts. q_contact: (n,) the same in contact.
        times: (k,) s. poses, forces: (k, 7) and (k, r) the references there.
        every: references of all ticks, by the period.
        force_names: (r,) in messages. owners: (r,) the contact of each.
        rests: of each contact, whether its body does. kept_from: s, when contacts are to be kept.
        bound: whether all contacts are kept, also those whose force is zero.
        robot: that will run, with what it measures now; None: the scenario's plant.
    """

    chain: ClosedChain
    pairs: Sequence[ContactPair]
    gains: Gains
    dt: float
    posture: Array
    safety: SafetySettings
    q: Array
    q_contact: Array
    times: Array
    poses: Array
    forces: Array
    every: Callable[[float], Iterator[Reference]]
    force_names: Sequence[str]
    owners: Array
    rests: Sequence[bool]
    bound: bool
    kept_from: float = 0.0
    controller: Controller | None = None
    robot: Any = None
    measured: Measurement | None = None

    @classmethod
    def of_rig(cls, rig: Rig) -> Task:
        """Of a scenario."""
        scenario = rig.scenario
        times, plan = rig.references.overview
        tare = scenario.tare
        return cls(
            chain=rig.chain,
            pairs=rig.pairs,
            gains=rig.gains,
            dt=1.0 / scenario.control.rate,
            posture=rig.q_contact,
            safety=scenario.control.safety,
            q=rig.q_start,
            q_contact=rig.q_contact,
            times=times,
            poses=plan.X_WD,
            forces=plan.alpha_d,
            every=lambda period: rig.references.each(int(scenario.duration / period), period),
            force_names=[f"force.{name}" for name in rig.force_names],
            owners=rig.owners,
            rests=[rig.bodies[body].motion is None for body in rig.on],
            bound=rig.life is None,
            kept_from=0.0 if tare is None else tare.duration + tare.approach,
        )

    @classmethod
    def of_robot(cls, robot: Any, controller: Controller, references: Iterable[Reference]) -> Task:
        """Of a robot at rest where the run will start.

        Args:
            robot: is measured once. controller: of it. references: one for each tick.

        Raises:
            InvalidInputError: no references, not all of them have a force for each column, or the
                robot has other joints.
        """
        settings = controller.settings
        measured = robot.measure()
        pairs = settings.contacts
        chain = getattr(robot, "chain", settings.chain)
        owners = force_owners(pairs)
        given = list(islice(references, MOST_TICKS))
        for k, one in enumerate(given):
            if np.shape(one.alpha_d) != (len(owners),):
                raise InvalidInputError(
                    f"reference {k}: alpha_d has shape {np.shape(one.alpha_d)}, and the contacts "
                    f"have {len(owners)} columns of N; give one force for each (N)"
                )
        if not given:
            raise InvalidInputError("there are no references; give one for each tick")
        q = np.asarray(measured.q, dtype=float)
        if chain.nq != len(q):
            raise InvalidInputError(f"the robot measures {len(q)} joints of {chain.nq}")
        looks = np.unique(np.linspace(0, len(given) - 1, _LOOKS).astype(int))
        names = column_names([pair.name for pair in pairs], owners.tolist())
        return cls(
            chain=chain,
            pairs=pairs,
            gains=settings.gains,
            dt=settings.dt,
            posture=settings.posture,
            safety=settings.safety,
            q=q,
            q_contact=q,
            times=looks * settings.dt,
            poses=np.array([pin.SE3ToXYZQUAT(given[k].X_WD) for k in looks]),
            forces=np.array([given[k].alpha_d for k in looks]),
            every=lambda period: iter(given[:: max(1, round(period / settings.dt))]),
            force_names=[f"alpha_d of {name}" for name in names],
            owners=owners,
            rests=[body is None for body in settings.bodies],
            bound=settings.life is None,
            controller=controller,
            robot=robot,
            measured=measured,
        )

    @cached_property
    def state(self) -> ChainState:
        """The chain at rest in contact."""
        return self.chain.state(self.q_contact, np.zeros(self.chain.nq))

    @cached_property
    def contact(self) -> Contact:
        """All contacts there."""
        return contact_at(self.pairs, self.state.X_WO)
