"""`make peers`: the action term for mjlab, on the installed mjlab and on the processor.

Not collected by `make test`, whose environment has neither mjlab nor torch.
"""

import re
from pathlib import Path
from time import perf_counter

import numpy as np
import pinocchio as pin
import torch
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.scene import SceneCfg
from mjlab.sim import MujocoCfg, SimulationCfg
from numpy.testing import assert_allclose
from pytest import fixture, raises

import osc_contact as osc
from osc_contact.learn import ContactActionCfg, begin

MOST = 30.0
MOVE = (2e-3, 1e-2)


@fixture(scope="module")
def parts():
    return begin(osc.build_rig(osc.load_scenario("panda_edge")))


def environment(parts, count, **changes):
    entity, controller = parts
    action = {"controller": controller, "most_force": MOST, "move": MOVE, "threads": 2, **changes}
    cfg = ManagerBasedRlEnvCfg(
        decimation=20,
        scene=SceneCfg(num_envs=count, entities={"panda": entity}),
        actions={"contact": ContactActionCfg(entity_name="panda", **action)},
        sim=SimulationCfg(
            mujoco=MujocoCfg(timestep=1e-3, cone="elliptic", tolerance=1e-10), nconmax=8, njmax=40
        ),
    )
    env = ManagerBasedRlEnv(cfg, device="cpu")
    env.reset()
    return (env, env.action_manager.get_term("contact"))


def poses(env, parts):
    """Poses of the objects, from mjlab's own joints."""
    _, controller = parts
    q = env.scene["panda"].data.joint_pos.numpy().astype(float)
    return [controller.chain.state(one).X_WO for one in q]


def test_actions_move_set_points_and_press(parts):
    env, term = environment(parts, 3)
    start = poses(env, parts)
    action = torch.zeros(3, 7)
    action[:, 6] = torch.tensor([-0.2, 0.0, 0.4])
    along_the_edge = (torch.zeros(3), torch.tensor([0.0, 1.0, -0.5]), torch.zeros(3))
    for steps, move in zip((15, 10, 15), along_the_edge, strict=True):
        action[:, 1] = move
        for _ in range(steps):
            env.step(action)
    assert not term.stopped.any()
    commanded = 0.5 * MOST * (1.0 + action[:, 6].numpy())
    assert_allclose(term.force[:, 0].numpy(), commanded, rtol=0.02)
    ways = np.array([0.0, 10.0, -5.0]) * MOVE[0]
    for way, x, X in zip(ways, poses(env, parts), start, strict=True):
        assert abs(x.translation[1] - X.translation[1] - way) < 3e-4
        assert np.abs(pin.log3(x.rotation @ X.rotation.T)).max() < 2e-3


def test_a_tick_is_that_of_one_controller(parts):
    env, term = environment(parts, 2)
    own = parts[1]
    first = osc.BatchController([own])
    seen = []
    tick = term.batch.tick
    term.batch.tick = lambda *args, **more: (
        seen.append((args, more, tick(*args, **more))) or seen[-1][2]
    )
    action = torch.rand(2, 7, generator=torch.Generator().manual_seed(1)) - 0.5
    env.step(action)
    assert len(seen) == 20
    for args, more, tau in seen:
        row = {name: value[1:] for name, value in more.items()}
        np.testing.assert_array_equal(first.tick(*(x[1:] for x in args), **row)[0], tau[1])
    sent = env.scene["panda"].data.joint_effort_target.numpy()
    assert_allclose(sent, seen[-1][2], rtol=1e-6)


def test_an_environment_that_is_reset_begins_where_its_object_is(parts):
    env, term = environment(parts, 2)
    action = torch.zeros(2, 7)
    action[:, 1] = 1.0
    for _ in range(12):
        env.step(action)
    env.reset(env_ids=torch.tensor([1]))
    env.step(torch.zeros(2, 7))
    start = poses(environment(parts, 1)[0], parts)[0]
    place = [X[1, 3] for X in term._target]
    assert abs(place[1] - start.translation[1]) < 1e-4
    assert place[0] - place[1] > 0.02
    for _ in range(12):
        env.step(torch.zeros(2, 7))
    assert not term.stopped.any()
    assert_allclose(term.force.numpy(), MOST / 2, rtol=0.1)


def test_periods_that_do_not_fit_are_refused(parts):
    entity, _ = parts
    rig = osc.build_rig(osc.load_scenario("panda_edge", ["control.rate=125 Hz"]))
    with raises(osc.InvalidInputError, match="multiple of the one before"):
        environment((entity, rig.controller()), 1)


def test_programs_of_the_page_on_learning():
    page = (Path(__file__).parents[1] / "docs" / "learning.md").read_text()
    programs = re.findall(r"^```python\n(.*?)^```$\n+```text\n(.*?)^```$", page, re.M | re.S)
    (mine,) = [pair for pair in programs if "osc_contact.learn" in pair[0]]
    lines = []
    exec(mine[0], {"print": lambda *words: lines.append(" ".join(map(str, words)))})
    assert "\n".join(lines) == mine[1].strip()


def test_512_environments(parts):
    """Prints its time, and that of the law of 4,096 environments in one call."""
    env, term = environment(parts, 512)
    times = []
    seen = []
    tick = term.batch.tick

    def timed(*args, **more):
        begin = perf_counter()
        tau = tick(*args, **more)
        times.append(perf_counter() - begin)
        seen[:] = (args, more)
        return tau

    term.batch.tick = timed
    env.step(torch.zeros(512, 7))
    del times[:]
    begin = perf_counter()
    for _ in range(2):
        env.step(torch.zeros(512, 7))
    took = (perf_counter() - begin) / 2
    assert not term.stopped.any()
    print(
        f"\n512 environments, one action (20 ticks, 20 steps of the physics): {took:.2f} s, "
        f"of which the law {20 * np.median(times):.3f} s"
    )
    batch = osc.BatchController([parts[1]] * 4096, threads=2)
    args, more = ([np.repeat(x, 8, axis=0) for x in given] for given in (seen[0], seen[1].values()))
    times = []
    for _ in range(20):
        begin = perf_counter()
        batch.tick(*args, **dict(zip(seen[1], more, strict=True)))
        times.append(perf_counter() - begin)
    assert (batch.status == osc.Status.OK).all()
    print(f"the law of 4096 environments in one call, two threads: {1e3 * np.median(times):.1f} ms")
