"""Channels of a recording: time series computed from the stored rows of many ticks at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from osc_contact.contacts.feet import feet_over
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.control.monitor import ContactMonitor, watch_series
from osc_contact.control.status import Phase
from osc_contact.loop.judge import ReadsTruth, Truths
from osc_contact.recorder import Recording
from osc_contact.recorder.archive import gather
from osc_contact.recorder.journal import Journal
from osc_contact.spatial import Array, Poses

_ROWS_OF_BLOCK = 1000  #: number of rows whose channels are computed together


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Description of a recorded system, from which the channels of its rows are computed.

    Attributes:
        pairs: the true contacts.
        placements: (contacts, 4, 4) initial pose X_WB of the touched body of each contact.
        owners: (r,) index of the contact of each force magnitude.
        dt: control period (s).
        arms: number of arms.
        phased: True with contact phases; otherwise all contacts are engaged together.
    """

    pairs: tuple[ContactPair, ...]
    placements: Array
    owners: Array
    dt: float
    arms: int
    phased: bool


def channels(
    subject: Subject, truths: ReadsTruth | None, first: int, rows: Array
) -> dict[str, Array]:
    """Compute the channels of k ticks, except those of the contact monitor.

    Most are values of the law's records in the rows.

    Args:
        subject: description of the recorded system.
        truths: evaluates the numbers stored by the judge; None: measured values stand in for the
            truth.
        first: number of the first tick.
        rows: (k,) stored rows with named fields.

    Returns:
        Arrays (k, …) by the name of their channel.
    """
    k = len(rows)
    alpha = rows["alpha"]
    squeeze = rows["squeeze_d"]
    phase = _phases_of_ticks(subject, rows)
    if truths is None:
        truth = _measured_truths(subject, rows, phase)
    else:
        truth = truths.truths(rows["truth"])
    N = np.concatenate((np.zeros((6, 0, k)), *truth.N), axis=1)
    points, directions = _contact_points(subject, truth, k)
    total, projected = _powers(rows)
    series = {
        "t": np.arange(first, first + k) * subject.dt,
        **{name: rows[name] for name in ("q", "v", "tau")},
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
        "face_pose": _face_poses(subject, truth, k),
        "wrench_meas": rows["f_meas"] - rows["bias_out"],
        "power_total": total,
        "power_projected": projected,
        "motion_error": rows["free_error"],
        "squeeze_cmd": squeeze[:, 0] if np.isnan(squeeze[:, 1:]).all() else squeeze,
        "squeeze": rows["squeeze"][:, 0] if subject.arms < 3 else rows["squeeze"],
        "alpha_given_up": rows["given_up"],
        "friction": rows["friction"],
        "normal_std": np.where(rows["normal_std"] > 0.0, rows["normal_std"], np.nan),
        "status": rows["status"][:, 0].astype(np.int64),
        "contact_phase": phase,
        "contact_named": rows["named"] > 0.0,
    }
    if truths is None:
        del series["alpha_true"]
    return {name: np.ascontiguousarray(values) for name, values in series.items()}


def _powers(rows: Array) -> tuple[Array, Array]:
    """Compute the power of the measured wrench, and of the contact forces along N, (k,) each (W).

    The latter is V_relᵀNα, for faces at rest or in motion; with the wrench f of the wrists less
    bias V_Oᵀ(f − N α) is added for the former.

    Args:
        rows: (k,) stored rows with named fields.
    """
    wrench = rows["f_meas"] - rows["bias_out"]
    projected = (rows["speed"] * rows["alpha"]).sum(axis=1)
    total = (rows["V_O"] * (wrench - rows["f_c"])).sum(axis=1) + projected
    return total, projected


def work_out(
    subject: Subject, truths: ReadsTruth | None, parts: Iterable[tuple[int, Array]]
) -> Iterator[dict[str, Array]]:
    """Compute all channels of a journal's rows, block by block.

    The blocks do not depend on the chunks of the journal, so the channels are identical to the last
    bit. Contacts and collisions are detected from projected force and power; of a magnitude that
    may have either sign the absolute value is used.

    Args:
        subject: description of the recorded system.
        truths: evaluates the numbers stored by the judge; None: without a judge.
        parts: chunks of the journal, each the number of its first row and its rows.

    Yields:
        Channels by name, of at most 1,000 successive ticks.
    """
    unilateral = np.array([pushes_only(subject.pairs[i]) for i in subject.owners], dtype=bool)
    monitor = ContactMonitor(len(subject.owners), subject.dt)
    for first, rows in _row_blocks(parts):
        if subject.phased:  # results of the controller's own monitor
            bilateral_active = ~unilateral & (rows["active"][:, subject.owners] > 0.0)
            # a bilateral contact is closed while it is active
            is_closed = (rows["closed"] > 0.0) | bilateral_active
            collision = (rows["collision"] > 0.0) & unilateral
        else:
            alpha = np.where(unilateral, rows["alpha"], np.abs(rows["alpha"]))
            is_closed, collision = watch_series(monitor, alpha, rows["speed"])
        detections = {"contact_seen": is_closed, "collision_seen": collision}
        yield channels(subject, truths, first, rows) | detections


