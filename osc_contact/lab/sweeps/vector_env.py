"""A gymnasium vector environment: actions are pose increments and contact forces.

Its episodes begin at the starts of a scenario, with other numbers each, as samples of a study.
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

from osc_contact.control.status import SafetyState
from osc_contact.errors import InvalidInputError
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.sweeps.fleet import Fleet, Start
from osc_contact.lab.sweeps.study import SEED, SweepStudy
from osc_contact.lab.sweeps.sweep import RigBuilder, available_cores, without_logged_doubts
from osc_contact.settings.control import require_below_ceilings
from osc_contact.spatial import Array, moved

# --- Episodes -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Episode:
    """One of them.

    Attributes:
        number: of the sample. start: of plant and controller.
        places: (steps + 1, 4, 4) poses that the scenario specifies, at the ends of the steps.
        forces: (steps + 1, r) contact forces (N) likewise. squeeze: internal force (N).
    """

    number: int
    start: Start
    places: Array
    forces: Array
    squeeze: float


def episode_maker(study: SweepStudy, period: float) -> Callable[[int], Episode]:
    """Number of a sample → episode; those made before are kept.

    Args:
        study: of the samples. period: of the steps (s).
    """
    rigs = RigBuilder()

    @cache
    def make(number: int) -> Episode:
        rig = rigs.rig(study.scenario(study.sample(number)))
        steps = np.floor(rig.scenario.duration / period + 1e-9)
        plan = rig.references.over(np.arange(steps + 1) * period)
        places = np.array([pin.XYZQUATToSE3(x).homogeneous for x in plan.X_WD])
        with without_logged_doubts():
            start = Start.of(rig)
        follows = start.controller.with_safety(rig.scenario.control.safety)  # ceilings: the actions
        start = replace(start, controller=follows)
        return Episode(number, start, places, plan.alpha_d, plan.squeeze_d)

    return make


# --- The environment ----------------------------------------------------------------------------


@dataclass(frozen=True)
class SensedRows:
    """What rewards are made of, of all rows after a step.

    Attributes:
        force, force_desired: (B, r) contact forces as the robot senses them, and as the scenario
            specifies them (N).
        error: (B, 6) from the object to its reference (m, rad), world axes.
        tau: (B, n_a) motor torques of the last tick (N m, N). action: (B, 6 + r).
        diverged: (B,) whether simulation or controller gave up.
    """

    force: Array
    force_desired: Array
    error: Array
    tau: Array
    action: Array
    diverged: Array


def tracking_reward(seen: SensedRows) -> Array:
    """(B,) 1 where force and motion follow the scenario, less for each error.

    1 − mean |Δα| / mean |α| − |Δp| / 10 mm − |Δθ| / 0.1 rad, at least −1.
    """
    scale = np.maximum(np.abs(seen.force_desired).mean(axis=1), 1.0)
    force = np.abs(seen.force - seen.force_desired).mean(axis=1) / scale
    away = np.linalg.norm(seen.error[:, :3], axis=1) / 0.01
    turned = np.linalg.norm(seen.error[:, 3:], axis=1) / 0.1
    return np.nan_to_num(np.maximum(1.0 - force - away - turned, -1.0), nan=-1.0)


class ContactVectorEnv(VectorEnv[Any, Any, Any]):
    """Many contact tasks at once, for learning (needs the extras `learn` and `sim`).

    The controller runs at its own rate. An action lasts 1/rate: it moves the object's set point, at
    constant velocity, and sets the contact forces, which change evenly over the step.

    Actions (6 + r,) from −1 to 1: increments of the set point's position and orientation in units
    of `move`, world axes at the object; then each contact force, from 0 (−1) to the most (1).

    Observations, numbers in the order of `names`: q, v of the joints; wrench of each wrist; sensed
    contact forces and normal speeds; displacements from the start (m, rad): the set point's, and
    that of the scenario after the next action; forces likewise.

    An episode ends (terminated) where the controller has stopped, the simulation diverged or the
    object is further from its reference than the scenario's `verdict` permits; it is
    truncated after the scenario's duration. The next step of its row begins another one
    (gymnasium's `AutoresetMode.NEXT_STEP`). `infos["sample"]` has its numbers.

    Args:
        scenario: packaged name, file, or a scenario made in Python; plain ones, see `Fleet`.
        num_envs: how many at once.
        vary: what differs from one episode to the next, as in `sweep`; nothing: they are all alike.
        overrides: path=value, of all episodes.
        rate: of actions (Hz); the control rate is a multiple of it.
        move: the largest pose increment of an action along and about each axis (m, rad); default:
            twice the largest that the scenario's motion needs, at least 1 mm and 5 mrad.
        most_force: of an action, in each contact (N); default: twice the largest of the scenario's.
        reward: of all rows after a step.
        episodes: how many different ones `vary` makes.
        threads: default: one for each core.

    Attributes:
        names: of the numbers of an observation. fleet: plants and controllers.
        move: (6,) the largest increments (m, rad). most_force: the largest force (N).

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
        alike = [f"{SEED}=integers(0, 0)"]
        study = SweepStudy.of(
            scenario, vary or alike, episodes, "halton" if vary else "random", overrides=overrides
        )
        self._episode = episode_maker(study, 1.0 / rate)
        self._count = episodes if vary else 1
        first = self._episode(0)
        control_rate = 1.0 / first.start.controller.dt
        self._ticks = round(control_rate / rate)
        if num_envs < 1 or self._ticks < 1 or abs(self._ticks * rate - control_rate) > 1e-6 * rate:
            raise InvalidInputError(
                f"{num_envs} environments, actions at {rate:g} Hz, control at {control_rate:g} Hz: "
                "give one environment at least, and a rate that divides that of control"
            )
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
        self._reward = reward
        verdict = first.start.rig.scenario.verdict
        self._away = (verdict.distance, verdict.angle)
        self._r = first.forces.shape[1]
        self.move = np.repeat(_needed(first.places) if move is None else move, 3)
        largest = 2.0 * float(np.abs(first.forces).max(initial=0.0))
        self.most_force = largest if most_force is None else most_force
        require_below_ceilings(first.start.rig.scenario.control.safety, self.most_force, self._r)
        self._now = [first] * num_envs
        count = available_cores() if threads is None else threads
        self.fleet = Fleet([first.start] * num_envs, min(count, num_envs))
        self._step = np.zeros(num_envs, dtype=int)
        self._target = np.tile(first.places[0], (num_envs, 1, 1))
        self._forces = np.zeros((num_envs, self._r))
        self._over = np.zeros(num_envs, dtype=bool)
        self.names = self._name_numbers(first)
        numbers = gymnasium.spaces.Box(-np.inf, np.inf, (len(self.names),), np.float64)
        actions = gymnasium.spaces.Box(-1.0, 1.0, (6 + self._r,), np.float64)
        self.single_observation_space = numbers
        self.single_action_space = actions
        self.observation_space = batch_space(numbers, num_envs)
        self.action_space = batch_space(actions, num_envs)

    def _name_numbers(self, first: Episode) -> list[str]:
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
        return [f"{what} {one}" for what, every in groups for one in every]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """All rows begin anew; see gymnasium."""
        super().reset(seed=seed)
        self._begin(range(self.num_envs))
        return (self._observe(), self._infos())

    def _begin(self, rows: Sequence[int]) -> None:
        if not rows:
            return
        numbers = self.np_random.integers(self._count, size=len(rows))
        for row, number in zip(rows, numbers.tolist(), strict=True):
            self._now[row] = episode = self._episode(number)
            self._target[row] = episode.places[0]
            self._forces[row] = episode.forces[0]
        self.fleet.begin({row: self._now[row].start for row in rows})
        self._step[rows] = 0
        self._over[rows] = False

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Every row one action further; see gymnasium."""
        actions = np.clip(np.asarray(actions, dtype=float), -1.0, 1.0)
        if actions.shape != (self.num_envs, 6 + self._r):
            raise InvalidInputError(
                f"actions: expected {(self.num_envs, 6 + self._r)}, got {actions.shape}"
            )
        again = self._over.copy()
        going = ~again
        tau = self._advance(actions, going)
        self._begin(np.flatnonzero(again).tolist())
        self._step[going] += 1
        seen = self._see(actions, tau)
        rewards = np.where(going, self._reward(seen), 0.0)
        away = np.linalg.norm(seen.error.reshape(-1, 2, 3), axis=2) > self._away
        terminated = going & (seen.diverged | away.any(axis=1))
        truncated = going & ~terminated & (self._step >= self._last)
        self._over = terminated | truncated
        return (self._observe(), rewards, terminated, truncated, self._infos())

    def _advance(self, actions: Array, going: Array) -> Array:
        """The ticks of one action; rows that are over stand still. Returns the last torques."""
        T = self._ticks
        increment = np.where(going[:, None], actions[:, :6] * self.move, 0.0)
        forces = 0.5 * (actions[:, 6:] + 1.0) * self.most_force
        forces = np.where(going[:, None], forces, self._forces)
        share = np.arange(1, T + 1)[:, None, None] / T
        X = moved(self._target, share * increment)
        V = increment / (T * self.fleet.dt)
        alpha = self._forces + share * (forces - self._forces)
        squeeze = np.array([episode.squeeze for episode in self._now])
        for k in range(T):
            tau = self.fleet.tick(X[k], V, np.zeros_like(V), alpha[k], squeeze)
        self._target = X[-1].copy()
        self._forces = forces
        return tau

    def _see(self, actions: Array, tau: Array) -> SensedRows:
        places, forces = self._desired()
        p, R = self.fleet.objects()
        error = np.concatenate(
            (places[:, :3, 3] - p, _turns(places[:, :3, :3] @ R.transpose(0, 2, 1))), axis=1
        )
        stopped = self.fleet.control.state == SafetyState.SAFE_STOP
        diverged = self.fleet.diverged() | stopped | ~np.isfinite(error).all(axis=1)
        force = self.fleet.control.alpha_meas
        return SensedRows(force, forces, error, tau, actions, diverged)

    def _desired(self, ahead: int = 0) -> tuple[Array, Array]:
        """(B, 4, 4), (B, r): what the scenario specifies so many actions from now."""
        steps = np.minimum(self._step + ahead, self._last)
        at = list(zip(self._now, steps, strict=True))
        forces = np.array([episode.forces[k] for episode, k in at])
        return (np.array([episode.places[k] for episode, k in at]), forces)

    @property
    def _last(self) -> Array:
        """(B,) the last step of each row's episode."""
        return np.array([len(episode.places) - 1 for episode in self._now])

    def _observe(self) -> Array:
        q, v, wrenches = self.fleet.measure()
        control = self.fleet.control
        places, forces = self._desired(1)
        first = np.array([episode.places[0] for episode in self._now])
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
        samples = np.array([episode.number for episode in self._now])
        return {"sample": samples, "_sample": np.ones(self.num_envs, dtype=bool)}


def _needed(places: Array) -> Array:
    """(2,) twice the largest increments between poses, one after the other (m, rad)."""
    largest = np.abs(_displacement(places[:-1], places[1:])).reshape(-1, 2, 3).max(axis=(0, 2))
    return np.maximum((1e-3, 5e-3), 2.0 * largest)


def _displacement(start: Array, end: Array) -> Array:
    """(B, 6) from poses (B, 4, 4) to others: m, rad, world axes."""
    turn = _turns(end[:, :3, :3] @ start[:, :3, :3].transpose(0, 2, 1))
    return np.concatenate((end[:, :3, 3] - start[:, :3, 3], turn), axis=1)


def _turns(R: Array) -> Array:
    """(B, 3) rotation vectors of rotations (B, 3, 3); NaN where they are none."""
    return np.array([pin.log3(one) if np.isfinite(one).all() else [np.nan] * 3 for one in R])


make_vector_env = ContactVectorEnv
