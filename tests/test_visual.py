"""Plots, diagrams and contact pictures, measured."""

from itertools import combinations, pairwise

import numpy as np
from complaints import recording_error
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from matplotlib.transforms import Bbox
from pytest import fixture
from scene_samples import RECORDING, changed, make_recording

from osc_contact import load_scenario
from osc_contact.lab.visual import plots
from paper.diagrams import BLOCKS, CONNECTIONS, GROUPS, LABELS, LOOP, draw_blocks
from paper.figures import reproduce


def test_contact_force_figure():
    left, right, error = plots.contact_forces(RECORDING).axes
    assert [line.get_label() for line in left.lines] == ["desired", "true", "measured"]
    assert [ax.get_title(loc="left") for ax in (left, right)] == ["left end", "right end"]
    widths = [line.get_linewidth() for line in left.lines]
    assert widths[0] > 2 * widths[1] > 3 * widths[2], "seen when equal"
    assert np.allclose(left.lines[1].get_ydata(), RECORDING["alpha_true"][:, 0])
    assert np.allclose(error.lines[1].get_ydata(), -1.0)
    assert "rms 1 N, peak 1 N" in error.lines[1].get_label()
    assert left.get_ylabel().endswith("(N)") and error.get_xlabel() == "time (s)"
    (empty,) = plots.contact_forces(make_recording(contacts=0)).axes
    assert [text.get_text() for text in empty.texts] == ["no contacts"]


def test_force_error_is_scaled_by_what_counts():
    true = RECORDING["alpha_cmd"] + 1e-3
    true[:20] += 7.0  # touching down
    recording = changed(alpha_true=true)
    judged = np.ones((101, 2), dtype=bool)
    judged[:20] = judged[50:55] = False
    *forces, error = plots.contact_forces(recording, judged).axes
    assert "rms 1 mN, peak 1 mN" in error.lines[0].get_label()
    at = error.transScale.transform
    small, large = (at((0.0, y))[1] - at((0.0, 0.0))[1] for y in (1e-3, 7.0))
    assert error.get_ylim()[1] > 7.0, "nothing is cut off"
    assert small > 0.2 * large, "and what is judged is seen beside it"
    shaded = [(p.get_x(), p.get_x() + p.get_width()) for p in error.patches]
    assert np.allclose(shaded, [(0.0, 0.2), (0.5, 0.55)])
    assert all(len(ax.patches) == 2 for ax in forces)
    nothing = plots.contact_forces(recording, np.zeros((101, 2), dtype=bool)).axes[-1]
    assert nothing.get_ylim()[1] > 7.0, "if nothing counts, everything does"


def test_power_figure_leaves_steps_out_of_the_rms():
    plain = plots.power(RECORDING)
    blanked = plots.power(RECORDING, ~np.isin(np.arange(101), range(50, 55)))
    assert plain.axes[0].get_ylim() == plain.axes[1].get_ylim()
    assert "398 mW" in plain.axes[1].get_title(loc="left")
    counted = np.r_[0:50, 55:101]
    rms = 1e3 * np.sqrt(np.mean(RECORDING["power_projected"][counted] ** 2))
    assert f"rms {rms:.3g} mW" in blanked.axes[1].get_title(loc="left")
    assert len(blanked.axes[2].patches) == 1 and not plain.axes[2].patches
    assert blanked.axes[2].get_ylim()[1] < 0.02 < plain.axes[2].get_ylim()[1]


def test_tracking_and_torque_figures():
    linear, angular, way = plots.tracking(RECORDING, judged_from=1.0).axes
    for line, last in (  # mm, mrad, mm from the start
        (linear.lines[2], 4.0),
        (angular.lines[1], 5.0),
        (way.lines[1], 50.0 * np.sin(1.0)),
    ):
        assert np.allclose(line.get_ydata()[-1], last)
    assert "rms 5 mm" in linear.get_title(loc="left") and len(linear.patches) == 1
    limited = make_recording()
    (arm,) = plots.torques(limited).axes
    labels = [line.get_label() for line in arm.lines]
    assert labels == ["joint1", "joint2", "joint3", "joint4"], "the passive hinge has no actuator"
    assert "sliding joints: N" in arm.get_ylabel()
    limited.meta["effort_limits"] = {f"left/joint{i}": 5.0 for i in (1, 2, 3, 4)}
    (arm,) = plots.torques(limited).axes
    assert "% of its limit" in arm.get_ylabel() and len(arm.lines) == 6, "both limits are drawn"
    assert np.allclose(arm.lines[3].get_ydata()[-1], 80.0) and "80 %" in arm.lines[3].get_label()
    with recording_error("no channel 'tau'"):
        plots.torques(make_recording(without=("tau",)))


FIGURES = {"fig4": LOOP, "fig5": tuple(b for b in LOOP if b.group == "force")}


