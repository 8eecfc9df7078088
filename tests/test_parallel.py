"""Jobs of `osc-contact reproduce` on several cores: results, order, errors, ends."""

import os
import signal
import time
from functools import partial
from multiprocessing import active_children

import numpy as np
from pytest import raises
from samples import parametrize

from osc_contact.errors import OscContactError, PlantError
from osc_contact.files import whole_file
from paper.parallel import Job, done

SEVERAL = (1, 2)  # cores


def count(number, tell, needed):
    """A number, and those that it needs."""
    tell("counts")
    return (number, sorted(needed.values()))


def threads(tell, needed):
    return (os.environ.get("OPENBLAS_NUM_THREADS"), os.getpid())


def fail(tell, needed):
    error = PlantError("it fell")
    error.recording = np.zeros(3)
    raise error


def die(tell, needed):
    os.kill(os.getpid(), signal.SIGKILL)


def write_slowly(file, tell, needed):
    """Begin a file and need a minute for it."""
    with whole_file(file) as unfinished:
        unfinished.write_text("half")
        time.sleep(60.0)


@parametrize("cores", SEVERAL)
def test_results_are_those_of_one_core_and_go_to_the_jobs_that_need_them(cores):
    jobs = [Job(name, partial(count, k)) for k, name in enumerate("abc")]
    jobs.insert(2, Job("both", partial(count, 9), ("a", "b")))
    found = dict(done(jobs, first=["c"], cores=cores))
    assert found == {"a": (0, []), "b": (1, []), "c": (2, []), "both": (9, [(0, []), (1, [])])}
    assert not active_children()


def test_each_process_has_one_thread_and_the_environment_is_as_before(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    found = dict(done([Job("a", threads), Job("b", threads)], cores=2))
    assert {variable for variable, _ in found.values()} == {"1"}
    assert os.getpid() not in {process for _, process in found.values()}
    assert "OPENBLAS_NUM_THREADS" not in os.environ


@parametrize("cores", SEVERAL)
def test_an_error_has_the_name_of_its_job(cores):
    with raises(PlantError, match="it fell") as caught:
        list(done([Job("fine", partial(count, 1)), Job("fig9: stumbles", fail)], cores=cores))
    assert caught.value.__notes__ == ["in fig9: stumbles"]
    assert not active_children()


def test_a_process_that_is_killed_is_an_error_with_what_was_under_way():
    with raises(OscContactError, match=r"killed.*fig9: dies"):
        list(done([Job("fig9: dies", die), Job("other", partial(count, 1))], cores=2))
    assert not active_children()


def test_ctrl_c_ends_all_processes_at_once_and_leaves_no_half_written_file(tmp_path):
    jobs = [Job("slow", partial(write_slowly, tmp_path / "slow")), Job("quick", partial(count, 1))]
    running = done(jobs, cores=2)
    assert next(running) == ("quick", (1, []))
    while not list(tmp_path.iterdir()):
        time.sleep(0.05)
    begun = time.monotonic()
    with raises(KeyboardInterrupt):
        running.throw(KeyboardInterrupt())
    assert not active_children() and time.monotonic() - begun < 30.0
    assert list(tmp_path.iterdir()) == []
