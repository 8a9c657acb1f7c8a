"""The script that compares people's judgements of single pairs; the published file
may be missing."""

import json
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from wordcraft_kg.base.errors import ArtefactError, LeakError
from wordcraft_kg.graphs import RecipeGraph

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "people_pairs.py"
pairs = SimpleNamespace(**runpy.run_path(str(SCRIPT)))


class Fixed:
    """A scorer with given scores by pair and result."""

    def __init__(self, scores, recipes=()):
        self.values, self.recipes = scores, torch.tensor(recipes, dtype=torch.int32).reshape(-1, 3)

    def score_recipes(self, a, b, results):
        return torch.tensor([self.values[int(a), int(b)][int(result)] for result in results])


@pytest.fixture
def graph():
    return RecipeGraph.from_recipes(
        [("a", "b", "c"), ("a", "b", "d"), ("b", "c", "d"), ("a", "a", "b")]
    )


@pytest.fixture
def judgements(tmp_path, graph):
    questions = [
        (["b", "a"], "7", "d", ["d", "e", "a", "b"]),
        (["a", "b"], "2", "b", ["a", "b", "c", "nowhere"]),
        (["c", "b"], "5", "a", ["a", "b", "c", "nowhere"]),
        (["a", "d"], "5", "c", ["a", "b", "c", "nowhere"]),
        (["a", "nowhere"], "1", "c", ["a", "b", "c", "d"]),
    ]
    names = ("currentcombinationstring", "linkanswers", "elementanswers", "elementoptionsshuffeld")
    person = dict(zip(names, zip(*questions, strict=True), strict=True))
    path = tmp_path / "judgements.json"
    path.write_text(json.dumps({"1": person}))
    return pairs.read_judgements(path, graph)


def test_a_scorer_that_knows_a_judged_pair_is_refused(graph, judgements):
    """A scorer that knows a judged pair is refused and its recipes are listed."""
    expected = [("a", "b", "c"), ("a", "b", "d"), ("b", "c", "d")]
    assert pairs.judged_recipes(judgements, graph) == expected
    leaky = Fixed({}, [[1, 0, 3], [0, 0, 1]])
    with pytest.raises(LeakError, match="1 rated pairs"):
        pairs.answers_of_scorer(judgements, graph, "leaky", leaky)
    with pytest.raises(LeakError, match="without recipes"):
        pairs.answers_of_scorer(judgements, graph, "zero-shot", Fixed({}))


def test_the_area_is_the_share_of_ordered_cases():
    rng = np.random.default_rng(0)
    right, scores = rng.random(40) < 0.3, rng.integers(5, size=40)
    cases = [(one > two) + 0.5 * (one == two) for one in scores[right] for two in scores[~right]]
    area, low, high = pairs.area_under_curve(right.tolist(), scores.tolist(), range(40))
    assert area == pytest.approx(np.mean(cases))
    # Hanley and McNeil's standard error for cases that are drawn one by one
    a, n, m = area, right.sum(), (~right).sum()
    variance = (
        a * (1 - a) + (n - 1) * (a / (2 - a) - a * a) + (m - 1) * (2 * a * a / (1 + a) - a * a)
    )
    assert (high - low) / 3.92 == pytest.approx(np.sqrt(variance / (n * m)), rel=0.15)
    # Copies of the same cases in a person's cluster are no further evidence.
    copies = pairs.area_under_curve([*right] * 3, [*scores] * 3, [*range(40)] * 3)
    assert copies == pytest.approx((area, low, high))


def test_published_judgements_give_the_figures_of_the_guide(alchemy):
    try:
        path = pairs.judgements_file()
    except ArtefactError:
        pytest.skip("the published judgements are not on this machine")
    judgements = pairs.read_judgements(path, alchemy)
    people = pairs.answers_of_people(judgements, alchemy)
    assert len({each.pair for each in judgements}) == 832
    assert len(judgements) == 1949
    assert len(pairs.with_right_option(judgements, alchemy)) == 178
    assert people.auc == pytest.approx((0.588, 0.564, 0.612), abs=2e-3)
    assert people.right == pytest.approx((0.607, 0.516, 0.700), abs=2e-3)
