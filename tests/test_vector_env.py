"""Vector environments: gymnasium's own checks, its autoreset, and rows that are single runs."""

import warnings

import gymnasium
import numpy as np
import pinocchio as pin
from complaints import invalid_input
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.testing import assert_array_equal
from rigs import assert_near
from samples import aligned, first, parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.lab.sweeps.fleet import Fleet, Start
from osc_contact.lab.sweeps.vector_env import make_vector_env

SHORT = ("duration=0.1 s",)  # five actions
MASS = {"model_error.object_mass": "uniform(0.8, 1.2)"}


class One(gymnasium.Env):
    """A row as a single environment, which its caller resets."""

    def __init__(self, **how):
        self.rows = make_vector_env("panda_edge", 1, threads=1, **how)
        self.observation_space = self.rows.single_observation_space
        self.action_space = self.rows.single_action_space
        self.metadata = {"render_modes": []}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, infos = self.rows.reset(seed=seed)
        return (observation[0], {"sample": int(infos["sample"][0])})

    def step(self, action):
        observation, *ended, infos = self.rows.step(action[None])
        return (observation[0], *(x.item() for x in ended), {"sample": int(infos["sample"][0])})


def part(env, observation, name):
    return observation[..., [i for i, n in enumerate(env.names) if n.startswith(name)]]


@parametrize("vary", [{}, MASS])
def test_gymnasium_finds_nothing_wrong(vary):
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        check_env(One(vary=vary, overrides=SHORT, episodes=3), skip_render_check=True)
    warned = [str(one.message) for one in warned]
    assert [one for one in warned if "infinity" not in one and "spec" not in one] == []


