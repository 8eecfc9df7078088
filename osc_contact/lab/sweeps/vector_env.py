"""Gymnasium vector environment whose actions are pose increments and contact forces.

Episodes are samples of a study: they begin at the start of a scenario with different values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pinocchio as pin
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from osc_contact.control.status import SafetyState
from osc_contact.errors import InvalidInputError
from osc_contact.lab.rig.references import require_known_times
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.sweeps.fleet import Fleet, Start
from osc_contact.lab.sweeps.rows import RigBuilder, without_logged_doubts
from osc_contact.lab.sweeps.study import SEED, SweepStudy
from osc_contact.lab.sweeps.workers import available_cores
from osc_contact.settings.control import require_below_ceilings
from osc_contact.spatial import Array, moved

# --- Episodes -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Episode:
    """Episode of an environment.

    Attributes:
        number: number of the sample.
        start: start of plant and controller.
        places: (steps + 1, 4, 4) desired poses of the scenario, at the ends of the steps.
        forces: (steps + 1, r) desired contact forces of the scenario, at the ends of the steps (N).
        active: (steps + 1, contacts) 1 for contacts that are active from the end of a step on, else
            0; None: the scenario names no active contacts.
        squeeze: desired internal force (N).
    """

    number: int
    start: Start
    places: Array
    forces: Array
    active: Array | None
    squeeze: float


def episode_maker(study: SweepStudy, period: float) -> Callable[[int], Episode]:
    """Function that returns the episode of a sample by its number, made once.

    Args:
        study: study of the samples.
        period: duration of a step (s).
    """
    rigs = RigBuilder()

    @cache
    def make(number: int) -> Episode:
        """Make the episode of a sample: its rig, and its references at the ends of the steps.

        Args:
            number: number of the episode.
        """
        rig = rigs.rig(study.scenario(study.sample(number)))
        require_known_times(rig.scenario, "an environment")
        steps = np.floor(rig.scenario.duration / period + 1e-9)
        plan = rig.references.over(np.arange(steps + 1) * period)
        places = np.array([pin.XYZQUATToSE3(x).homogeneous for x in plan.X_WD])
        with without_logged_doubts():
            start = Start.of(rig)
        # force ceilings that the scenario leaves out follow from the actions
        controller = start.controller.with_safety(rig.scenario.control.safety)
        start = replace(start, controller=controller)
        return Episode(number, start, places, plan.alpha_d, plan.active, plan.squeeze_d)

    return make


# --- The environment ----------------------------------------------------------------------------


@dataclass(frozen=True)
class SensedRows:
    """Quantities of all rows after a step, from which rewards are computed.

    Attributes:
        force: (B, r) contact forces that the robot measures (N).
        force_desired: (B, r) contact forces that the scenario specifies (N).
        error: (B, 6) displacement from the object to its reference, world axes (m, rad).
        tau: (B, n_a) motor torques of the last tick (N m, N).
        action: (B, 6 + r) action of the step.
        diverged: (B,) flags of rows whose simulation diverged, or whose controller stopped.
    """

    force: Array
    force_desired: Array
    error: Array
    tau: Array
    action: Array
    diverged: Array


def tracking_reward(seen: SensedRows) -> Array:
    """Reward (B,): 1 − mean |Δα| / mean |α| − |Δp| / 10 mm − |Δθ| / 0.1 rad, at least −1.

    Args:
        seen: quantities of all rows after a step.
    """
    scale = np.maximum(np.abs(seen.force_desired).mean(axis=1), 1.0)
    force = np.abs(seen.force - seen.force_desired).mean(axis=1) / scale
    position_cost = np.linalg.norm(seen.error[:, :3], axis=1) / 0.01
    rotation_cost = np.linalg.norm(seen.error[:, 3:], axis=1) / 0.1
    return np.nan_to_num(np.maximum(1.0 - force - position_cost - rotation_cost, -1.0), nan=-1.0)


class ContactVectorEnv(VectorEnv[Any, Any, Any]):
    """Environments of contact tasks that advance together, for learning.

    It needs the extras `learn` and `sim`. The controller runs at its own rate. An action lasts
    1/rate: it moves the object's set point at constant velocity and changes the contact forces at a
    constant rate.

    Actions (6 + r,) from −1 to 1: increments of the set point's position and orientation in units
    of `move`, world axes at the object; then each contact force, from 0 (−1) to `most_force` (1).
    Where the scenario names active contacts, the set at the beginning of an action is active during
    this action; forces of the other contacts are 0.

    Observations, numbers in the order of `names`: q and v of the joints; wrench of each wrist;
    measured contact forces and normal speeds; displacement from the start (m, rad) of the set
    point, and that of the scenario after the next action; desired contact forces of the last
    action, and those of the scenario after the next action.

    An episode is terminated if the controller has stopped, the simulation has diverged or the
    object is further from its reference than the scenario's `verdict` permits; it is truncated
    after the scenario's duration. The next step of its row begins another episode (gymnasium's
    `AutoresetMode.NEXT_STEP`). `infos["sample"]` holds the numbers of the episodes.

    Args:
        scenario: packaged name, file, or a scenario made in Python, without Python code in its
            ticks, see `Fleet`.
        num_envs: number of environments.
        vary: keys that vary from episode to episode, see `sweep`; none: all episodes are equal.
        overrides: texts path=value of all episodes.
        rate: rate of actions (Hz), a divisor of the control rate.
        move: largest pose increments of an action along and about each axis (m, rad); None: twice
            the largest that the scenario's motion needs, at least 1 mm and 5 mrad.
        most_force: largest contact force of an action (N); None: twice the scenario's largest.
        reward: function of the quantities after a step that returns the rewards (B,).
        episodes: number of different episodes that `vary` makes.
        threads: number of threads; None: one for each core.

    Attributes:
        names: names of the numbers of an observation.
        fleet: plants and controllers.
        move: (6,) largest increments (m, rad).
        most_force: largest contact force (N).

    Example:
        >>> env = osc.make_vector_env("panda_edge", 2, overrides=["duration=1 s"])
        >>> observation, infos = env.reset(seed=0)
        >>> print(observation.shape, env.action_space.shape)
        (2, 36) (2, 7)
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int,
        *,
        vary: Mapping[str, str] | Sequence[str] = (),
        overrides: Sequence[str] = (),
        rate: float = 50.0,
        move: tuple[float, float] | None = None,
        most_force: float | None = None,
        reward: Callable[[SensedRows], Array] = tracking_reward,
        episodes: int = 256,
        threads: int | None = None,
    ) -> None:
        """Make plants, controllers and spaces; all rows are at the start of the first episode.

        Raises:
            InvalidInputError: no environments, a rate that does not divide control's, large forces.
        """
        constant_seed = [f"{SEED}=integers(0, 0)"]  # a study needs a key that varies
        study = SweepStudy.of(
            scenario,
            vary or constant_seed,
            episodes,
            "halton" if vary else "random",
            overrides=overrides,
        )
        #: function that makes the episode of a number
        self._make_episode = episode_maker(study, 1.0 / rate)
        self._n_episodes = episodes if vary else 1  #: number of different episodes
        # the first episode stands for all: they have the same structure and control period
        first = self._make_episode(0)
        control_rate = 1.0 / first.start.controller.dt
        self._ticks_per_action = round(control_rate / rate)  #: control periods in an action
        if (
            num_envs < 1
            or self._ticks_per_action < 1
            or abs(self._ticks_per_action * rate - control_rate) > 1e-6 * rate
        ):
            raise InvalidInputError(
                f"{num_envs} environments, actions at {rate:g} Hz, control at {control_rate:g} Hz: "
                "give one environment at least, and a rate that divides that of control"
            )
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
        self._reward = reward  #: function that computes the rewards
        verdict = first.start.rig.scenario.verdict
        #: errors of the pose (m, rad) above which an episode ends
        self._most_error = (verdict.distance, verdict.angle)
        self._r = first.forces.shape[1]  #: r, number of contact forces
        self.move = np.repeat(_default_increments(first.places) if move is None else move, 3)
        largest = 2.0 * float(np.abs(first.forces).max(initial=0.0))
        self.most_force = largest if most_force is None else most_force
        require_below_ceilings(first.start.rig.scenario.control.safety, self.most_force, self._r)
        self._episodes = [first] * num_envs  #: present episode of each environment
        count = available_cores() if threads is None else threads
        self.fleet = Fleet([first.start] * num_envs, min(count, num_envs))
        #: (B,) number of actions in the present episode
        self._step = np.zeros(num_envs, dtype=int)
        #: (B, 4, 4) desired poses at the end of the action
        self._target = np.tile(first.places[0], (num_envs, 1, 1))
        #: (B, r) desired contact forces at the end of the action (N)
        self._forces = np.zeros((num_envs, self._r))
        #: (B,) whether the episode has ended, so that the next step begins another one
        self._ended = np.zeros(num_envs, dtype=bool)
        self.names = self._name_numbers(first)
        self._make_spaces()

    def _make_spaces(self) -> None:
        """Make the spaces of observations and actions, of one environment and of all."""
        numbers = gymnasium.spaces.Box(-np.inf, np.inf, (len(self.names),), np.float64)
        actions = gymnasium.spaces.Box(-1.0, 1.0, (6 + self._r,), np.float64)
        self.single_observation_space = numbers
        self.single_action_space = actions
        self.observation_space = batch_space(numbers, self.num_envs)
        self.action_space = batch_space(actions, self.num_envs)

    def _name_numbers(self, first: Episode) -> list[str]:
        """Names of the numbers of an observation.

        Args:
            first: first episode, whose contacts and joints name the numbers.
        """
        chain = first.start.rig.chain
        forces = range(self._r)
        axes = ("x", "y", "z", "rx", "ry", "rz")
        wrench = ("fx", "fy", "fz", "mx", "my", "mz")
        groups = (
            ("q", chain.joint_names),
            ("v", chain.joint_names),
            *((f"wrench {arm.name}", wrench) for arm in chain.arms),
            ("force", forces),
            ("normal speed", forces),
            ("set point", axes),
            ("scenario", axes),
            ("desired force", forces),
            ("scenario force", forces),
        )
        return [f"{quantity} {part}" for quantity, parts in groups for part in parts]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin a random episode in all B rows, as gymnasium's `VectorEnv.reset` does.

        Args:
            seed: seed of the choice of episodes; None: the sequence continues.
            options: not used.

        Returns:
            Observations (B, numbers), and `infos` with the numbers of the episodes.
        """
        super().reset(seed=seed)
        self._begin_episodes(range(self.num_envs))
        return (self._observe(), self._infos())

    def _begin_episodes(self, rows: Sequence[int]) -> None:
        """Begin a random episode in some rows: its start, set point and forces.

        Args:
            rows: numbers of the rows.
        """
        if not rows:
            return
        numbers = self.np_random.integers(self._n_episodes, size=len(rows))
        for row, number in zip(rows, numbers.tolist(), strict=True):
            self._episodes[row] = episode = self._make_episode(number)
            self._target[row] = episode.places[0]
            self._forces[row] = episode.forces[0]
        self.fleet.begin({row: self._episodes[row].start for row in rows})
        self._step[rows] = 0
        self._ended[rows] = False

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Advance all B rows by an action (B, 6 + r), as gymnasium prescribes.

        An action has increments of the set point (6, −1 … 1 times `move`; m, rad) and r contact
        forces (−1 … 1 for 0 … `most_force`, N). A row whose episode has ended begins a new one
        instead.

        Args:
            actions: (B, 6 + r) actions.

        Returns:
            Observations (B, numbers), rewards (B,), flags (B,) of episodes that failed (the object
            is too far away, or the simulation diverges) and that reached their end, and further
            information.
        """
        clipped: Array = np.clip(np.asarray(actions, dtype=float), -1.0, 1.0)
        if clipped.shape != (self.num_envs, 6 + self._r):
            raise InvalidInputError(
                f"actions: expected {(self.num_envs, 6 + self._r)}, got {clipped.shape}"
            )
        begins = self._ended.copy()  # rows in which the action is ignored and an episode begins
        continues = ~begins
        tau = self._advance(clipped, continues)
        self._begin_episodes(np.flatnonzero(begins).tolist())
        self._step[continues] += 1
        sensed = self._sense(clipped, tau)
        rewards = np.where(continues, self._reward(sensed), 0.0)
        is_away = np.linalg.norm(sensed.error.reshape(-1, 2, 3), axis=2) > self._most_error
        terminated = continues & (sensed.diverged | is_away.any(axis=1))
        truncated = continues & ~terminated & (self._step >= self._last_steps)
        self._ended = terminated | truncated
        return (self._observe(), rewards, terminated, truncated, self._infos())

    def _advance(self, actions: Array, continues: Array) -> Array:
        """Tick all rows during an action; return their last torques (B, n_a).

        Args:
            actions: (B, 6 + r) from −1 to 1.
            continues: (B,) flags of rows whose episode has not ended; the others keep their set
                points.
        """
        # set points and forces move linearly from the last action's to those of this one; rows
        # whose episode has ended keep theirs
        ticks = self._ticks_per_action
        increment = np.where(continues[:, None], actions[:, :6] * self.move, 0.0)
        forces = 0.5 * (actions[:, 6:] + 1.0) * self.most_force
        forces = np.where(continues[:, None], forces, self._forces)
        share = np.arange(1, ticks + 1)[:, None, None] / ticks
        X = moved(self._target, share * increment)
        V = increment / (ticks * self.fleet.dt)
        alpha = self._forces + share * (forces - self._forces)
        squeeze = np.array([episode.squeeze for episode in self._episodes])
        active = self._active_set()
        for k in range(ticks):  # the velocity is constant, so the desired acceleration is zero
            tau = self.fleet.tick(X[k], V, np.zeros_like(V), alpha[k], squeeze, active)
        self._target = X[-1].copy()
        self._forces = forces
        return tau

    def _sense(self, actions: Array, tau: Array) -> SensedRows:
        """Quantities of all rows after a step, from which rewards are computed.

        Args:
            actions: (B, 6 + r) actions of the step.
            tau: (B, n_a) torques of its last tick (N m, N).
        """
        places, forces = self._desired_values()
        p, R = self.fleet.objects()
        error = np.concatenate(
            (places[:, :3, 3] - p, _turns(places[:, :3, :3] @ R.transpose(0, 2, 1))), axis=1
        )
        stopped = self.fleet.control.state == SafetyState.SAFE_STOP
        diverged = self.fleet.diverged() | stopped | ~np.isfinite(error).all(axis=1)
        force = self.fleet.control.alpha_meas
        return SensedRows(force, forces, error, tau, actions, diverged)

    def _desired_values(self, ahead: int = 0) -> tuple[Array, Array]:
        """Desired poses (B, 4, 4) and contact forces (B, r) of the scenarios.

        Args:
            ahead: number of actions from the present step to the time of the desired values.
        """
        steps = np.minimum(self._step + ahead, self._last_steps)
        pairs = list(zip(self._episodes, steps, strict=True))
        places = np.array([episode.places[k] for episode, k in pairs])
        forces = np.array([episode.forces[k] for episode, k in pairs])
        return (places, forces)

    def _active_set(self) -> Array | None:
        """Active contacts (B, contacts) of the scenario in this step; None: it names none."""
        steps = np.minimum(self._step, self._last_steps)
        sets = [
            episode.active[k]
            for episode, k in zip(self._episodes, steps, strict=True)
            if episode.active is not None
        ]
        return np.array(sets) if sets else None

    @property
    def _last_steps(self) -> Array:
        """Number (B,) of the last step of each row's episode."""
        return np.array([len(episode.places) - 1 for episode in self._episodes])

    def _observe(self) -> Array:
        """Compute the observations (B, numbers) of all B rows, with 0 for NaN.

        They are joint positions, velocities and wrist readings, measured contact forces (N) and
        normal speeds (m/s), displacements (m, rad) of set point and scenario's reference from the
        first pose, and desired forces (N) of the action and of the scenario; `names` names the
        numbers.
        """
        q, v, wrenches = self.fleet.measure()
        control = self.fleet.control
        places, forces = self._desired_values(1)
        first = np.array([episode.places[0] for episode in self._episodes])
        parts = (
            q,
            v,
            wrenches.reshape(self.num_envs, -1),
            control.alpha_meas,
            control.normal_speed,
            _displacement(first, self._target),
            _displacement(first, places),
            self._forces,
            forces,
        )
        return np.nan_to_num(np.concatenate(parts, axis=1))

    def _infos(self) -> dict[str, Any]:
        """Numbers of the episodes, in the form of gymnasium."""
        samples = np.array([episode.number for episode in self._episodes])
        return {"sample": samples, "_sample": np.ones(self.num_envs, dtype=bool)}


def _default_increments(places: Array) -> Array:
    """Default of the largest increments (2,): along an axis (m), and about an axis (rad).

    They are twice the largest increments between successive poses, and at least 1 mm and 5 mrad.

    Args:
        places: (k, 4, 4) desired poses at the ends of the steps.
    """
    largest = np.abs(_displacement(places[:-1], places[1:])).reshape(-1, 2, 3).max(axis=(0, 2))
    return np.maximum((1e-3, 5e-3), 2.0 * largest)


def _displacement(start: Array, end: Array) -> Array:
    """Displacements (B, 6) between poses (B, 4, 4), world axes (m, rad)."""
    turn = _turns(end[:, :3, :3] @ start[:, :3, :3].transpose(0, 2, 1))
    return np.concatenate((end[:, :3, 3] - start[:, :3, 3], turn), axis=1)


def _turns(R: Array) -> Array:
    """Rotation vectors (B, 3) of rotations (B, 3, 3); NaN of matrices that are not finite."""
    unknown = np.full(3, np.nan)
    return np.array([pin.log3(matrix) if np.isfinite(matrix).all() else unknown for matrix in R])


make_vector_env = ContactVectorEnv
