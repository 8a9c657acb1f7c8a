"""Scorers: one protocol for all, batches equal to singles, and nothing served from a damaged or
foreign folder."""

import json
import math
import subprocess
import sys
from collections import Counter

import hypothesis.extra.numpy as npst
import numpy as np
import pytest
import safetensors.torch
import torch
from hypothesis import example, given, strategies as st
from link_helpers import equation_1, flip_bit, random_graph, train
from small_scorers import embeddings

from wordcraft_kg import LinkModelConfig, load_scorer, save_scorer
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    LeakError,
    UnknownEntityError,
    sha256_of,
)
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS, RecipeGraph, recipe_triples
from wordcraft_kg.models.scorers import score_limits
from wordcraft_kg.models.scorers.baselines import (
    FrequencyScorer,
    KernelScorer,
    NeighbourScorer,
    SymbolicScorer,
    VoteScorer,
)
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, cross_fit
from wordcraft_kg.models.scorers.factors import ComplExScorer, TableScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.models.scorers.scorer_folder import make_scorer

GRAPH = random_graph(num_entities=12, num_recipes=30)
SIZE = GRAPH.num_entities
PAIRS_BYTES = len(RELATIONS) * SIZE**2 * 4
EVERYTHING = torch.arange(SIZE)
EMBEDDINGS = embeddings(SIZE, 5)
COMPLEX = ComplExScorer(EMBEDDINGS, GRAPH.entities, GRAPH.hash)
SCORERS: dict[str, Scorer] = {
    "complex": COMPLEX,
    "table": ComplExScorer.restored(COMPLEX.tensors(), COMPLEX.entities, COMPLEX.graph_hash),
    "symbolic": SymbolicScorer(GRAPH, GRAPH.triples),
    "frequency": FrequencyScorer(GRAPH, GRAPH.triples[::2]),
    "votes": VoteScorer(GRAPH, GRAPH.recipes[::2]),
}
any_scorer = pytest.mark.parametrize("scorer", SCORERS.values(), ids=SCORERS)
any_relation = pytest.mark.parametrize("relation", range(len(RELATIONS)), ids=RELATIONS)


def same_tables(one, other):
    for relation in RELATIONS:
        torch.testing.assert_close(one.table(relation), other.table(relation), atol=1e-5, rtol=1e-5)


@any_scorer
def test_a_scorer_follows_the_protocol(scorer):
    assert isinstance(scorer, TripleScorer)
    assert not isinstance(GRAPH, TripleScorer)
    assert (scorer.entities, scorer.graph_hash) == (GRAPH.entities, GRAPH.hash)
    assert (
        scorer.score(0, COMPONENT_OF, 1).dtype == scorer.table(COMBINES_WITH).dtype == torch.float32
    )


def shapes_of(*shapes):
    return npst.BroadcastableShapes(shapes, np.broadcast_shapes(*shapes))


@pytest.mark.parametrize("name", SCORERS)
@given(
    shapes=npst.mutually_broadcastable_shapes(num_shapes=3, max_dims=3, max_side=4),
    seed=st.integers(0, 99),
)
@example(shapes=shapes_of((1, 1), (1, 1, 1), (1, 1)), seed=0)
@example(shapes=shapes_of((3, 1), (1, 3), (1, 3)), seed=0)
@example(shapes=shapes_of((1, 3), (1, 3), (3, 1)), seed=0)
@example(shapes=shapes_of((3, 1), (3,), (1, 3)), seed=0)
@example(shapes=shapes_of((3, 1), (3, 1), (1, 4)), seed=0)
@example(shapes=shapes_of((1, 4), (3, 1), (3, 1)), seed=0)
@example(shapes=shapes_of((1, 4), (3, 1), (1, 1)), seed=0)
def test_batched_scores_of_any_broadcastable_ids_equal_single_scores(name, shapes, seed):
    scorer, rng = SCORERS[name], np.random.default_rng(seed)
    sizes = (SIZE, len(RELATIONS), SIZE)
    ids = [
        torch.from_numpy(np.asarray(rng.integers(n, size=s)))
        for n, s in zip(sizes, shapes.input_shapes, strict=True)
    ]
    batched = scorer.score(*ids)
    assert tuple(batched.shape) == shapes.result_shape
    rows = zip(*(x.expand(shapes.result_shape).flatten().tolist() for x in ids), strict=True)
    singles = torch.tensor([float(scorer.score(h, r, t)) for h, r, t in rows])
    torch.testing.assert_close(
        batched.flatten(), singles.view(batched.numel()), atol=1e-5, rtol=1e-5
    )


