"""Figures of a run in a second process: the same files, and no figure lost with the process."""

import os
import signal

from complaints import recording_error
from pytest import fixture
from samples import names_in, parametrize

import osc_contact as osc
from osc_contact.lab.reports.report import write_report
from osc_contact.lab.visual.run_figures import RECORDING, SHARES, FigureProcess, draw_figures

FIGURES = {
    f"{name}.{kind}"
    for name in ("contact_forces", "power", "tracking", "torques")
    for kind in ("png", "svg")
}


@fixture(scope="module")
def scenario():
    return osc.load_scenario("two_contact_rod", ["duration=1.05"])


@fixture(scope="module")
def recording(scenario):
    return osc.run(scenario)


def test_a_second_process_draws_the_same_figures(recording, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        recording.save(folder / RECORDING)
    with FigureProcess() as figures:
        figures.begin(there)
        draw_figures(recording, here)
        assert figures.finish()
    assert names_in(here) == names_in(there) >= FIGURES
    for name in FIGURES:
        if name.endswith(".png"):
            assert (here / name).read_bytes() == (there / name).read_bytes()


def test_figures_are_drawn_here_where_the_second_process_ends_early(recording, scenario, tmp_path):
    with FigureProcess() as figures:
        os.kill(figures._process.pid, signal.SIGKILL)
        figures._process.wait()
        write_report(recording, scenario, tmp_path, figures)
    assert names_in(tmp_path) >= FIGURES | {"scene.html", "metrics.json"}


@parametrize("figure", [share[-1] for share in SHARES])
def test_a_figure_that_cannot_be_written_is_noticed(figure, recording, tmp_path):
    recording.save(tmp_path / RECORDING)
    (tmp_path / f"{figure}.svg").mkdir()
    with FigureProcess() as figures:
        figures.begin(tmp_path)
        assert not figures.finish()


def test_a_process_without_a_recording_draws_nothing_and_says_so(tmp_path):
    with FigureProcess() as figures:
        figures.begin(tmp_path)
        assert not figures.finish()
    assert names_in(tmp_path) == set()
    with recording_error("recording.npz"):
        osc.Recording.load(tmp_path / RECORDING)
    with FigureProcess() as unused:  # a run that failed: nothing is left behind
        pass
    assert unused._process.returncode is not None
