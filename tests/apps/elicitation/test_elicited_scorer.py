"""Scores of elicited recipes: weighted recipes and their links."""

from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

from wordcraft_kg.agents.players import scorer_players
from wordcraft_kg.apps.elicitation.scorer import ElicitedScorer
from wordcraft_kg.base.errors import ArtefactError, ConfigError, UnknownEntityError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.policies.sources.source import Source
from wordcraft_kg.models.saving import save_scorer
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.runs.record import end_run, read_run


@pytest.fixture(scope="module")
def elicited(opened: OpenedGraph) -> tuple[np.ndarray, np.ndarray]:
    """A third of the recipes and as many false ones, in any order of the pair, some twice; and weights."""
    rng, size = np.random.default_rng(3), opened.graph.num_entities
    true = opened.graph.recipes[::3].astype(np.int64)
    rows = np.concatenate([true, rng.integers(size, size=true.shape), true[:5, [1, 0, 2]], [[4, 4, 7]]])
    return rng.permutation(rows), rng.random(len(rows)) + 0.1


@pytest.fixture(scope="module")
def scorer(opened: OpenedGraph, elicited: tuple[np.ndarray, np.ndarray]) -> ElicitedScorer:
    return ElicitedScorer.of(*elicited, opened.graph.entities, opened.graph.hash, name="elicited")


@pytest.fixture(scope="module")
def weights(elicited: tuple[np.ndarray, np.ndarray]) -> dict[tuple[frozenset[int], int], float]:
    """The weight of each recipe, collected in a loop."""
    weights: dict[tuple[frozenset[int], int], float] = {}
    for (a, b, c), weight in zip(elicited[0].tolist(), elicited[1].astype(np.float32).tolist(), strict=True):
        key = frozenset((a, b)), c
        weights[key] = max(weights.get(key, 0.0), weight)
    return weights


def test_recipes_and_links_are_scored_as_loops_over_the_elicited_recipes_score_them(opened, scorer, weights):
    size = opened.graph.num_entities
    everything = torch.arange(size)
    recipes = scorer.score_recipes(everything[:, None, None], everything[None, :, None], everything)
    pairs, parts = torch.zeros(size, size), torch.zeros(size, size)
    expected = torch.zeros(size, size, size)
    for (pair, c), weight in weights.items():
        a, b = sorted(pair) if len(pair) == 2 else (*pair, *pair)
        expected[a, b, c] = expected[b, a, c] = weight
        pairs[a, b] = pairs[b, a] = max(float(pairs[a, b]), weight)
        for x in pair:
            parts[x, c] = max(float(parts[x, c]), weight)
    torch.testing.assert_close(recipes, expected, rtol=0, atol=0)
    for relation, table in ((COMBINES_WITH, pairs), (COMPONENT_OF, parts)):
        torch.testing.assert_close(scorer.table(relation), table, rtol=0, atol=0)
        torch.testing.assert_close(scorer.score(everything[:, None], relation, everything), table, rtol=0, atol=0)
    assert len(scorer.elicited) == len(weights)


def test_w_of_elicited_recipes_is_the_best_partner_on_the_table_as_a_loop_finds_it(opened, scorer, weights):
    (w,) = make_sources(["w"], scorer)
    size, rng = opened.graph.num_entities, np.random.default_rng(0)
    some = [(sorted(pair), c) for pair, c in weights]
    for number, (pair, goal) in enumerate(some[:60]):
        others = rng.permutation([entity for entity in range(size) if entity not in pair])[:3].tolist()
        table = [*others, pair[0], pair[-1] if number % 3 else size, size]
        for held in (size, pair[0], int(others[0])):
            partners = table if held == size else [held]
            expected = [max(weights.get((frozenset((x, y)), goal), 0.0) for y in partners) for x in table]
            scores = w(torch.tensor([goal]), torch.tensor([held]), torch.tensor([table]))
            assert scores[0].tolist() == pytest.approx(expected, abs=1e-7)