@any_scorer
@any_relation
def test_the_table_of_a_relation_holds_the_scores_of_all_pairs(scorer, relation):
    expected = scorer.score(EVERYTHING[:, None], relation, EVERYTHING[None, :])
    torch.testing.assert_close(scorer.table(relation), expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(scorer.table(RELATIONS[relation]), scorer.table(relation))


@any_scorer
@any_relation
def test_labels_and_ids_give_the_same_scores(scorer, relation):
    heads, tails = [3, 1, 4], [1, 5, 9]
    by_id = scorer.score(heads, relation, tails)
    names = [[GRAPH.entities[i] for i in ids] for ids in (heads, tails)]
    torch.testing.assert_close(scorer.score(names[0], RELATIONS[relation], names[1]), by_id)
    torch.testing.assert_close(scorer.score(tuple(names[0]), relation, torch.tensor(tails)), by_id)
    torch.testing.assert_close(
        scorer.score(names[0][0], RELATIONS[relation], tails), scorer.score(3, relation, tails)
    )
    assert scorer.score(names[0][0], RELATIONS[relation], names[1][0]).shape == ()
    head, number, tail = GRAPH.triples[3]  # ids of NumPy
    expected = scorer.score(int(head), int(number), int(tail))
    torch.testing.assert_close(
        scorer.score(GRAPH.triples[:, 0], number, GRAPH.triples[:, 2])[3], expected
    )
    torch.testing.assert_close(scorer.score(head, number, tail), expected)


OUTSIDE = (-1, SIZE, [0, SIZE], [-1, 0], torch.tensor([[0], [SIZE + 5]]))
REFUSED = [
    *(((ids, COMPONENT_OF, 0), rf"0 \.\. {SIZE - 1}") for ids in OUTSIDE),
    *(((0, COMPONENT_OF, ids), rf"0 \.\. {SIZE - 1}") for ids in OUTSIDE),
    *(
        (([0, 1], ids, [0, 1]), r"relation ids must be 0 \.\. 1")
        for ids in (-1, 2, torch.tensor([0, 2]))
    ),
    ((0, "combineWith", 1), "'combinesWith'"),
    ((0, "makes", 1), "componentOf"),
    (("e1x", COMPONENT_OF, 0), "'e1x'.*Did you mean.*'e1'"),
    ((0, COMPONENT_OF, ["e2", "e1x"]), "'e1x'.*Did you mean.*'e1'"),
]


@any_scorer
@pytest.mark.parametrize(("triple", "fragment"), REFUSED)
def test_bad_ids_and_labels_are_refused_with_known_ones(scorer, triple, fragment):
    """Ids out of range and unknown labels are refused with those that are known."""
    with pytest.raises(UnknownEntityError, match=fragment):
        scorer.score(*triple)
    if isinstance(triple[1], str):
        with pytest.raises(UnknownEntityError, match=fragment):
            scorer.table(triple[1])


@any_scorer
def test_another_graphs_ids_are_refused(scorer):
    check_scorer(scorer, GRAPH)
    check_scorer(
        scorer, RecipeGraph(GRAPH.entities, GRAPH.recipes, GRAPH.base_ids, name="an equal one")
    )
    other = random_graph(seed=1, num_entities=12, num_recipes=30)
    with pytest.raises(GraphMismatchError):
        check_scorer(scorer, other)


@any_scorer
def test_top_lists_the_best_entities_of_an_open_slot(scorer):
    table = scorer.table(COMPONENT_OF)
    for found, scores in (
        (scorer.top(None, "componentOf", 2, limit=4), table[:, 2]),
        (scorer.top(GRAPH.entities[2], COMPONENT_OF, None, limit=4), table[2]),
    ):
        best = [score for _, score in found]
        assert best == pytest.approx(sorted(scores.tolist(), reverse=True)[:4], abs=1e-5)
        assert best == pytest.approx(
            [float(scores[GRAPH.id_of(name)]) for name, _ in found], abs=1e-5
        )


def test_top_without_triples_lists_ties_by_id():
    """Top of a scorer without triples lists ties in the order of ids and needs one open slot."""
    for kind in (FrequencyScorer, NeighbourScorer, SymbolicScorer):
        scorer = kind(GRAPH, GRAPH.triples[:0])
        assert not scorer.table(COMBINES_WITH).any()
        assert not scorer.table(COMPONENT_OF).any()
    for head, tail in ((None, None), (0, 1)):
        with pytest.raises(ValueError, match="either head or tail"):
            scorer.top(head, COMPONENT_OF, tail)
    assert scorer.top(None, COMPONENT_OF, 0, limit=None) == [(name, 0.0) for name in GRAPH.entities]
    assert len(scorer.top(None, COMPONENT_OF, 0)) == 10
    assert len(scorer.top(None, COMPONENT_OF, 0, limit=100)) == SIZE


def test_complex_scores_are_those_of_equation_1():
    entity, relation = (
        torch.complex(EMBEDDINGS[f"{kind}_real"], EMBEDDINGS[f"{kind}_imag"]).numpy()
        for kind in ("entity", "relation")
    )
    for r in range(len(RELATIONS)):
        expected = [
            [equation_1(entity[h], relation[r], entity[t]) for t in range(SIZE)]
            for h in range(SIZE)
        ]
        np.testing.assert_allclose(COMPLEX.table(r).numpy(), expected, atol=1e-5)


@pytest.mark.parametrize(
    ("limit", "kind"), [(PAIRS_BYTES, TableScorer), (PAIRS_BYTES - 1, ComplExScorer)]
)
def test_embeddings_become_a_table_where_it_fits_the_limit(monkeypatch, limit, kind):
    monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", limit)
    assert type(make_scorer("complex", EMBEDDINGS, GRAPH.entities, GRAPH.hash)) is kind


def test_the_symbolic_scorer_is_one_exactly_on_its_triples():
    facts = GRAPH.triples[1::2]
    known = {tuple(triple) for triple in facts.tolist()}
    for relation in range(len(RELATIONS)):
        expected = [[float((h, relation, t) in known) for t in range(SIZE)] for h in range(SIZE)]
        assert SymbolicScorer(GRAPH, facts).table(relation).tolist() == expected
    assert known


def test_the_frequency_scorer_counts_heads_and_tails_of_the_relation():
    triples = GRAPH.triples[::3]
    for relation in range(len(RELATIONS)):
        as_head = [
            sum(h == entity and r == relation for h, r, _ in triples.tolist())
            for entity in range(SIZE)
        ]
        as_tail = [
            sum(t == entity and r == relation for _, r, t in triples.tolist())
            for entity in range(SIZE)
        ]
        expected = [[as_head[h] + as_tail[t] for t in range(SIZE)] for h in range(SIZE)]
        assert FrequencyScorer(GRAPH, triples).table(relation).tolist() == expected


def slow_neighbour_scores(graph, triples, power):
    """The formula of the docstring with loops over entities and neighbours."""
    size, facts = graph.num_entities, {tuple(triple) for triple in triples.tolist()}
    neighbours = [
        {("with", t) for h, r, t in facts if h == e and r == COMBINES_WITH}
        | {("makes", t) for h, r, t in facts if h == e and r == COMPONENT_OF}
        | {("made of", h) for h, r, t in facts if t == e and r == COMPONENT_OF}
        for e in range(size)
    ]
    count = Counter(neighbour for of_one in neighbours for neighbour in of_one)

    def product(one, other):
        return sum(count[neighbour] ** -power for neighbour in neighbours[one] & neighbours[other])

    def alike(one, other):
        lengths = math.sqrt(product(one, one) * product(other, other))
        return product(one, other) / lengths if lengths and one != other else 0.0

    scores = np.zeros((len(RELATIONS), size, size))
    for head, relation, tail in facts:
        for other in range(size):
            scores[relation, other, tail] += alike(other, head)
            scores[relation, head, other] += alike(other, tail)
    return scores


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0])
def test_the_neighbour_scorer_follows_its_formula(power):
    triples = GRAPH.triples[::2]
    scorer = NeighbourScorer(GRAPH, triples, power=power)
    expected = slow_neighbour_scores(GRAPH, triples, power)
    for relation in range(len(RELATIONS)):
        np.testing.assert_allclose(
            scorer.table(relation).numpy(), expected[relation], rtol=1e-5, atol=1e-6
        )
    assert expected[COMBINES_WITH].any()
    assert expected[COMPONENT_OF].any()


