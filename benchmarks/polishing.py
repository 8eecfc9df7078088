"""The task: wear an edge of hidden hardness evenly, in one pass of a bar along it.

A pass takes off dh = k(y) f |dy| at a place y (Preston's law): k is how soft the edge is there, f
is the true contact force. No sensor reads k and no force law can know it. The depth is gauged after
the pass, and a learner receives one number: how uneven it is.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pinocchio as pin
import typer
from matplotlib.figure import Figure
from rich.console import Console

import osc_contact as osc
from osc_contact.lab.sweeps.vector_env import ContactVectorEnv
from osc_contact.lab.visual.plots import save, style
from osc_contact.spatial import Array
from paper.study import table_of, with_object

LENGTH = 0.1
BEFORE = 0.2
AFTER = 0.2  #: m, of the pass; s, in which the bar only presses
EDGES = np.linspace(-0.04, 0.04, 21)  #: m; between them the depth is gauged
MEAN = 15.0
MOST = 40.0  #: N; where k is 1 the first takes off the desired depth
TABLE = np.array([0.5, 0.0, 0.32])  #: a point of the table's edge, which runs along y
LOW = np.array([0.0, 0.0, -0.0424264])  #: a point of the bar's edge, which runs along x, in the bar
INTO = np.array([0.6, 0.0, -0.8])  #: the normal of both edges, into the table
ALONG = np.eye(3) - np.outer(INTO, INTO)  #: what is left of a vector along the faces
VARY = {"model_error.object_mass": "uniform(0.9, 1.1)", "model_error.arm_mass": "uniform(0.9, 1.1)"}


class Passes(NamedTuple):
    """Results of the passes of B rows.

    Attributes:
        uneven: (B,) rms of depth − 1.
        depth: (B, 20) depth that was removed between `EDGES`, over the desired one; a contact that
            is lost removes nothing.
        off: (B,) rms distance of the bar from its path (m).
    """

    uneven: Array
    depth: Array
    off: Array


def softness(y: Array) -> Array:
    """k at places y (m) along the edge; the softest is 2.4 times as soft as the hardest."""
    return np.exp(0.4 * np.sin(63.0 * y + 1.0) + 0.2 * np.sin(140.0 * y))


def best_forces(y: Array) -> Array:
    """Forces (N) that wear evenly, the optimum of a learner."""
    return MEAN / softness(y)


def make_env(rows: int, seconds: float) -> ContactVectorEnv:
    """Rows of `panda_edge`; the bar passes along the table's edge in so many seconds.

    On its way it turns and slides along its own edge. Masses differ from the controller's model,
    and differ from one pass to the next.
    """
    signal = f"{{type: minimum_jerk, start: {BEFORE} s, duration: {seconds} s, value: %s}}"
    ways = (
        ("linear", [0, 1, 0], f"{LENGTH} m"),
        ("linear", [0.69282, 0.5, 0.519615], "-10 mm"),
        ("angular", [0.6, 0, -0.8], "10 deg"),
    )
    motion = ", ".join(
        f"{{kind: {kind}, direction: {line}, signals: [{signal % value}]}}"
        for kind, line, value in ways
    )
    place = f"xyz: [0.4745, {-LENGTH / 2}, 0.3539]"
    return osc.make_vector_env(
        "panda_edge",
        rows,
        vary=VARY,
        rate=100.0,
        most_force=MOST,
        episodes=64,
        overrides=(
            f"motion=[{motion}]",
            f"object.pose={{{place}, rpy: [-20.556 deg, -31.306 deg, 35.818 deg]}}",
            f"force.edge=[{{type: constant, value: {MEAN} N}}]",
            "gains.force.rise=0 s",  # at once: errors of masses lift a bar that hardly presses
            f"duration={BEFORE + seconds + AFTER} s",
        ),
    )


def polish(env: ContactVectorEnv, policies: Array, seed: int) -> Passes:
    """One pass of every row: a policy presses by the place that it observes; motion as commanded.

    Args:
        policies: (B, m) forces (N) at m places, evenly spread over the pass, linear in between.
        seed: seed of the masses.
    """
    observed, _ = env.reset(seed=seed)
    first, then = (env.names.index(f"{whose} x") for whose in ("set point", "scenario"))
    knots = np.linspace(EDGES[0], EDGES[-1], policies.shape[1])
    start = env.fleet.objects()[0].copy()
    place = touch(env)[0]
    over = np.zeros(env.num_envs, bool)
    places = [place]
    wears = [np.zeros(env.num_envs)]
    off = []
    while not over.all():
        way = observed[:, then : then + 6] - observed[:, first : first + 6]
        force = [
            np.interp(y, knots, row) for y, row in zip(place + way[:, 1], policies, strict=True)
        ]
        press = 2.0 * np.array(force) / MOST - 1.0
        observed, _, ended, truncated, _ = env.step(np.column_stack((way / env.move, press)))
        over |= ended | truncated
        y, pressed = touch(env)
        place = np.where(over, place, np.maximum(place, y))
        places.append(place)
        wears.append(np.where(over, 0.0, softness(y) * pressed))
        error = observed[:, first : first + 3] - (env.fleet.objects()[0] - start)
        off.append(np.where(over, np.nan, np.linalg.norm(error @ ALONG, axis=1)))
    at = np.array(places)
    wear = np.array(wears)
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
    force = env.fleet._plants.bind("cfrc_ext")[:, env.fleet._plant.object_body, 3:]
    return (off[:, 1] + s * u[:, 1], np.maximum(-(force @ INTO), 0.0))


# --- The same task with a law of the Jacobian's transpose and a selection matrix ---


class SpringGains(NamedTuple):
    """Gains of the law.

    Attributes:
        stiffness, damping: K, D along (N/m, N s/m) and about (N m, N m s) the axes.
        integral: k_I (1/s).
        contact: d (N s/m).
        posture: stiffness and damping of τ_0 (N m, N m s).
    """

    stiffness: tuple[float, float] = (2000.0, 50.0)
    damping: tuple[float, float] = (80.0, 2.0)
    integral: float = 10.0
    contact: float = 100.0
    posture: tuple[float, float] = (10.0, 3.0)


SOFT = SpringGains()  #: about as stiff as ours, which is 900 /s² times the mass that the bar feels
#: the best of 42 sets (stiffness, damping, integral, contact), found under friction up to 0.1
STIFF = SpringGains((16000.0, 320.0), (250.0, 5.4), 30.0, 600.0)


class SelectionRows:
    """Takes the place of the controllers of a vector environment."""

    def __init__(self, env: ContactVectorEnv, gains: SpringGains) -> None:
        """Rows of an environment, whose `fleet.control` it becomes."""
        self._fleet = env.fleet
        self._gains = gains
        self._arms = [(one.chain, *with_object(one.chain)) for one in env.fleet.control._settings]
        self._rest = env.fleet.measure()[0]
        self._sum, self.alpha_meas, self.normal_speed = np.zeros((3, env.num_envs, 1))
        self.state = np.full(env.num_envs, int(osc.SafetyState.RUN))
        env.fleet.control = self  # type: ignore[assignment]

    def replace(self, row: int, controller: Any) -> None:
        """A row begins anew, with the model of this controller."""
        chain = controller.settings.chain
        self._arms[row] = (chain, *with_object(chain))
        self._sum[row] = 0.0

    def tick(
        self,
        q: Array,
        v: Array,
        wrenches: Array,
        X_WD: Array,
        *,
        V_D: Array,
        alpha_d: Array,
        **_: Any,
    ) -> Array:
        """Torques (B, n_a); arguments as of `BatchController.tick`."""
        k = self._gains
        p, R = self._fleet.objects()
        looks = [self._look(i, q[i], wrenches[i, 0]) for i in range(len(q))]
        J, tau, alpha = (np.array(part) for part in zip(*looks, strict=True))
        self.alpha_meas[:, 0] = alpha
        turns = [pin.log3(X[:3, :3] @ now.T) for X, now in zip(X_WD, R, strict=True)]
        e = np.hstack((X_WD[:, :3, 3] - p, turns))
        V = np.einsum("bij,bj->bi", J, v)
        force = np.repeat(k.stiffness, 3) * e + np.repeat(k.damping, 3) * (V_D - V)
        self.normal_speed[:, 0] = V[:, :3] @ INTO
        self._sum += self._fleet.dt * (alpha_d - self.alpha_meas)
        push = alpha_d + k.integral * self._sum - k.contact * self.normal_speed
        force[:, :3] = force[:, :3] @ ALONG + push * INTO
        idle = k.posture[0] * (self._rest - q) - k.posture[1] * v
        seen = np.linalg.solve(J @ J.transpose(0, 2, 1), J @ idle[..., None])
        force -= seen[..., 0]  # τ_0 = (1 − JᵀJᵀ⁺) idle
        return tau + np.einsum("bij,bi->bj", J, force) + idle

    def _look(self, row: int, q: Array, wrench: Array) -> tuple[Array, Array, float]:
        """J at the operational point, torques that carry arm and bar, the force that is read."""
        chain, model, at = self._arms[row]
        data = model.createData()
        weight = np.array(pin.computeGeneralizedGravity(model, data, q))
        J = pin.computeFrameJacobian(model, data, q, at, pin.LOCAL_WORLD_ALIGNED)
        sensor = pin.updateFramePlacement(model, data, chain.sensors[0])
        assert chain.payload is not None
        beyond = chain.payload.inertia.mass
        beyond += sum(link.inertia.mass for link in chain.outboard[0])
        read = sensor.rotation @ wrench[:3] + beyond * model.gravity.linear
        return (J, weight, float(INTO @ read))


# --- An evolution strategy in plain NumPy: its only input is the value of each policy ---


_BEST = 0.25  #: of a generation, from which the next is drawn
_KEPT = 0.3  #: of the spread, at each generation


def learn(
    cost: Callable[[Array, int], Array],
    start: Array,
    spread: float,
    rows: int,
    generations: int,
    seed: int,
) -> tuple[Array, Array]:
    """The cross-entropy method: draw policies, keep the best quarter, draw around them.

    Args:
        cost: function that returns the costs of policies (rows, m) in episodes of a seed.
        start: (m,) the first mean.
        spread: the first standard deviation of each number.
        rows: policies of a generation; the first is the mean itself.
        generations: number of generations.
        seed: seed of the draws and of the episodes.

    Returns:
        (m,) the last mean; (generations,) what each mean cost.
    """
    draws = np.random.default_rng(seed)
    mean = start.copy()
    deviation = np.full(len(start), spread)
    curve = []
    for _ in range(generations):
        policies = mean + deviation * draws.standard_normal((rows, len(start)))
        policies[0] = mean
        costs = cost(policies, int(draws.integers(2**31)))
        curve.append(costs[0])
        best = policies[np.argsort(costs)[: max(2, round(_BEST * rows))]]
        mean = best.mean(axis=0)
        deviation = _KEPT * deviation + (1.0 - _KEPT) * best.std(axis=0)
    return (mean, np.array(curve))


# --- Learn to polish, above our law and above another: `python -m benchmarks.polishing` ---


KNOTS = np.linspace(EDGES[0], EDGES[-1], 12)  #: m, where a policy gives its forces
SLOW = 1.4
FAST = 0.7  #: s, of a pass: while learning; and twice as fast, not seen while learning
UNSEEN = 10**6
JUDGED = 16  #: seed of passes that no learner has seen, and how many
LAWS: dict[str, SpringGains | None] = {"ours": None, "Jᵀ, soft": SOFT, "Jᵀ, stiff": STIFF}


def _env(law: str, rows: int, seconds: float) -> ContactVectorEnv:
    env = make_env(rows, seconds)
    gains = LAWS[law]
    if gains is not None:
        SelectionRows(env, gains)
    return env


def teach(law: str, seed: int, rows: int = 40, generations: int = 12) -> tuple[Array, Array]:
    """Policy (12,) that is learned above a law, and its unevenness at each generation."""
    env = _env(law, rows, SLOW)
    return learn(
        lambda policies, episodes: polish(env, policies, episodes).uneven,
        np.full(len(KNOTS), MEAN),
        4.0,
        rows,
        generations,
        seed,
    )


def judge(law: str, policy: Array, seconds: float) -> Passes:
    """Passes with masses that were not met while learning."""
    return polish(_env(law, JUDGED, seconds), np.tile(policy, (JUDGED, 1)), UNSEEN)


def main(figure: Annotated[Path | None, typer.Option(help="also draw it (PNG)")] = None) -> None:
    """Learn (minutes), judge, print, draw."""
    learned = {one: teach(*one) for one in (("ours", 0), ("ours", 1), ("Jᵀ, stiff", 0))}
    policies = {("ours", "15 N everywhere"): np.full(len(KNOTS), MEAN)}
    policies |= {(law, f"learned, seed {seed}"): found[0] for (law, seed), found in learned.items()}
    policies |= {(law, "best, known hardness"): best_forces(KNOTS) for law in LAWS}
    heads = "law; policy; slow: uneven; off the path; fast: uneven; off the path"
    title = f"{JUDGED} passes with masses not met while learning"
    lines = []
    for (law, name), policy in policies.items():
        passes = (judge(law, policy, seconds) for seconds in (SLOW, FAST))
        cells = (f"{x.uneven.mean():.1%}; {1e3 * x.off.mean():.2f} mm" for x in passes)
        lines.append("; ".join((law, name, *cells)))
    Console().print(table_of(title, heads, lines))
    if figure is not None:
        draw(learned, figure)


def draw(learned: dict[tuple[str, int], tuple[Array, Array]], path: Path) -> None:
    """Learning curves; forces found beside the best ones."""
    with style():
        figure = Figure(figsize=(6.7, 3.2))
        curves, forces = figure.subplots(1, 2)
        colours = dict(zip(LAWS, ("#0072B2", "#E69F00", "#D55E00"), strict=True))
        for (law, seed), (policy, curve) in learned.items():
            named = "_" if seed else ""  # not in a legend
            curves.plot(100 * curve, color=colours[law], label=named + law)
            if law == "ours":
                forces.plot(1e3 * KNOTS, policy, color=colours[law], label=f"{named}learned")
        generations = {"xlabel": "generation", "ylabel": "%", "yscale": "log"}
        curves.set(title="unevenness of the mean policy", **generations)
        forces.plot(1e3 * KNOTS, best_forces(KNOTS), "k--", lw=1.2, label="best, known hardness")
        forces.set(title="force by place", xlabel="place (mm)", ylabel="N", ylim=(0, None))
        for ax in (curves, forces):
            ax.legend()
        save(figure, path.with_suffix(""), (".png",))


if __name__ == "__main__":
    typer.run(main)
