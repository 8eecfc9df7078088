"""What preflight knows of every task, given by a file or in Python, and the rows of its rules."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import ContactPair, count_forces
from osc_contact.control.controller import Controller
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.recorder.recording import column_names
from osc_contact.runs.finding import Finding
from osc_contact.runs.references import Plan, force_names
from osc_contact.runs.rig import Rig
from osc_contact.scenarios.control_schema import Gains, SafetySettings
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array

__all__ = ["MOST_TICKS", "Rule", "Task", "findings", "plan_of"]

MOST_TICKS = 100_000  #: references that are looked at
_LOOKS = 400  #: of them, at which places and forces are compared


@dataclass(frozen=True, eq=False)
class Task:
    """A chain, its contacts and what they are to do.

    Attributes:
        chain: the true one, as far as it is known. pairs: the true contacts.
        gains, dt, posture, safety: of the controller.
        q: (n,) where the run starts. q_contact: (n,) the same in contact.
        times: (k,) s. plan: the references there. every: of all ticks, by the period.
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
    plan: Plan
    every: Callable[[float], Iterator[Reference]]
    force_names: Sequence[str]
    owners: Array
    rests: Sequence[bool] = ()
    kept_from: float = 0.0
    bound: bool = True
    controller: Controller | None = None
    robot: Any = None
    measured: Measurement | None = None

    @classmethod
    def of_rig(cls, rig: Rig) -> Task:
        """Of a scenario."""
        scenario: Scenario = rig.scenario
        times, plan = rig.references.overview
        tare, duration = scenario.tare, scenario.duration
        return cls(
            rig.chain, rig.pairs, rig.gains, 1.0 / scenario.control.rate, rig.q_contact,
            scenario.control.safety,
            rig.q_start, rig.q_contact, times, plan,
            lambda period: rig.references.each(int(duration / period), period),
            [f"force.{name}" for name in force_names(scenario)], rig.owners,
            [rig.bodies[body].motion is None for body in rig.on],
            0.0 if tare is None else tare.duration + tare.approach, rig.life is None,
        )  # fmt: skip

    @classmethod
    def of_robot(cls, robot: Any, controller: Controller, references: Any) -> Task:
        """Of a robot at rest where the run will start.

        Args:
            robot: is measured once. controller: of it. references: one for each tick.

        Raises:
            InvalidInputError: no references, or not all of them have a force for each column.
        """
        settings, measured = controller.settings, robot.measure()
        pairs = settings.contacts
        owners = [i for i, pair in enumerate(pairs) for _ in range(count_forces(pair))]
        wanted = list(islice(references, MOST_TICKS))
        for k, one in enumerate(wanted):
            if np.shape(one.alpha_d) != (len(owners),):
                raise InvalidInputError(
                    f"reference {k}: alpha_d has shape {np.shape(one.alpha_d)}, and the contacts "
                    f"have {len(owners)} columns of N; give one force for each (N)"
                )
        if not wanted:
            raise InvalidInputError("there are no references; give one for each tick")
        q = np.asarray(measured.q, dtype=float)
        looks = np.unique(np.linspace(0, len(wanted) - 1, _LOOKS).astype(int))
        names = column_names([pair.name for pair in pairs], owners)

        def every(period: float) -> Iterator[Reference]:
            return iter(wanted[:: max(1, round(period / settings.dt))])

        return cls(
            getattr(robot, "chain", settings.chain),
            pairs,
            settings.gains,
            settings.dt,
            settings.posture,
            settings.safety,
            q,
            q,
            looks * settings.dt,
            plan_of([wanted[k] for k in looks]),
            every,
            [f"alpha_d of {name}" for name in names],
            np.array(owners, dtype=int),
            [body is None for body in settings.bodies],
            bound=settings.phases is None,
            controller=controller,
            robot=robot,
            measured=measured,
        )

    @property
    def rate(self) -> float:
        """Hz, of the control loop."""
        return 1.0 / self.dt

    @cached_property
    def state(self) -> ChainState:
        """The chain at rest in contact."""
        return self.chain.state(self.q_contact, np.zeros(self.chain.nq))

    @cached_property
    def contact(self) -> Contact:
        """All contacts there."""
        X, V = self.state.X_WO, self.state.V_O
        return Contact.stack([pair.contact(X, V) for pair in self.pairs])


@dataclass(frozen=True)
class Rule:
    """A quantity that is doubtful above one limit, and refused above another.

    Attributes:
        quantity: gives values, each with the words of the sentence.
        doubtful, refused: limits, in the quantity's unit.
        sentence: format of what is said; `value` is the quantity, `limit` what it is above.
    """

    quantity: Callable[[Task], Iterator[tuple[float, dict[str, Any]]]]
    doubtful: float
    refused: float
    sentence: str

    def findings(self, task: Task) -> Iterator[Finding]:
        """What is above a limit; a quantity that is not a number is refused."""
        for value, words in self.quantity(task):
            refused = not value <= self.refused
            if refused or value > self.doubtful:
                limit = self.refused if refused else self.doubtful
                text = self.sentence.format(value=value, limit=limit, **words)
                yield Finding(refused, text)


def findings(rules: Sequence[Rule], task: Task) -> Iterator[Finding]:
    """Of all rules, one after the other."""
    for rule in rules:
        yield from rule.findings(task)


def plan_of(references: Sequence[Reference]) -> Plan:
    """References as tables."""
    return Plan(
        X_WD=np.array([pin.SE3ToXYZQUAT(one.X_WD) for one in references]),
        V_D=np.array([one.V_D for one in references]),
        A_D=np.array([one.A_D for one in references]),
        alpha_d=np.array([one.alpha_d for one in references]),
        squeeze_d=0.0,
    )