@pytest.fixture(params=["complex_folder", "distmult_folder"])
def folder(request):
    return request.getfixturevalue(request.param)


def test_a_loaded_scorer_follows_the_protocol_and_knows_its_graph(folder, opened_kitchen):
    scorer = load_scorer(folder, graph=opened_kitchen.graph)
    assert isinstance(scorer, TripleScorer)
    assert (scorer.entities, scorer.graph_hash) == (
        opened_kitchen.graph.entities,
        opened_kitchen.graph.hash,
    )
    assert scorer.name == folder.name
    with pytest.raises(GraphMismatchError):
        load_scorer(folder, graph=GRAPH)


@pytest.mark.slow
def test_loading_and_using_a_scorer_does_not_import_pykeen(complex_folder):
    code = (
        "import sys; from wordcraft_kg.models.scorers.scorer_folder import load_scorer\n"
        f"load_scorer({str(complex_folder)!r}).top(None, 'componentOf', 'bread', 1); "
        "sys.exit('pykeen' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], timeout=120, check=True)


@pytest.mark.parametrize(
    ("place", "fragment"),
    [
        ("nowhere", "does not exist.*train-complex"),
        ("model/model.safetensors", "is a file; expected a model"),
        ("graph", "is a graph folder; expected a model"),
    ],
)
def test_loading_what_is_no_model_is_refused(
    complex_folder, parted_folder, tmp_path, place, fragment
):
    (tmp_path / "model").symlink_to(complex_folder)
    (tmp_path / "graph").symlink_to(parted_folder)
    with pytest.raises(ArtefactError, match=fragment):
        load_scorer(tmp_path / place)


PARTS = ("model.safetensors", "vocabulary.json")


def mended(folder, name):
    """Give the run record the hash of a changed file, as somebody who changes it on
    purpose would."""
    run = json.loads((folder / "run.json").read_text())
    run["outputs"][name] = sha256_of(folder / name)
    (folder / "run.json").write_text(json.dumps(run))
    return folder


PLACES = (0.0, 0.001, 0.01, 0.1, 0.33, 0.5, 0.75, 0.9, 1.0)


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize(
    "damage",
    [
        *(("flip", place, bit) for place in PLACES for bit in (0, 5)),
        *(("cut", n) for n in (0, 4, 100, -1)),
    ],
)
def test_a_flipped_bit_or_a_cut_names_the_file(spoilt, name, damage):
    """A flipped bit and a cut anywhere is an artefact error that names the file."""
    folder, path = spoilt(name)
    if damage[0] == "flip":
        flip_bit(path, int(damage[1] * (path.stat().st_size - 1)), damage[2])
    else:
        path.write_bytes(path.read_bytes()[: damage[1]])
    with pytest.raises(ArtefactError, match=rf"{name} is damaged"):
        load_scorer(folder)


def test_a_table_of_any_strides_scores_like_a_plain_one():
    scores = torch.randn(len(RELATIONS), SIZE, SIZE).transpose(1, 2)
    assert not scores.is_contiguous()
    scorer = TableScorer(scores, GRAPH.entities, GRAPH.hash)
    assert scorer.score(1, COMPONENT_OF, 2) == scores[COMPONENT_OF, 1, 2]
    assert torch.equal(scorer.table(COMBINES_WITH), scores[COMBINES_WITH])


def test_what_needs_all_pairs_is_refused_with_their_size(monkeypatch):
    """What needs all pairs is refused with their size before it is computed."""
    monkeypatch.setattr(score_limits, "TABLE_LIMIT", PAIRS_BYTES)
    NeighbourScorer(GRAPH, GRAPH.triples)
    monkeypatch.setattr(score_limits, "TABLE_LIMIT", PAIRS_BYTES - 1)
    with pytest.raises(ConfigError, match=f"a score table for {SIZE} entities"):
        NeighbourScorer(GRAPH, GRAPH.triples)


def test_embeddings_serve_where_a_table_is_too_large(
    complex_folder, opened_kitchen, tmp_path, monkeypatch
):
    """A model of embeddings is served from them where a table is too large."""
    config = LinkModelConfig(model="distmult", dim=4, epochs=2, folds=0)
    distmult = train(opened_kitchen, config, tmp_path / "table").folder
    tables = [load_scorer(complex_folder), load_scorer(distmult)]
    monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 0)
    again = train(opened_kitchen, config, tmp_path / "embeddings").folder
    for table, scorer in zip(
        tables, (load_scorer(complex_folder), load_scorer(again)), strict=True
    ):
        assert (type(table), type(scorer)) == (TableScorer, ComplExScorer)
        same_tables(scorer, table)