def test_rows_are_reset_as_gymnasium_resets_environments():
    """Two rows: random actions; the second runs away, which ends it earlier."""
    how = {"overrides": ("duration=0.3 s",), "move": (0.02, 0.01)}
    ours = make_vector_env("panda_edge", 2, threads=1, **how)
    theirs = SyncVectorEnv([lambda: One(**how)] * 2, autoreset_mode=AutoresetMode.NEXT_STEP)
    assert ours.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    for env in (ours, theirs):
        env.action_space.seed(5)
    assert_array_equal(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    ends = np.zeros((2, 2), dtype=int)
    for _ in range(35):
        actions = 0.05 * ours.action_space.sample()
        actions[1, :2] = -1.0
        (*one, _), (*other, _) = (env.step(actions) for env in (ours, theirs))
        for x, y in aligned(one, other):
            assert_array_equal(x, y)
        ends += one[2:]
    assert ends[0, 1] > 2 and ends[1, 0] >= 2 and ends[0, 0] == 0  # ran away; ran out of time


@parametrize("name", first(["two_contact_rod", "panda_edge", "hinge_ball_rod"], 1))
def test_rows_of_a_fleet_are_single_runs(name):
    """Each row with its own masses, two of them alike, on two threads."""
    scenarios = [
        osc.load_scenario(name, [f"model_error.object_mass={m}", "duration=0.2 s"])
        for m in (1.0, 1.1, 1.2)
    ]
    recordings = [osc.run(one) for one in scenarios]
    starts = [Start.of(rig_of(one)) for one in scenarios]
    rows = [0, 1, 2, 1]
    fleet = Fleet([starts[i] for i in rows], threads=2)
    plans = [start.rig.references.over(np.arange(200) * fleet.dt) for start in starts]
    for k in range(200):
        q, v, _ = fleet.measure()
        X = np.array([pin.XYZQUATToSE3(plans[i].X_WD[k]).homogeneous for i in rows])
        fields = ([getattr(plans[i], f)[k] for i in rows] for f in ("V_D", "A_D", "alpha_d"))
        tau = fleet.tick(X, *map(np.array, fields), np.array([plans[i].squeeze_d for i in rows]))
        for channel, found in {"q": q, "v": v, "tau": tau}.items():
            assert_near(found, [recordings[i][channel][k] for i in rows], atol=1e-9)
    assert not fleet.diverged().any()


def test_actions_move_the_set_point_and_set_the_force():
    """Along the table's edge, which the contact permits: the object follows, the force too."""
    still = ("motion=[]", "force.edge=[{type: constant, value: 10 N}]", "duration=3 s")
    how = {"move": (2e-3, 1e-2), "most_force": 20.0}
    env = make_vector_env("panda_edge", 2, overrides=still, threads=1, **how)
    env.reset(seed=0)
    start = env.fleet.objects()[0].copy()
    action = np.zeros((2, 7))
    action[:, 1] = [1.0, -0.5]  # 2 mm and −1 mm along y, each of 20 times
    action[:, 6] = [0.2, -0.4]  # 12 N, 6 N
    for _ in range(20):
        env.step(action)
    action[:, 1] = 0.0
    for _ in range(60):
        observation = env.step(action)[0]
    moved = env.fleet.objects()[0] - start
    assert_near(moved[:, 1], [0.04, -0.02], atol=2e-4)
    assert_near(part(env, observation, "force 0")[:, 0], [12.0, 6.0], atol=0.05)
    assert_near(part(env, observation, "desired force")[:, 0], [12.0, 6.0], atol=1e-9)
    assert_near(part(env, observation, "set point y")[:, 0], [0.04, -0.02])


def test_contacts_are_active_when_the_scenario_says_so():
    """The right contact is released at 0.1 s, although the action goes on commanding its force."""
    released = ("active.right_end=[[0, 0.1]]", "duration=0.6 s")
    env = make_vector_env("two_contact_rod", 2, overrides=released, threads=1)
    env.reset(seed=0)
    action = np.zeros((2, env.single_action_space.shape[0]))
    for step in range(25):
        observation = env.step(action)[0]
        if step == 3:
            assert (part(env, observation, "force 1") > 1.0).all()
    assert_array_equal(part(env, observation, "force 1"), np.zeros((2, 1)))
    assert (part(env, observation, "force 0") > 1.0).all()


def test_following_the_scenario_is_rewarded_and_leaving_it_is_not():
    env = make_vector_env("panda_edge", 2, overrides=("duration=1.5 s",), threads=1)
    observation, _ = env.reset(seed=0)
    for _ in range(60):
        away = part(env, observation, "scenario")[:, :6] - part(env, observation, "set point")
        action = np.zeros((2, 7))
        action[0, :6] = np.clip(away[0] / env.move, -1, 1)
        commanded = part(env, observation, "scenario force")[:, 0]
        action[:, 6] = 2.0 * commanded / env.most_force - 1.0
        action[1, 6] = -1.0  # hardly presses
        observation, rewards, *_ = env.step(action)
    assert rewards[0] > 0.9 and rewards[1] < 0.0


def test_seeds_draw_the_same_episodes_again_and_others_draw_others():
    """Each row begins with the masses of its episode, which its wrist measures."""
    env = make_vector_env("panda_edge", 6, vary=MASS, overrides=SHORT, episodes=5, threads=1)
    (_, one), (_, two), (seen, other) = (env.reset(seed=s) for s in (7, 7, 8))
    assert list(one["sample"]) == list(two["sample"]) != list(other["sample"])
    assert set(other["sample"]) <= set(range(5))
    alike = (seen[:, None] == seen).all(axis=2)
    assert_array_equal(alike, other["sample"][:, None] == other["sample"])


def test_what_cannot_be_batched_is_refused_with_the_reason():
    for name, how, words in (
        ("workcell", {}, "sensors have errors"),
        ("panda_edge", {"rate": 70.0}, "divides that of control"),
    ):
        with invalid_input(words):
            make_vector_env(name, 2, **how)
    env = make_vector_env("panda_edge", 2, overrides=SHORT, threads=1)
    env.reset()
    with invalid_input("actions: expected"):
        env.step(np.zeros((2, 6)))


def test_a_row_refuses_a_controller_of_another_structure():
    light = Start.of(rig_of("panda_edge")).controller
    batch = osc.BatchController([light] * 2)
    rod = rig_of().controller()
    for row, controller, words in ((0, rod, "one structure"), (2, light, "rows 0")):
        with invalid_input(words):
            batch.replace(row, controller)
