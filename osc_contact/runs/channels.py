"""From the raw rows of a run to the channels of its recording, many ticks at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.control.life import Phase
from osc_contact.control.monitor import ContactMonitor, watch_series
from osc_contact.plants.judge import Truths
from osc_contact.runs.contacts import feet_over
from osc_contact.runs.free_motion import free_parts
from osc_contact.runs.log import FOUND, Log, Subject
from osc_contact.spatial import Array, Poses, cross

__all__ = ["Tick", "channels", "monitored"]


def channels(log: Log, start: int, stop: int) -> dict[str, Array]:
    """The channels of ticks start to stop − 1, but for what the contact monitor remembers.

    Args:
        log: what the run noted. start, stop: numbers of ticks.
    """
    rows, k, controller = slice(start, stop), stop - start, log.of.controller
    names = ("q", "v", "tau", "alpha_d", "alpha", "speed", *FOUND)
    found = {name: log.rows(name, start, stop) for name in names}
    alpha, speed = found["alpha"], found["speed"]
    tick_s, status, phase = log.ends(start, stop)
    if log.truth is None:
        truth = _believed(log, found, phase, start, stop)
    else:
        truth = log.truth.truths(log.rows("truth", start, stop), start, stop)
    N, points, directions = _lines(log.of, truth, k)
    wrench = found["f_meas"] - found["bias_out"]
    projected = (speed * alpha).sum(axis=1)  # V_relᵀNα, whatever the faces do
    total = (found["V_O"] * (wrench - found["f_c"])).sum(axis=1) + projected
    made = {
        "t": np.arange(start, stop) * controller.dt,
        "q": found["q"],
        "v": found["v"],
        "tau": found["tau"],
        "tick_s": tick_s,
        "pose": truth.X_WO.coordinates(k),
        "twist": truth.V_O,
        "alpha_cmd": found["alpha_d"],
        "alpha_meas": alpha,
        "alpha_true": truth.alpha,
        "closed": truth.closed,
        "N": N.transpose(2, 0, 1),
        "contact_point": points,
        "contact_direction": directions,
        "face_pose": _face_poses(log.of, truth, k),
        "wrench_meas": wrench,
        "power_total": total,
        "power_projected": projected,
        "motion_error": _motion_error(log, start, found, N, phase),
        "squeeze_cmd": log.squeeze_d(start, stop),
        "squeeze": found["squeeze"][:, 0] if len(controller.chain.arms) < 3 else found["squeeze"],
        "alpha_given_up": log.given_up[rows],
        "status": status,
        "contact_phase": phase,
    }
    if log.truth is None:
        del made["alpha_true"]
    return {name: np.ascontiguousarray(values) for name, values in made.items()}


def monitored(log: Log) -> dict[str, Array]:
    """What the contact monitor tells of each magnitude, from projected force and power.

    Where a magnitude may have either sign its size counts.
    """
    if log.of.controller.life is not None:  # the controller had one listening
        closed, collision = log.seen[:, : log.count]
        return {"contact_seen": closed, "collision_seen": collision}
    alpha, speed = (log.rows(name, 0, log.count) for name in ("alpha", "speed"))
    monitor = ContactMonitor(alpha.shape[1], log.of.controller.dt)
    alpha = np.where(log.of.pushing, alpha, np.abs(alpha))
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


def _believed(log: Log, found: Mapping[str, Array], phase: Array, start: int, stop: int) -> Truths:
    """What the controller takes for the truth, where no judge knows better."""
    pairs, k = log.of.pairs, stop - start
    X_WO = _poses(found["X_WO"].reshape(k, 4, 4))
    X_WE = log.rows("X_WE", start, stop).reshape(k, len(pairs), 4, 4)
    faces = tuple(_poses(X_WE[:, i]) for i in range(len(pairs)))
    N = tuple(normals_over(pair, X_WO, X) for pair, X in zip(pairs, faces, strict=True))
    return Truths(found["alpha"], phase == Phase.CLOSED, X_WO, found["V_O"], faces, N)


def _poses(X: Array) -> Poses:
    """Of k homogeneous matrices (k, 4, 4)."""
    return Poses(X[:, :3, :3].transpose(1, 2, 0), X[:, :3, 3].T)


def _lines(of: Subject, truth: Truths, k: int) -> tuple[Array, Array, Array]:
    """Unit lines of force (6, r, k), and of each contact where they meet the surface, their mean,
    and the direction of the first: (k, contacts, 3) both."""
    N, points, directions = [np.zeros((6, 0, k))], [], []
    for pair, own, X_WE in zip(of.pairs, truth.N, truth.X_WE, strict=True):
        p, n = feet_over(pair, own, truth.X_WO, X_WE)
        N.append(np.concatenate((n, cross(p - truth.X_WO.p[:, None], n))))
        points.append(p.mean(axis=1).T)
        directions.append(n[:, 0].T)
    shape = (len(of.pairs), k, 3)
    first, second = (np.reshape(x, shape).transpose(1, 0, 2) for x in (points, directions))
    return np.concatenate(N, axis=1), first, second


def _face_poses(of: Subject, truth: Truths, k: int) -> Array:
    out = np.zeros((k, len(of.pairs), 7))
    for i, X_WE in enumerate(truth.X_WE):
        body = of.placements[i]
        R, p = body.rotation[:, :, None], body.translation[:, None]
        if X_WE is not None:
            moved = np.stack([X_WE.turn(R[:, j]) for j in range(3)], axis=1)
            R, p = moved, X_WE.p + X_WE.turn(p)
        out[:, i] = Poses(R, p).coordinates(k)
    return out


def _motion_error(
    log: Log, start: int, found: Mapping[str, Array], N: Array, phase: Array
) -> Array:
    """What the arms can make of the pose error and the contact forces in the model permit."""
    if "J" not in log:
        return found["free_error"]
    q, error, k = found["q"], found["error"], len(found["q"])
    J = np.ascontiguousarray(log.rows("J", start, start + k).T).reshape(-1, 6, k).swapaxes(0, 1)
    X = _poses(found["X_WO"].reshape(k, 4, 4))
    held = phase[:, log.of.owners] != Phase.OPEN
    changes = np.flatnonzero((held[1:] != held[:-1]).any(axis=1)) + 1
    known = np.isfinite(np.concatenate((q, error), axis=1)).all(axis=1)  # others were held
    out = np.full((k, 6), np.nan)
    for a, b in pairwise([0, *changes, k]):
        i = a + np.flatnonzero(known[a:b])
        if not len(i):
            continue
        poses, lines = Poses(X.R[..., i], X.p[:, i]), N[:, held[a]][..., i]
        chain = log.of.controller.chain
        out[i] = free_parts(chain, q[i], J[:, :, i], poses, lines, error[i].T).T
    return out