@fixture(params=FIGURES)
def diagram(request):
    """The boxes of fig. 4 or 5 with their rooms, and the axes (inches)."""
    blocks = FIGURES[request.param]
    (ax,) = draw_blocks(blocks, request.param).axes
    rooms = [p for p in ax.patches if isinstance(p, FancyBboxPatch) and p.get_alpha() is None]
    assert len(rooms) == len(blocks)
    return (list(zip(blocks, [p.get_window_extent() for p in rooms], strict=True)), ax)


def test_each_file_of_a_figure_is_drawn_once_and_all_have_one_layout(tmp_path, monkeypatch):
    drawn = []
    draw = Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda self, by: (drawn.append(type(by)), draw(self, by)))
    figure = plots.power(RECORDING)
    before = [ax.get_position().bounds for ax in figure.axes]
    with plots.style():  # whose figures have a layout of their own
        written = plots.save(figure, tmp_path / "power", plots.PRINT)
    assert [path.suffix for path in written] == [".png", ".svg", ".pdf"]
    assert len(drawn) == len(written), drawn
    after = [ax.get_position().bounds for ax in figure.axes]
    assert after != before, "laid out"
    plots.save(figure, tmp_path / "again", plots.PRINT)
    assert after == [ax.get_position().bounds for ax in figure.axes]


def test_every_box_shows_every_signal_that_it_reads_and_puts_out(diagram):
    """A line's tip at the left edge, a name above, below or beside the right edge for each."""
    boxes, ax = diagram
    assert {*LABELS, "v"} == {name for box in BLOCKS for name in (*box.inputs, *box.outputs)}
    shown = [t for t in ax.texts if t.get_text()]
    texts = [(t.get_text().replace("\n", " · "), t.get_window_extent()) for t in shown]
    tips = [ax.transData.transform(t.xy) for t in ax.texts if getattr(t, "arrow_patch", None)]
    for block, box in boxes:
        for signals in (block.inputs, block.outputs):
            assert ("q" in signals) == ("v" in signals), "v is drawn with q"
        expected = [LABELS[s] for s in block.inputs if s != "v"]
        named = [
            name
            for text, room in texts
            if abs(room.x0 + room.x1 - box.x0 - box.x1) < 4
            and 0 < max(room.y0 - box.y1, box.y0 - room.y1) < 40
            for name in text.split(" · ")
        ]
        connected = sum(abs(x - box.x0) < 2 and box.y0 < y < box.y1 for x, y in tips)
        assert set(named) <= set(expected), block.name
        assert len(named) + connected == len(expected), block.name
        beside = {
            text for text, room in texts if 0 < room.x0 - box.x1 < 12 and box.y0 < room.y0 < box.y1
        }
        assert beside == {LABELS[s] for s in block.outputs if s != "v"}, block.name
    for signal, reader in CONNECTIONS:
        assert signal in next(block.inputs for block in LOOP if block.name == reader)


def test_diagrams_are_legible(diagram):
    """Names do not overlap, connections cross neither boxes nor names, colours are explained."""
    boxes, ax = diagram
    shown = [(t.get_text(), t.get_window_extent()) for t in ax.texts if t.get_text()]
    assert {block.name for block, _ in boxes} <= {text.replace("\n", " ") for text, _ in shown}
    for (first, a), (second, b) in combinations(shown, 2):
        assert not a.overlaps(b), f"{first!r} covers {second!r}"
    rooms = [*(room for _, room in boxes), *(room for _, room in shown)]
    for line in ax.lines:
        for (x0, y0), (x1, y1) in pairwise(ax.transData.transform(line.get_xydata())):
            for room in rooms:
                assert not room.padded(-2).overlaps(Bbox([(x0, y0), (x1, y1)]))
    groups = {GROUPS[block.group][1] for block, _ in boxes}
    assert {text.get_text() for text in ax.get_legend().get_texts()} == groups


def test_contact_picture_shows_how_the_lines_lie():
    scenario = load_scenario("two_contact_rod")
    figure = reproduce("fig1", scenario)
    (ax,) = figure.axes
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert "279.6 mm apart, angle 62.0°" in labels
    for i, contact in enumerate(scenario.contacts, 1):
        (line,) = [x for x in ax.lines if x.get_label() == f"line of force of $f_{{c{i}}}$"]
        past = np.transpose(line.get_data_3d()) - contact.face.point
        assert np.allclose(np.cross(past, contact.face.normal), 0.0, atol=1e-5), "along the normal"
        heights = past @ contact.face.normal
        assert heights.min() < -0.25 and heights.max() > 0.25, "extended both ways"
    spans = [np.ptp(limits) for limits in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())]
    assert np.ptp(ax._box_aspect / spans) < 1e-9, "one scale"
