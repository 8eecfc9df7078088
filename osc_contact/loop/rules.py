"""Rules on a task before it runs: a quantity, the limits on it, and the sentence of a finding."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.control.controller import Controller
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.interface import Measurement, Reference, Scene
from osc_contact.settings.control import Gains, SafetySettings
from osc_contact.spatial import Array

Values = Iterator[tuple[float, Mapping[str, object]]]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or doubtful.

    Attributes:
        refused: whether it cannot run; else it is doubtful.
        text: a sentence with the numbers and the cure.

    Example:
        >>> findings = osc.preflight(osc.build_rig(osc.load_scenario("panda_edge")))
        >>> [finding.text for finding in findings if finding.refused]
        []
    """

    refused: bool
    text: str


@dataclass(frozen=True)
class Rule:
    """A quantity that is doubtful above one limit, and refused above another.

    Attributes:
        quantity: gives values, each with the words of the sentence.
        doubtful, refused: limits, in the quantity's unit.
        sentence: format of the finding's text; {value} is the quantity, {mm} a thousand times that.
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
                yield Finding(refused, self.sentence.format(value=value, mm=1e3 * value, **words))


def rule(
    sentence: str, doubtful: float = 0.0, refused: float | None = None
) -> Callable[[Callable[[Any], Values]], Rule]:
    """Function decorator: makes a quantity a rule.

    Args:
        sentence, doubtful, refused: see `Rule`; a refused of None is doubtful's limit.
    """
    limit = doubtful if refused is None else refused
    return lambda quantity: Rule(quantity, doubtful, limit, sentence)


doubt = partial(rule, refused=np.inf)  #: a rule that refuses nothing


def findings(rules: Iterable[Rule], task: Any) -> list[Finding]:
    """Findings of several rules, one rule after the other."""
    return [one for rule in rules for one in rule.findings(task)]


def rounded(x: Array, digits: int = 4) -> list[float]:
    """Round a vector, for messages."""
    return np.round(x, digits).tolist()


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A chain, its contacts and what they are to do.

    Attributes:
        chain: the true one, as far as it is known. pairs: the true contacts.
        gains, dt, posture, safety: of the controller.
        q: (n,) where the run starts. q_contact: (n,) the same in contact.
        state, contact: the chain at rest there, and all contacts.
        times: (k,) s. poses, forces: (k, 7) and (k, r) the references there.
        rates, twists: (k, 6) the displacement of X_WD until the next tick, over dt, and the mean
            V_D on the way (m/s, rad/s); (0, 6): not compared.
        every: references of all ticks, by the period. rehearsed: ticks of a rehearsal at most;
            None: of the whole motion.
        force_names: (r,) in messages. owners: (r,) the contact of each.
        rests: of each contact, whether its body does. kept_from: s, when contacts are to be kept.
        bound: whether all contacts are kept, also those whose force is zero.
        squeezes, commanded: (k,) sums of the internal forces (N), and (k, 6) V_D, at `times`; (0,)
            and (0, 6): not compared.
        controller, measured, scene: that will run, what its robot measures now, and what stands
            around it; None: not known, as of a scenario.
    """

    chain: ClosedChain
    pairs: Sequence[ContactPair]
    gains: Gains
    dt: float
    posture: Array
    safety: SafetySettings
    q: Array
    q_contact: Array
    state: ChainState
    contact: Contact
    times: Array
    poses: Array
    forces: Array
    every: Callable[[float], Iterator[Reference]]
    force_names: Sequence[str]
    owners: Array
    rests: Sequence[bool]
    bound: bool
    kept_from: float = 0.0
    rehearsed: int | None = None
    rates: Array = field(default_factory=partial(np.zeros, (0, 6)))
    twists: Array = field(default_factory=partial(np.zeros, (0, 6)))
    squeezes: Array = field(default_factory=partial(np.zeros, 0))
    commanded: Array = field(default_factory=partial(np.zeros, (0, 6)))
    controller: Controller | None = None
    measured: Measurement | None = None
    scene: Scene | None = None