def test_a_table_too_large_is_refused_before_training(opened_kitchen, tmp_path, monkeypatch):
    """A model that needs a table too large is refused before training with models that do not."""
    monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 0)
    with pytest.raises(ConfigError, match=r"'rotate' needs a score table.*distmult, and ComplEx"):
        train(opened_kitchen, LinkModelConfig(model="rotate"), tmp_path / "model")
    assert not (tmp_path / "model").exists()


@pytest.mark.parametrize("dtype", [torch.complex64, torch.int64, torch.float64])
def test_embeddings_of_another_type_are_an_artefact_error(spoilt, dtype):
    folder, path = spoilt("model.safetensors")
    tensors = safetensors.torch.load_file(path)
    path.write_bytes(
        safetensors.torch.save({**tensors, "entity_real": tensors["entity_real"].to(dtype)})
    )
    with pytest.raises(ArtefactError, match=rf"entity_real'? has type {dtype}.*expected"):
        load_scorer(mended(folder, "model.safetensors"))


def test_each_model_is_made_from_recipes_outside_its_fold(opened):
    """Each model is made from the recipes outside its fold and nothing else."""
    given = []

    def make(recipes):
        given.append(recipes)
        return SymbolicScorer(opened.graph, recipe_triples(recipes))

    scorer = cross_fit(opened.split, make, folds=3)
    for fold in range(3):
        triples = scorer.trained_on(fold, opened.graph)
        assert scorer.left_out(fold).score(*triples.T).min() == 1
        np.testing.assert_array_equal(recipe_triples(given[-1]), triples)
    np.testing.assert_array_equal(given[0], opened.split.recipes("train"))
    assert len(given) == 4


