"""Filter that follows the contact state over time: a hidden Markov model."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from math import exp

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import InvalidInputError, did_you_mean
from osc_contact.recognition.states import ContactStates
from osc_contact.spatial import Array, as_array

SURE = 0.95  #: probability from which on contact states count as recognised


class Recogniser:
    """Probabilities of contact states from the wrenches of successive instants.

    Each instant, the state may have changed; then the probabilities are multiplied by the
    likelihoods of the wrench. Errors of poses and friction last longer than one instant, so the
    log-likelihoods of the instants within `lasting` count as one.

    Args:
        states: candidates.
        period: time between two instants (s).
        changes: rate at which the state changes (1/s).
        lasting: time for which errors of poses and friction last (s).
        following: names of the states that may follow each state, other than itself; None, and for
            states that it does not have: all.

    Attributes:
        states: candidates.
        period: time between two instants (s).
        probabilities: (n,) probability of each state; equal at first.

    Raises:
        InvalidInputError: a number that is not positive, or a state that does not exist.

    Example:
        >>> touch = {"table": osc.VertexOnFace([0, 0, 0], [0, 0, 0], [0, 0, 1])}
        >>> states = osc.ContactStates({"free": [], "table": ["table"]}, touch)
        >>> recogniser = osc.Recogniser(states)
        >>> for _ in range(5):
        ...     recogniser.update(pin.SE3.Identity(), np.array([0, 0, -3.0, 0, 0, 0]))
        >>> print(recogniser.state, round(recogniser.probability("table"), 2))
        table 1.0
    """

    def __init__(
        self,
        states: ContactStates,
        period: float = 0.01,
        *,
        changes: float = 0.5,
        lasting: float = 0.02,
        following: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        """Make the probabilities of changes; all states are equally probable at the beginning.

        See the class for the arguments.

        Raises:
            InvalidInputError: a number that is not finite and > 0, or an unknown state.
        """
        for name, value in (("period", period), ("changes", changes), ("lasting", lasting)):
            if not (value > 0.0 and np.isfinite(value)):
                raise InvalidInputError(f"{name} = {value!r}; give a number > 0")
        self.states = states
        self.period = period
        #: factor of log-likelihoods, ≤ 1, since errors last
        self._weight = min(1.0, period / lasting)
        count = len(states.names)
        self.probabilities: Array = np.full(count, 1.0 / count)
        #: (n, k) magnitudes of the last instant (N)
        self._alpha: Array = np.zeros((count, int(states.sizes.max())))
        #: (n, n) probabilities of changes from the state of a row to that of a column
        self._moves = self._transition_matrix(1.0 - exp(-changes * period), following or {})

    def _transition_matrix(self, share: float, following: Mapping[str, Sequence[str]]) -> Array:
        """Probability (n, n) that the state of a row is followed by that of a column.

        Args:
            share: probability that the state has changed.
            following: states that may follow each state; all, if it is not among these.

        Raises:
            InvalidInputError: a state that does not exist.
        """
        names = self.states.names
        for name in (*following, *(one for some in following.values() for one in some)):
            if name not in names:
                raise InvalidInputError(
                    f"following: there is no state {name!r}; {did_you_mean(name, names)}"
                )
        moves = np.zeros((len(names), len(names)))
        for i, name in enumerate(names):
            others = [names.index(one) for one in following.get(name, names) if one != name]
            moves[i, i] = 1.0 - share if others else 1.0
            moves[i, others] = share / max(len(others), 1)
        return moves

    def update(self, X_WO: pin.SE3, wrench: ArrayLike, X_WE: pin.SE3 | None = None) -> None:
        """Update the probabilities by the wrench of an instant, one period after the last one.

        The probability p_j of state j becomes p_j ∝ (Σ_i p_i M_ij) L_j^w, with the probability M_ij
        that state i is followed by state j within a period, the likelihood L_j of the wrench, and
        the weight w = period/`lasting`, at most 1. A wrench that is not finite changes nothing, nor
        does a pose in which no state exists.

        Args:
            X_WO: pose of the object.
            wrench: (6,) wrench of the object on its environment at O, world axes (N, N m).
            X_WE: believed pose of the touched body; None: the world frame.
        """
        f = np.asarray(wrench, dtype=np.float64)
        if f.shape != (6,):
            as_array("wrench", wrench, (6,))
        if not np.isfinite(f).all():
            return
        columns = self.states.columns(X_WO, X_WE)
        S_f = self.states.errors.covariance(X_WO)
        densities, _, self._alpha = self.states.judge(columns, S_f, f)
        best = densities.max()
        if not np.isfinite(best):  # no state exists in this pose
            return
        prior = self.probabilities @ self._moves
        weights = prior * np.exp(self._weight * (densities - best))
        total = weights.sum()
        if total > 0.0:
            self.probabilities = weights / total

    @property
    def state(self) -> str:
        """Name of the most probable state."""
        return self.states.names[int(self.probabilities.argmax())]

    @property
    def forces(self) -> dict[str, float]:
        """Forces of the pairs of the most probable state by name, from the last wrench (N).

        A force below the friction of the other ones, μ times their sum, is not certain: the state
        may be the one without this pair. Before the first instant they are zero.
        """
        return self.states.forces(int(self.probabilities.argmax()), self._alpha)

    def probability(self, *names: str) -> float:
        """Probability that the state is one of several.

        Args:
            *names: names of states.

        Raises:
            InvalidInputError: a state that does not exist.
        """
        for name in names:
            if name not in self.states.names:
                raise InvalidInputError(
                    f"there is no state {name!r}; {did_you_mean(name, self.states.names)}"
                )
        chosen = [name in names for name in self.states.names]
        return float(self.probabilities[chosen].sum())

    def unexpected(self, assumed: Collection[str], probability: float = SURE) -> str:
        """Name of the most probable state with pairs that are not assumed; empty if it is unlikely.

        Args:
            assumed: names of the pairs that may be closed.
            probability: least probability of all states with other pairs together.
        """
        other = np.array([not members <= set(assumed) for members in self.states.members])
        if self.probabilities[other].sum() < probability:
            return ""
        return self.states.names[int(np.where(other, self.probabilities, -1.0).argmax())]

    def reset(self) -> None:
        """Make all states equally probable."""
        self.probabilities = np.full(len(self.states.names), 1.0 / len(self.states.names))


def over_recording(
    recording: Mapping[str, Array], recogniser: Recogniser
) -> tuple[Array, list[str]]:
    """Recognise the contact states of a recording, from its pose and the measured wrench.

    The channel `pose` is that of the encoders only where the plant has no truth; of a simulation it
    is the true one, with which states are recognised better than they would be on a robot.

    Args:
        recording: recording with the channels `t`, `pose` and `wrench_meas`.
        recogniser: filter, which continues from its present probabilities.

    Returns:
        Times (k,) of the instants (s), one period apart to whole ticks, and the most probable state
        at each; the wrench of an instant is the mean since the last one.

    Example:
        >>> rig = osc.build_rig("panda_edge")
        >>> recorder = osc.Recorder(controller := rig.controller())
        >>> hold = osc.Stage("hold", {"edge": 10.0}, until=ends.after(0.2), within=1.0)
        >>> report = osc.run_loop(rig.plant(), controller, osc.Plan([hold]), recorder=recorder)
        >>> pairs = {pair.name: pair for pair in rig.pairs}
        >>> states = osc.ContactStates({"free": [], "on the edge": ["edge"]}, pairs)
        >>> times, names = osc.over_recording(recorder.recording(), osc.Recogniser(states))
        >>> print(names[-1])
        on the edge
    """
    t = np.asarray(recording["t"])
    poses = np.asarray(recording["pose"])
    wrenches = np.asarray(recording["wrench_meas"])
    dt = float(t[1] - t[0]) if len(t) > 1 else recogniser.period
    step = max(1, round(recogniser.period / dt))
    ends = range(step - 1, len(t), step)
    names = []
    for k in ends:
        mean = wrenches[k - step + 1 : k + 1].mean(axis=0)
        recogniser.update(pin.XYZQUATToSE3(poses[k]), mean)
        names.append(recogniser.state)
    return t[list(ends)], names
