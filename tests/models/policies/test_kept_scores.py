"""Scores of states that recur: kept row by row, and the same bits as computed anew."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from small_scorers import states as states_of

from wordcraft_kg import make_sources
from wordcraft_kg.models.policies.sources import source as room
from wordcraft_kg.models.policies.sources.source import KeptScores, ScoreView
from wordcraft_kg.models.policies.states import Attempts, States


def slow_scores(goal, table):
    """Scores of slots that differ for each input."""
    return goal[:, None] * 1000.0 + table + 1


def ask(kept, goal, table, computed=None):
    """Return the kept scores of a batch, and count the rows that were computed."""

    def compute(rows):
        found = slow_scores(goal[rows], table[rows])
        if computed is not None:
            computed.append(len(found))
        return found

    return kept.scores((goal, table), compute, table.shape[1:])


def batches(seed, number, rows, goals, width=3):
    generator = torch.Generator().manual_seed(seed)
    for _ in range(number):
        goal = torch.randint(goals, (rows,), generator=generator)
        yield goal, torch.randint(4, (rows, width), generator=generator)


def test_a_row_is_computed_once_while_there_is_room():
    kept = KeptScores()
    seen, computed = set(), []
    for goal, table in batches(0, number=20, rows=50, goals=9):
        rows = [tuple(row) for row in torch.cat([goal[:, None], table], dim=1).tolist()]
        before = sum(computed)
        assert torch.equal(ask(kept, goal, table, computed), slow_scores(goal, table))
        # Equal rows of a batch are computed together, each.
        assert sum(computed) - before == sum(row not in seen for row in rows)
        seen |= set(rows)


@pytest.mark.parametrize("most", [1, 30, 300])
def test_without_room_rows_make_way_for_others_and_stay_right(monkeypatch, most):
    monkeypatch.setattr(room, "KEPT", most)
    kept = KeptScores()
    computed = []
    for goal, table in batches(1, number=60, rows=20, goals=50):
        assert torch.equal(ask(kept, goal, table, computed), slow_scores(goal, table))
    assert sum(len(rows.hashes.reshape(-1, 2)) for rows in kept._rows.values()) <= max(most, 4)
    assert sum(computed) > 60 * 20 / 2


def test_threads_and_tables_of_other_widths_get_their_own_scores(monkeypatch):
    monkeypatch.setattr(room, "KEPT", 64)
    kept = KeptScores()
    asked = [
        batch
        for width in range(1, room.MOST_SHAPES + 3)
        for batch in batches(width, number=10, rows=30, goals=20, width=width)
    ]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda batch: ask(kept, *batch), asked))
    assert all(
        torch.equal(scores, slow_scores(*batch)) for scores, batch in zip(found, asked, strict=True)
    )
    assert len(kept._rows) == room.MOST_SHAPES


def test_hashes_of_many_rows_differ():
    rows = torch.cartesian_prod(torch.arange(60), torch.arange(60), torch.arange(60))
    hashes = room._hashes([rows[:, 0], rows[:, 1:]])
    assert len(np.unique(hashes, axis=0)) == len(rows)
    places = np.unique(hashes[:, 0] & (2**18 - 1), return_counts=True)[1]
    # As many as if they were drawn: 216,000 rows at 262,144 places.
    assert 0.54 < len(places) / 2**18 < 0.58


def test_a_row_has_the_same_bits_in_any_batch(cross_fitted):
    def sources():
        return make_sources(["u", "v", "w", "p"], cross_fitted, ScoreView(without_tables=True))

    size = len(cross_fitted.whole.entities)
    goal, selection, table = states_of(size, 60, 6)
    states = States(goal, selection, table, attempts=Attempts(torch.full_like(goal, 2)))
    whole = [source(states) for source in sources()]
    generator = torch.Generator().manual_seed(0)
    for count in (1, 7, 50):
        rows = torch.randperm(60, generator=generator)[:count]
        for source, expected in zip(sources(), whole, strict=True):
            assert torch.equal(source(states.of(rows)), expected[rows]), (source.name, count)
