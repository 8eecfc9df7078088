"""The task: wear an edge of hidden hardness evenly, in one pass of a bar along it.

A pass takes off dh = k(y) f |dy| at a place y (Preston's law): k says how soft the edge is there, f
is the true contact force. No sensor reads k and no force law can know it. The depth is gauged after
the pass, and a learner is told one number: how uneven it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import osc_contact as osc
from osc_contact.spatial import Array
from osc_contact.sweeps.vector_env import ContactVectorEnv

__all__ = [
    "EDGES",
    "INTO",
    "MEAN",
    "Passes",
    "best_forces",
    "make_env",
    "polish",
    "softness",
    "touch",
]

LENGTH, BEFORE, AFTER = 0.1, 0.2, 0.2  #: m, of the pass; s, in which the bar only presses
EDGES = np.linspace(-0.04, 0.04, 21)  #: m; between them the depth is gauged
MEAN, MOST = 15.0, 40.0  #: N; where k is 1 the first takes off as much as is wanted
TABLE = np.array([0.5, 0.0, 0.32])  #: a point of the table's edge, which runs along y
LOW = np.array([0.0, 0.0, -0.0424264])  #: a point of the bar's edge, which runs along x, in the bar
INTO = np.array([0.6, 0.0, -0.8])  #: the normal of both edges, into the table
VARY = {
    "model_error.object_mass": "uniform(0.9, 1.1)",
    "model_error.arm_mass": "uniform(0.9, 1.1)",
}


class Passes(NamedTuple):
    """What is gauged after the passes of all rows.

    Attributes:
        uneven: (B,) rms of depth − 1. depth: (B, 20) between `EDGES`, 1: as wanted; a contact that
            is lost wears nothing. off: (B,) rms distance of the bar from its path (m).
    """

    uneven: Array
    depth: Array
    off: Array


def softness(y: Array) -> Array:
    """k at places y (m) along the edge; the softest is 2.4 times as soft as the hardest."""
    return np.asarray(np.exp(0.4 * np.sin(63.0 * y + 1.0) + 0.2 * np.sin(140.0 * y)))


def best_forces(y: Array) -> Array:
    """Forces (N) that wear evenly: what a learner should find."""
    return np.asarray(MEAN / softness(y))


def make_env(rows: int, seconds: float = 1.4, threads: int | None = None) -> ContactVectorEnv:
    """Rows of `panda_edge`; the bar passes along the table's edge in so many seconds.

    On its way it turns and slides along its own edge. Masses are not what the controller believes,
    and differ from one pass to the next.
    """
    signal = f"{{type: minimum_jerk, start: {BEFORE} s, duration: {seconds} s, value: %s}}"
    ways = (("linear", [0, 1, 0], f"{LENGTH} m"), ("linear", [0.69282, 0.5, 0.519615], "-10 mm"),
            ("angular", [0.6, 0, -0.8], "10 deg"))  # fmt: skip
    motion = ", ".join(
        f"{{kind: {kind}, direction: {line}, signals: [{signal % value}]}}"
        for kind, line, value in ways
    )
    place = f"xyz: [0.4745, {-LENGTH / 2}, 0.3539]"
    return osc.make_vector_env(
        "panda_edge", rows, vary=VARY, rate=100.0, most_force=MOST, episodes=64, threads=threads,
        overrides=(
            f"motion=[{motion}]",
            f"object.pose={{{place}, rpy: [-20.556 deg, -31.306 deg, 35.818 deg]}}",
            f"force.edge=[{{type: constant, value: {MEAN} N}}]",
            f"duration={BEFORE + seconds + AFTER} s",
        ),
    )  # fmt: skip


def polish(env: ContactVectorEnv, policies: Array, seed: int) -> Passes:
    """One pass of every row: a policy presses by the place that it observes; motion is as asked.

    Args:
        policies: (B, m) forces (N) at m places, evenly spread over the pass, linear in between.
        seed: of the masses.
    """
    observed, _ = env.reset(seed=seed)
    now, then = ([env.names.index(f"{whose} {axis}") for axis in ("x", "y", "z", "rx", "ry", "rz")]
                 for whose in ("set point", "scenario"))  # fmt: skip
    action = np.zeros((env.num_envs, 7))
    knots = np.linspace(EDGES[0], EDGES[-1], policies.shape[1])
    start, place, over = env.fleet.objects()[0].copy(), touch(env)[0], np.zeros(env.num_envs, bool)
    places, wears, off = [place], [np.zeros(env.num_envs)], []
    while not over.all():
        way = observed[:, then] - observed[:, now]
        goal = place + way[:, 1]
        force = [np.interp(y, knots, policy) for y, policy in zip(goal, policies, strict=True)]
        action[:, :6] = way / env.move
        action[:, 6] = 2.0 * np.array(force) / MOST - 1.0
        observed, _, ended, truncated, _ = env.step(action)
        over |= ended | truncated
        y, pressed = touch(env)
        place = np.where(over, place, np.maximum(place, y))
        places.append(place)
        wears.append(np.where(over, 0.0, softness(y) * pressed))
        error = observed[:, now[:3]] - (env.fleet.objects()[0] - start)
        off.append(
            np.where(over, np.nan, np.linalg.norm(error - np.outer(error @ INTO, INTO), axis=1))
        )
    at, wear = np.array(places), np.array(wears)
    taken = np.cumsum(0.5 * (wear[1:] + wear[:-1]) * np.diff(at, axis=0), axis=0)
    depths = [np.diff(np.interp(EDGES, at[1:, i], taken[:, i])) for i in range(env.num_envs)]
    depth = np.array(depths) / (np.diff(EDGES) * MEAN)
    uneven = np.sqrt(np.mean((depth - 1.0) ** 2, axis=1))
    return Passes(uneven, depth, np.sqrt(np.nanmean(np.square(off), axis=0)))


def touch(env: ContactVectorEnv) -> tuple[Array, Array]:
    """(B,) where the bar's edge meets the table's (y, m), and the true normal force there (N)."""
    p, R = env.fleet.objects()
    u = R[:, :, 0]
    off = p + R @ LOW - TABLE
    s = -(off[:, 0] * u[:, 0] + off[:, 2] * u[:, 2]) / (u[:, 0] ** 2 + u[:, 2] ** 2)
    force = env.fleet._plants.bind("cfrc_ext")[:, env.fleet._object, 3:]
    return off[:, 1] + s * u[:, 1], np.maximum(-(force @ INTO), 0.0)
