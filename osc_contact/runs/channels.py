"""From the raw rows of a run to the channels of its recording, many ticks at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from osc_contact.control.life import Phase
from osc_contact.control.monitor import ContactMonitor
from osc_contact.plants.plant import Truths
from osc_contact.runs.contacts import feet_over
from osc_contact.runs.free_motion import free_parts
from osc_contact.runs.log import FOUND, Log
from osc_contact.runs.references import Plan
from osc_contact.runs.rig import Rig
from osc_contact.runs.watching import watch_series
from osc_contact.spatial import Array, Poses, cross

__all__ = ["Tick", "channels", "monitored"]


def channels(rig: Rig, log: Log, plan: Plan, start: int, stop: int) -> dict[str, Array]:
    """The channels of ticks start to stop − 1, but for what the contact monitor remembers.

    Args:
        rig, plan: of the run. log: what it noted.
    """
    rows, k = slice(start, stop), stop - start
    truth = log.truth.truths(log.rows("truth", start, stop), start, stop)
    names = ("q", "v", "tau", "alpha", "speed", *FOUND)
    found = {name: log.rows(name, start, stop) for name in names}
    alpha, speed = found["alpha"], found["speed"]
    N, points, directions = _lines(rig, truth, k)
    tick_s, status, phase = log.ends(start, stop)
    wrench = found["f_meas"] - found["bias_out"]
    projected = (speed * alpha).sum(axis=1)  # V_relᵀNα, whatever the faces do
    total = (found["V_O"] * (wrench - found["f_c"])).sum(axis=1) + projected
    made = {
        "t": np.arange(start, stop) * (1.0 / rig.scenario.control.rate),
        "q": found["q"],
        "v": found["v"],
        "tau": found["tau"],
        "tick_s": tick_s,
        "pose": truth.X_WO.coordinates(k),
        "twist": truth.V_O,
        "alpha_cmd": plan.alpha_d[rows],
        "alpha_meas": alpha,
        "alpha_true": truth.alpha,
        "closed": truth.closed,
        "N": N.transpose(2, 0, 1),
        "contact_point": points,
        "contact_direction": directions,
        "face_pose": _face_poses(rig, truth, k),
        "wrench_meas": wrench,
        "power_total": total,
        "power_projected": projected,
        "motion_error": _motion_error(rig, log, start, found, N, phase),
        "squeeze_cmd": np.full(k, plan.squeeze_d),
        "squeeze": found["squeeze"][:, 0] if len(rig.chain.arms) < 3 else found["squeeze"],
        "alpha_given_up": log.given_up[rows],
        "status": status,
        "contact_phase": phase,
    }
    return {name: np.ascontiguousarray(values) for name, values in made.items()}


def monitored(rig: Rig, log: Log) -> dict[str, Array]:
    """What the contact monitor tells of each magnitude, from projected force and power.

    Where a magnitude may have either sign its size counts.
    """
    if rig.scenario.control.life is not None:  # the controller had one listening
        closed, collision = log.seen[:, : log.count]
        return {"contact_seen": closed, "collision_seen": collision}
    alpha, speed = (log.rows(name, 0, log.count) for name in ("alpha", "speed"))
    monitor = ContactMonitor(alpha.shape[1], 1.0 / rig.scenario.control.rate)
    alpha = np.where(rig.pushing, alpha, np.abs(alpha))
    closed, collision = watch_series(monitor, alpha, speed)
    return {"contact_seen": closed, "collision_seen": collision}


class Tick(Mapping[str, Any]):
    """The channels of one tick, worked out when somebody reads them."""

    def __init__(self, made: Callable[[], dict[str, Array]]) -> None:
        """`made` gives channels of one row each."""
        self._made = made
        self._rows: dict[str, Array] = {}

    def _read(self) -> dict[str, Array]:
        if not self._rows:
            self._rows = self._made()
        return self._rows

    def __getitem__(self, name: str) -> Any:
        return self._read()[name][0]

    def __iter__(self) -> Iterator[str]:
        return iter(self._read())

    def __len__(self) -> int:
        return len(self._read())


def _lines(rig: Rig, truth: Truths, k: int) -> tuple[Array, Array, Array]:
    """Unit lines of force (6, r, k), and of each contact where they meet the surface, their mean,
    and the direction of the first: (k, contacts, 3) both."""
    N, points, directions = [np.zeros((6, 0, k))], [], []
    for pair, own, X_WE in zip(rig.pairs, truth.N, truth.X_WE, strict=True):
        p, n = feet_over(pair, own, truth.X_WO, X_WE)
        N.append(np.concatenate((n, cross(p - truth.X_WO.p[:, None], n))))
        points.append(p.mean(axis=1).T)
        directions.append(n[:, 0].T)
    shape = (len(rig.pairs), k, 3)
    first, second = (np.reshape(x, shape).transpose(1, 0, 2) for x in (points, directions))
    return np.concatenate(N, axis=1), first, second


def _face_poses(rig: Rig, truth: Truths, k: int) -> Array:
    out = np.zeros((k, len(rig.pairs), 7))
    for i, X_WE in enumerate(truth.X_WE):
        body = rig.bodies[rig.on[i]].placement
        R, p = body.rotation[:, :, None], body.translation[:, None]
        if X_WE is not None:
            moved = np.stack([X_WE.turn(R[:, j]) for j in range(3)], axis=1)
            R, p = moved, X_WE.p + X_WE.turn(p)
        out[:, i] = Poses(R, p).coordinates(k)
    return out


def _motion_error(
    rig: Rig, log: Log, start: int, found: Mapping[str, Array], N: Array, phase: Array
) -> Array:
    """What the arms can make of the pose error and the contact forces in the model permit."""
    if "J" not in log:
        return found["free_error"]
    q, error, k = found["q"], found["error"], len(found["q"])
    J = np.ascontiguousarray(log.rows("J", start, start + k).T).reshape(-1, 6, k).swapaxes(0, 1)
    X = found["X_WO"].reshape(k, 4, 4).transpose(1, 2, 0)
    held = phase[:, rig.owners] != Phase.OPEN
    changes = np.flatnonzero((held[1:] != held[:-1]).any(axis=1)) + 1
    out = np.empty((k, 6))
    for a, b in pairwise([0, *changes, k]):
        poses = Poses(X[:3, :3, a:b], X[:3, 3, a:b])
        lines = N[:, held[a], a:b]
        out[a:b] = free_parts(rig.model, q[a:b], J[:, :, a:b], poses, lines, error[a:b].T).T
    return out