def test_a_saved_scorer_keeps_its_folds_and_says_how_well_they_predict(opened, tmp_path):
    scorer = cross_fit(opened.split, lambda recipes: KernelScorer(opened.graph, recipes), folds=3)
    loaded = load_scorer(save_scorer(tmp_path / "mine", scorer, opened, kg="partial"))
    assert isinstance(loaded, CrossFitted)
    for relation in (0, 1):
        torch.testing.assert_close(loaded.table(relation), scorer.table(relation))
        for fold in range(3):
            torch.testing.assert_close(
                loaded.left_out(fold).table(relation), scorer.left_out(fold).table(relation)
            )
    assert loaded.record.mrr < loaded.record.in_sample_mrr


def test_folds_that_have_seen_something_else_are_not_saved(opened, tmp_path):
    scorer = cross_fit(opened.split, lambda recipes: KernelScorer(opened.graph, recipes), folds=3)
    first, second, *rest = scorer.record.folds
    record = type(scorer.record)(
        seed=scorer.record.seed, hash=scorer.record.hash, folds=(second, first, *rest)
    )
    spoilt = CrossFitted(
        scorer.whole,
        [lambda fold=fold: scorer.left_out(fold) for fold in range(3)],
        scorer.of_recipe,
        record,
    )
    with pytest.raises(LeakError):
        save_scorer(tmp_path / "mine", spoilt, opened, kg="partial")
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize("folds", [1, 1_000])
def test_a_number_of_folds_that_cannot_be_is_refused(opened, folds):
    with pytest.raises(ConfigError, match="folds"):
        cross_fit(opened.split, lambda recipes: KernelScorer(opened.graph, recipes), folds=folds)
