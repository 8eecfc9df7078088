"""Sweeps on a dask cluster: the same table as here, whatever becomes of its workers."""

import multiprocessing
import os
import signal
from contextlib import contextmanager
from multiprocessing import forkserver

from command_line import done
from complaints import invalid_input
from pyarrow import parquet
from pytest import mark
from samples import module_fixture
from test_sweeps import MASSES, SHORT

import osc_contact as osc
from osc_contact.lab.sweeps.study import SweepStudy
from osc_contact.lab.sweeps.sweep import TABLE, run_study
from osc_contact.lab.sweeps.tune import tune


class Deadly(SweepStudy):
    """Its last row ends the process that makes it."""

    def sample(self, number):
        if number == self.rows - 1 and multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().sample(number)


@contextmanager
def cluster_of(workers):
    """A client of dask's, which only the process that runs these tests imports.

    Workers are forked from a process that has imported what they need.
    """
    import dask
    from distributed import Client, LocalCluster

    forkserver.set_forkserver_preload(["osc_contact.lab.sweeps.workers", "distributed", "mujoco"])
    forkserver.ensure_running()
    forked = {"distributed.worker.multiprocessing-method": "forkserver"}
    how = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with (
        dask.config.set(forked),
        LocalCluster(n_workers=workers, **how) as made,
        Client(made) as client,
    ):
        yield client


@module_fixture
def client():
    with cluster_of(2) as client:
        yield client


@module_fixture
def alone():
    """The table of one process."""
    return osc.sweep("two_contact_rod", [MASSES], 6, overrides=SHORT, workers=1)


def test_a_killed_worker_loses_nothing_and_the_table_is_that_of_one_process(client, alone):
    killed = []

    def kill_one(done, total):
        if not killed:
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)

    how = {"overrides": SHORT, "scheduler": client, "progress": kill_one}
    table = osc.sweep("two_contact_rod", [MASSES], 6, **how)
    assert killed and table.equals(alone)


def test_by_command_and_address_too(client, alone, tmp_path):
    address = client.scheduler.address
    line = f"sweep two_contact_rod --samples 6 --scheduler {address} --out {tmp_path}"
    done(line, "--vary", MASSES, *(word for one in SHORT for word in ("--set", one)))
    assert parquet.read_table(tmp_path / TABLE).equals(alone)


@mark.parametrize("where", ["processes", "cluster"])
def test_a_run_that_ends_its_worker_twice_is_a_row_with_the_error(where, client):
    # one death may be that of a neighbour: dask charges all that a worker was given
    client.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 1))
    tilt = "model_error.face_tilt=uniform(0 deg, 2 deg)"  # no doubts before a run, as of masses
    study = Deadly.of("two_contact_rod", [tilt], 5, seed=1, overrides=SHORT)
    how = {"workers": 2} if where == "processes" else {"scheduler": client}
    rows = run_study(study, **how).to_pylist()
    expected = run_study(study, workers=1).to_pylist()
    died = rows.pop()
    assert died["row"] == 4 and died["word"] == "CRASHED" and died["failed"]
    assert "twice" in died["why"] and expected.pop()["word"] == "OK"
    assert rows == expected


def test_tuning_finds_the_same_on_a_cluster(client):
    how = {"overrides": SHORT, "trials": 3, "over": [MASSES], "samples": 2}
    on_cluster, here = (
        tune("two_contact_rod", **how, **where) for where in ({"scheduler": client}, {"workers": 1})
    )
    assert on_cluster == here


def test_what_cannot_be_used_is_refused_with_what_to_do(client, monkeypatch):
    monkeypatch.setattr("osc_contact.lab.sweeps.cluster._PATIENCE_S", 0.5)

    def refused(scheduler, complaint, **how):
        with invalid_input(complaint):
            osc.sweep("two_contact_rod", [MASSES], 2, overrides=SHORT, scheduler=scheduler, **how)

    refused(client, "a cluster has its own", workers=2)
    refused("tcp://127.0.0.1:1", "cluster of tcp://127.0.0.1:1 cannot be used")
    refused("nonsense://x", "cluster of nonsense://x cannot be used")
    with cluster_of(0) as idle:
        refused(idle, "dask worker ADDRESS")
    monkeypatch.setattr("osc_contact.lab.sweeps.cluster.__version__", "0.0.1")
    refused(client, "this is osc_contact 0.0.1")
