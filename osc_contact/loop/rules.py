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
from osc_contact.settings.control import SafetySettings
from osc_contact.settings.gains import Gains
from osc_contact.spatial import Array

#: Values of a rule's quantity, each with the words that its sentence is formatted with.
Values = Iterator[tuple[float, Mapping[str, object]]]


@dataclass(frozen=True)
class Finding:
    """Finding of a rule on a task.

    Attributes:
        refused: True if the task cannot run, False for a warning.
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
    """Quantity of a task with a limit for warnings and a limit for refusal.

    Attributes:
        quantity: function of a task that yields values, each with a dictionary for the sentence.
        doubtful, refused: limits for a warning and for refusal, in the quantity's unit.
        sentence: format of the finding's text; {value} is the quantity, {mm} a thousand times that.
    """

    quantity: Callable[[Any], Values]
    doubtful: float
    refused: float
    sentence: str

    def findings(self, task: Any) -> Iterator[Finding]:
        """Yield findings on values above a limit; NaN is refused.

        Args:
            task: argument of the quantity, a `Task` or a `Rig`.
        """
        for value, words in self.quantity(task):
            refused = not value <= self.refused
            if refused or value > self.doubtful:
                yield Finding(refused, self.sentence.format(value=value, mm=1e3 * value, **words))


def rule(
    sentence: str, doubtful: float = 0.0, refused: float | None = None
) -> Callable[[Callable[[Any], Values]], Rule]:
    """Function decorator that makes a quantity a `Rule`.

    Args:
        sentence: format of the finding's text.
        doubtful: limit for a warning, in the quantity's unit.
        refused: limit for refusal; None: a value above `doubtful` is refused.

    Returns:
        Decorator of a function that takes a task and yields values with the words of the sentence.
    """
    limit = doubtful if refused is None else refused
    return lambda quantity: Rule(quantity, doubtful, limit, sentence)


doubt = partial(rule, refused=np.inf)  #: decorator of a rule with warnings only


def findings(rules: Iterable[Rule], task: Any) -> list[Finding]:
    """Evaluate several rules on a task; return all findings in the order of the rules.

    Args:
        rules: rules whose quantities take this task.
        task: a `Task`, or a `Rig` for rules on a scenario.
    """
    return [finding for rule in rules for finding in rule.findings(task)]


def rounded(x: Array, digits: int = 4) -> list[float]:
    """Round the elements of a vector to a number of decimals, as a list for messages."""
    return np.round(x, digits).tolist()


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """Chain, contacts, references and settings of a run, to be checked by rules.

    Attributes:
        chain: the true chain, as far as it is known.
        pairs: the true contacts.
        gains, dt, posture, safety: settings of the controller.
        q: (n,) joint positions at the start.
        q_contact: (n,) joint positions in contact.
        state, contact: the chain at rest in contact, and all contacts there.
        times: (k,) times at which references are checked (s).
        poses: (k, 7) X_WD at these times.
        forces: (k, r) alpha_d (N).
        rates: (k, 6) displacement of X_WD until the next tick, divided by dt.
        twists: (k, 6) mean V_D in this time (m/s, rad/s). Both are (0, 6) if they are not checked.
        every: function that yields references of all ticks of a given period (s).
        rehearsed: largest number of ticks of a rehearsal; None: the whole motion.
        force_names: (r,) names in messages.
        owners: (r,) index of the contact of each force.
        rests: for each contact, whether its body is at rest.
        kept_from: time from which on contacts are to be maintained (s).
        bound: whether contacts without a desired force are maintained, too.
        active: (k, contacts) named active contacts at `times`, 1 or 0; None: none are named. Forces
            of contacts that are not active are 0.
        trial: function that makes a controller with its contacts engaged, to be ticked once, and a
            measurement for it; None: no set is tried.
        squeezes: (k,) sums of the internal forces (N).
        commanded: (k, 6) V_D. Both are empty if they are not checked.
        controller, measured, scene: controller of the run, present measurement of its robot, and
            scene around it; None if unknown, for example for a scenario.
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
    active: Array | None = None
    trial: Callable[[], tuple[Controller, Measurement]] | None = None
    rehearsed: int | None = None
    rates: Array = field(default_factory=partial(np.zeros, (0, 6)))
    twists: Array = field(default_factory=partial(np.zeros, (0, 6)))
    squeezes: Array = field(default_factory=partial(np.zeros, 0))
    commanded: Array = field(default_factory=partial(np.zeros, (0, 6)))
    controller: Controller | None = None
    measured: Measurement | None = None
    scene: Scene | None = None