def _row_blocks(parts: Iterable[tuple[int, Array]]) -> Iterator[tuple[int, Array]]:
    """Divide the rows of a journal into blocks at multiples of 1,000 ticks, and where rows lack.

    Args:
        parts: chunks in order, each the number of its first row and its rows.

    Yields:
        Number of the first row of a block, and the rows of the block.
    """
    begin = 0
    pieces: list[Array] = []  # rows of the block that begins at `begin`
    for first, rows in parts:
        while len(rows):
            # a block ends where rows are missing, or at a multiple of _ROWS_OF_BLOCK
            count = sum(len(piece) for piece in pieces)
            if count and (first != begin + count or first % _ROWS_OF_BLOCK == 0):
                yield begin, np.concatenate(pieces)
                pieces = []
            if not pieces:
                begin = first
            rows_to_end = _ROWS_OF_BLOCK - first % _ROWS_OF_BLOCK
            pieces.append(rows[:rows_to_end])
            first = first + len(pieces[-1])
            rows = rows[rows_to_end:]
    if pieces:
        yield begin, np.concatenate(pieces)


def _phases_of_ticks(subject: Subject, rows: Array) -> Array:
    """Value of `Phase` (k, contacts) of each contact in k ticks, OPEN if it is not active.

    Without contact phases an active contact counts as CLOSED.

    Args:
        subject: description of the recorded system.
        rows: (k,) stored rows with the fields `active` and, with contact phases, `phase`.
    """
    phase_if_active = rows["phase"] if subject.phased else Phase.CLOSED
    phase = rows["active"] * phase_if_active  # `active` is 0 or 1, and OPEN is 0
    return phase.astype(np.int64)


def _measured_truths(subject: Subject, rows: Array, phase: Array) -> Truths:
    """Values by the controller in place of the truth, for recordings without a judge.

    Args:
        subject: description of the recorded system.
        rows: (k,) stored rows with the controller's results.
        phase: (k, contacts) values of `Phase`; a contact counts as closed in CLOSED.
    """
    pairs = subject.pairs
    k = len(rows)
    X_WO = _poses_of_matrices(rows["X_WO"].reshape(k, 4, 4))
    X_WE = rows["X_WE"].reshape(k, len(pairs), 4, 4)
    faces = tuple(_poses_of_matrices(X_WE[:, i]) for i in range(len(pairs)))
    N = tuple(normals_over(pair, X_WO, X) for pair, X in zip(pairs, faces, strict=True))
    return Truths(rows["alpha"], phase == Phase.CLOSED, X_WO, rows["V_O"], faces, N)


def _poses_of_matrices(X: Array) -> Poses:
    """Convert k homogeneous matrices (k, 4, 4) to `Poses`."""
    return Poses(X[:, :3, :3].transpose(1, 2, 0), X[:, :3, 3].T)


def _contact_points(subject: Subject, truth: Truths, k: int) -> Array:
    """Mean contact point and first direction of force of each contact at k instants.

    Contact points are the intersections of the lines of force with the touched surface.

    Args:
        subject: description of the recorded system, with its contacts.
        truth: poses and lines of force at k instants.
        k: number of instants.

    Returns:
        (2, k, contacts, 3): points in world coordinates (m), then unit directions in world axes.
    """
    feet = []
    for pair, lines, X_WE in zip(subject.pairs, truth.N, truth.X_WE, strict=True):
        points, directions = feet_over(pair, lines, truth.X_WO, X_WE)
        feet.append((points.mean(axis=1).T, directions[:, 0].T))
    return np.reshape(feet, (-1, 2, k, 3)).transpose(1, 2, 0, 3)


def _face_poses(subject: Subject, truth: Truths, k: int) -> Array:
    """Poses in the world of the body that each contact touches, at k instants.

    The face of a contact is described in a frame E. E is the world's frame while the body is at its
    initial pose X_WB, so the body's pose later is X_WE X_WB.

    Args:
        subject: description of the recorded system, with the initial poses X_WB of the bodies.
        truth: pose X_WE of each face's frame at k instants; None: the face is at rest.
        k: number of instants.

    Returns:
        (k, contacts, 7) position x, y, z (m) and quaternion x, y, z, w of each body.
    """
    coordinates = np.zeros((k, len(subject.pairs), 7))
    for i, (X_WB, X_WE) in enumerate(zip(subject.placements, truth.X_WE, strict=True)):
        R = X_WB[:3, :3, None]  # (3, 3, 1) and (3, 1): the last axis is that of the instants
        p = X_WB[:3, 3:]
        if X_WE is not None:
            R = X_WE.rotate(R)
            p = X_WE.act(p)
        coordinates[:, i] = Poses(R, p).coordinates(k)
    return coordinates


def add_stages(recording: Recording) -> None:
    """Add the stage of a plan in each tick, if there was a plan, from the events of a recording.

    The channel `stage` has the number of the stage, −1 before the first one; `meta["stages"]` has
    the names by number.

    Args:
        recording: recording of a run; changed in place.
    """
    beginnings = [event for event in recording.events if event["event"] == "stage"]
    if not beginnings:
        return
    names = [""] * (1 + max(event["number"] for event in beginnings))
    for event in beginnings:
        names[event["number"]] = event["name"]
    numbers = np.array([-1, *(event["number"] for event in beginnings)])
    starts = np.array([event["t"] for event in beginnings])
    # a stage begins in the tick next to its time; half a period absorbs rounding errors of the
    # times
    half_period = 0.5 / recording.meta["control_rate_hz"]
    recording.channels["stage"] = numbers[np.searchsorted(starts, recording["t"] + half_period)]
    recording.meta["stages"] = names


def recording_of(
    subject: Subject, truths: ReadsTruth | None, journal: Journal, meta: Mapping[str, Any]
) -> Recording:
    """Make a recording from the rows of a journal.

    Args:
        subject: description of the recorded system.
        truths: evaluates the numbers stored by the judge; None: without a judge.
        journal: rows, read from the beginning.
        meta: meta data of the recording.
    """
    ticks = sum(len(rows) for _, rows in journal.rows())
    return Recording(meta, gather(ticks, work_out(subject, truths, journal.rows())))
