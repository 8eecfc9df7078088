"""`make worlds`: pegs of NIST's task board 1, on the installed gym-taskboard.

Not collected by `make test`, whose environment has no gym-taskboard.
"""

import numpy as np
from pytest import approx, fixture

from benchmarks.board_episode import GRIP, HAND, PEGS, Episode
from benchmarks.taskboard import try_inserting


@fixture
def episode():
    return Episode("peg_round_16", 0.0, 100)


def test_closed_fingers_hold_the_peg_where_it_was_put(episode):
    held = episode.in_hand()
    assert held.translation[2] == approx(0.1034 + GRIP, abs=2e-4)
    assert np.linalg.norm(held.translation[:2]) < 2e-4
    before = episode.env.data.xpos[episode.env.model.body(HAND).id].copy()
    for _ in range(10):
        episode.act()
    assert episode.in_hand().isApprox(held, 1e-3), "the fingers hold its weight"
    after = episode.env.data.xpos[episode.env.model.body(HAND).id]
    assert np.linalg.norm(after - before) < 1e-3
    assert max(episode.forces) == 0.0, "it touches nothing but the fingers"


def test_every_peg_of_the_board_has_a_posture_above_its_hole():
    for part in PEGS:
        one = Episode(part, 2.0, 101)
        inserted, seated = one.status()
        assert not inserted and not seated
        place = one.env.data.xpos[one.peg.fixture_id]
        assert np.linalg.norm(one.hole.translation - place) == approx(2e-3)
        assert 0.0 < one.clearance < 3e-4


def test_a_hole_at_its_modelled_place_is_entered_without_a_search():
    tried = try_inserting("ours", "peg_round_16", 0.0, 100)
    assert tried.inserted and tried.seated
    assert tried.time < 6.0 and tried.peak < 30.0


def test_a_round_peg_finds_a_hole_that_is_2_mm_aside():
    """On a spiral of the upright peg it hopped, turned in the fingers and passed over the hole."""
    tried = try_inserting("ours", "peg_round_16", 2.0, 100)
    assert tried.inserted and tried.seated
    assert tried.time < 15.0 and tried.peak < 40.0
    assert tried.slip < 0.5 and tried.turned < 2.0


def test_a_rectangular_peg_finds_a_hole_that_is_2_mm_aside():
    """With larger forces on its sides it turned by 30° in the fingers, about their axis."""
    tried = try_inserting("ours", "peg_rect_8", 2.0, 200)
    assert tried.inserted and tried.seated
    assert tried.time < 15.0 and tried.peak < 40.0
    assert tried.slip < 1.0 and tried.turned < 3.0