def test_elicited_recipes_are_saved_and_loaded_without_training_recipes(opened, scorer, tmp_path):
    folder = save_scorer(tmp_path / "elicited", scorer, opened, kg="none", origin="what somebody thinks")
    loaded = load_scorer(folder, graph=opened.graph)
    assert isinstance(loaded, ElicitedScorer)
    torch.testing.assert_close(loaded.tensors(), scorer.tensors(), rtol=0, atol=0)
    model = open_model(folder)
    assert (model.kg, len(model.triples), len(model.train_sample.recipes)) == ("none", 0, 0)
    np.testing.assert_array_equal(model.observed, scorer.observed)
    assert "no recipe from the graph" in (folder / "README.md").read_text()
    assert "w, best pair" in scorer_players(opened.graph, loaded, model.observed)


def test_a_source_of_elicited_recipes_is_restored_from_its_constants(scorer):
    (w,) = make_sources(["w"], scorer)
    again = type(w).restored(w.num_entities, w.state_dict())
    again.load_state_dict(w.state_dict())
    assert isinstance(again, Source)
    goal, table = torch.arange(20), torch.randint(w.num_entities + 1, (20, 6), generator=torch.manual_seed(0))
    nothing = torch.full((20,), w.num_entities)
    torch.testing.assert_close(again(goal, nothing, table), w(goal, nothing, table))


def test_no_elicited_recipes_at_all_score_everything_alike(opened):
    scorer = ElicitedScorer.of(np.empty((0, 3)), [], opened.graph.entities, opened.graph.hash)
    assert not scorer.table(COMBINES_WITH).any()
    assert not scorer.score_recipes(0, 1, range(5)).any()
    assert len(scorer.observed) == 0
    with pytest.raises(UnknownEntityError):
        scorer.score_recipes("flour", "watr", "dough")


@pytest.mark.parametrize(
    ("spoil", "fragment"),
    [
        (lambda elicited, weights: (elicited[:, :2], weights), "elicited has shape"),
        (lambda elicited, weights: (elicited.long(), weights), "elicited has type torch.int64"),
        (lambda elicited, weights: (elicited, weights[1:]), "weights has shape"),
        (lambda elicited, weights: (elicited, weights * 0), "must be above 0"),
        (lambda elicited, weights: (elicited.flip(0), weights), "unsorted or duplicated"),
        (lambda elicited, weights: (elicited[:, [1, 0, 2]], weights), "unsorted or duplicated"),
        (lambda elicited, weights: (elicited[torch.tensor([0, 0])], weights[:2]), "unsorted or duplicated"),
        (lambda elicited, weights: (elicited + 200, weights), "outside 0 .. 79"),
    ],
)
def test_tensors_that_are_no_elicited_recipes_are_refused(opened, scorer, tmp_path, spoil, fragment):
    elicited, weights = spoil(scorer.elicited, scorer.weights)
    spoilt = {"elicited": elicited.contiguous(), "weights": weights}
    with pytest.raises(ValueError, match=fragment):
        ElicitedScorer.check(spoilt, opened.graph.num_entities)
    folder = save_scorer(tmp_path / "elicited", scorer, opened, kg="none")
    Path(folder / "model.safetensors").write_bytes(safetensors.torch.save(spoilt))
    end_run(folder, read_run(folder), "done", tuple(read_run(folder).outputs))
    with pytest.raises(ArtefactError, match="does not contain a scorer"):
        load_scorer(folder)


def test_w_of_elicited_recipes_serves_books_whose_tables_of_all_pairs_would_be_too_large():
    size = 7_000
    scorer = ElicitedScorer.of([[0, size - 1, 5]], [1.0], [f"thing {number}" for number in range(size)], "a graph")
    (w,) = make_sources(["w"], scorer)
    scores = w(torch.tensor([5]), torch.tensor([size]), torch.tensor([[3, size - 1, 0, size]]))
    assert scores.tolist() == [[0.0, 1.0, 1.0, 0.0]]
    with pytest.raises(ConfigError, match="score table"):
        make_sources(["u", "v", "w"], scorer)
