"""From the raw rows of a run to the channels of its recording, many ticks at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.control.controller import Controller
from osc_contact.control.monitor import ContactMonitor, watch_series
from osc_contact.control.phases import Phase
from osc_contact.plants.judge import TruthLog, Truths
from osc_contact.runs.contacts import feet_over
from osc_contact.runs.free_motion import free_parts
from osc_contact.spatial import Array, Poses, cross

__all__ = ["Monitor", "Subject", "Tick", "channels", "work_out"]

_TOGETHER = 1000  #: rows whose channels are worked out together


@dataclass(frozen=True)
class Subject:
    """What is recorded.

    Attributes:
        controller: whose ticks are noted.
        pairs: the true contacts. placements: X_WB of the body of each at the start.
        owners: (r,) the contact of each force magnitude.
        free: whether the arms can move the object in all six directions.
    """

    controller: Controller
    pairs: tuple[ContactPair, ...]
    placements: tuple[pin.SE3, ...]
    owners: Array
    free: bool

    @cached_property
    def pushing(self) -> NDArray[np.bool_]:
        """(r,) whether each force magnitude must not become negative."""
        return np.array([pushes_only(self.pairs[i]) for i in self.owners], dtype=bool)


def channels(of: Subject, log: TruthLog | None, first: int, rows: Array) -> dict[str, Array]:
    """The channels of some ticks, but for what the contact monitor remembers.

    Args:
        of: what was recorded. log: of the judge, which knows what its notes mean; None: no judge.
        first: number of the first tick. rows: (k,) as the run's log noted them.
    """
    k, controller = len(rows), of.controller
    alpha, speed = rows["alpha"], rows["speed"]
    phase = _phases(of, rows)
    truth = _believed(of, rows, phase) if log is None else log.truths(rows["truth"])
    N, points, directions = _lines(of, truth, k)
    wrench = rows["f_meas"] - rows["bias_out"]
    projected = (speed * alpha).sum(axis=1)  # V_relᵀNα, whatever the faces do
    total = (rows["V_O"] * (wrench - rows["f_c"])).sum(axis=1) + projected
    made = {
        "t": np.arange(first, first + k) * controller.dt,
        "q": rows["q"],
        "v": rows["v"],
        "tau": rows["tau"],
        "tick_s": rows["tick_s"][:, 0],
        "pose": truth.X_WO.coordinates(k),
        "twist": truth.V_O,
        "alpha_cmd": rows["alpha_d"],
        "alpha_meas": alpha,
        "alpha_true": truth.alpha,
        "closed": truth.closed,
        "N": N.transpose(2, 0, 1),
        "contact_point": points,
        "contact_direction": directions,
        "face_pose": _face_poses(of, truth, k),
        "wrench_meas": wrench,
        "power_total": total,
        "power_projected": projected,
        "motion_error": _motion_error(of, rows, N, phase),
        "squeeze_cmd": _squeeze_cmd(rows["squeeze_d"]),
        "squeeze": rows["squeeze"][:, 0] if len(controller.chain.arms) < 3 else rows["squeeze"],
        "alpha_given_up": rows["given_up"],
        "status": rows["status"][:, 0].astype(np.int64),
        "contact_phase": phase,
    }
    if log is None:
        del made["alpha_true"]
    return {name: np.ascontiguousarray(values) for name, values in made.items()}


class Monitor:
    """What the contact monitor tells of each magnitude, from projected force and power.

    Where a magnitude may have either sign its size counts.
    """

    def __init__(self, of: Subject) -> None:
        """Begin at the first tick."""
        self._of = of
        self._monitor = ContactMonitor(len(of.owners), of.controller.dt)

    def channels(self, rows: Array) -> dict[str, Array]:
        """Of the ticks that follow those it was told of before."""
        if self._of.controller.life is not None:  # the controller had one listening
            pushing = self._of.pushing  # what can pull stays in contact
            closed, collision = rows["closed"] > 0.0, rows["collision"] > 0.0
            return {"contact_seen": closed | ~pushing, "collision_seen": collision & pushing}
        alpha = np.where(self._of.pushing, rows["alpha"], np.abs(rows["alpha"]))
        closed, collision = watch_series(self._monitor, alpha, rows["speed"])
        return {"contact_seen": closed, "collision_seen": collision}


def work_out(
    of: Subject, log: TruthLog | None, parts: Iterable[tuple[int, Array]]
) -> Iterator[dict[str, Array]]:
    """All channels of a journal's rows, block after block.

    The blocks are the same however the rows came, and so is every bit of the channels.

    Args:
        of: what was run. log: the judge's; None: there is none.
        parts: of the journal: index of the first row, and (rows, columns) numbers.
    """
    monitor = Monitor(of)
    for first, rows in _blocks(parts):
        yield channels(of, log, first, rows) | monitor.channels(rows)


def _blocks(parts: Iterable[tuple[int, Array]]) -> Iterator[tuple[int, Array]]:
    """Rows of a journal cut at every 1,000 ticks, wherever its chunks end.

    Args:
        parts: number of the first row, rows; in order.
    """
    begin, waiting = 0, np.zeros(0)
    for first, rows in parts:
        if len(waiting) and first != begin + len(waiting):
            yield begin, waiting
            waiting = np.zeros(0)
        if not len(waiting):
            begin, waiting = first, rows
        else:
            waiting = np.concatenate((waiting, rows))
        while (cut := _TOGETHER - begin % _TOGETHER) <= len(waiting):
            yield begin, waiting[:cut]
            begin, waiting = begin + cut, waiting[cut:]
    if len(waiting):
        yield begin, waiting


class Tick(Mapping[str, Any]):
    """The channels of one tick, worked out when they are read."""

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


def _phases(of: Subject, rows: Array) -> Array:
    """(k, contacts)"""
    if "phase" in (rows.dtype.names or ()):
        return (rows["phase"] * rows["active"]).astype(np.int64)  # OPEN is 0
    all_of_them = np.where(rows["engaged"] > 0.0, Phase.CLOSED, Phase.OPEN)
    return np.repeat(all_of_them, len(of.pairs), axis=1).astype(np.int64)


def _squeeze_cmd(wanted: Array) -> Array:
    return wanted[:, 0] if np.isnan(wanted[:, 1:]).all() else wanted


def _believed(of: Subject, rows: Array, phase: Array) -> Truths:
    """What the controller takes for the truth, where no judge knows better."""
    pairs, k = of.pairs, len(rows)
    X_WO = _poses(rows["X_WO"].reshape(k, 4, 4))
    X_WE = rows["X_WE"].reshape(k, len(pairs), 4, 4)
    faces = tuple(_poses(X_WE[:, i]) for i in range(len(pairs)))
    N = tuple(normals_over(pair, X_WO, X) for pair, X in zip(pairs, faces, strict=True))
    return Truths(rows["alpha"], phase == Phase.CLOSED, X_WO, rows["V_O"], faces, N)


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
            moved = np.stack([X_WE.rotate(R[:, j]) for j in range(3)], axis=1)
            R, p = moved, X_WE.p + X_WE.rotate(p)
        out[:, i] = Poses(R, p).coordinates(k)
    return out


def _motion_error(of: Subject, rows: Array, N: Array, phase: Array) -> Array:
    """What the arms can make of the pose error and the contact forces in the model permit."""
    if "J" not in (rows.dtype.names or ()):
        return rows["free_error"]
    q, error, k = rows["q"], rows["error"], len(rows)
    J = np.ascontiguousarray(rows["J"].T).reshape(-1, 6, k).swapaxes(0, 1)
    X = _poses(rows["X_WO"].reshape(k, 4, 4))
    held = phase[:, of.owners] != Phase.OPEN
    changes = np.flatnonzero((held[1:] != held[:-1]).any(axis=1)) + 1
    known = np.isfinite(np.concatenate((q, error), axis=1)).all(axis=1)  # others were held
    out = np.full((k, 6), np.nan)
    for a, b in pairwise([0, *changes, k]):
        i = a + np.flatnonzero(known[a:b])
        if not len(i):
            continue
        poses, lines = Poses(X.R[..., i], X.p[:, i]), N[:, held[a]][..., i]
        chain = of.controller.chain
        out[i] = free_parts(chain, q[i], J[:, :, i], poses, lines, error[i].T).T
    return out
