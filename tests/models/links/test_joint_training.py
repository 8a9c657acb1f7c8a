"""Joint training with triples from outside the book: the loss, the saved model, folds, and refused
folders."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from link_helpers import interrupt_after, random_graph, train
from link_oracles import equation_2, n3
from refusals import refuses
from resumption import resume

from wordcraft_kg import ComplExConfig, LinksConfig, RecipeGraph, load_scorer
from wordcraft_kg.base.errors import ArtefactError, WordCraftKGError
from wordcraft_kg.graphs import recipe_triples
from wordcraft_kg.graphs.folds import make_folds
from wordcraft_kg.models.knowledge.folder import KnowledgeRecord, KnowledgeTables, write_knowledge
from wordcraft_kg.models.links.builders import make_training_loop, scorer_tensors
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.outside import read_outside
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, triples_factory
from wordcraft_kg.models.links.regularisation import choose
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.runs.record import read_run

Rows = list[tuple[str, ...]]
KITCHEN: Rows = [
    ("egg", "isA", "other:food"),
    ("flour", "isA", "other:food"),
    ("egg", "partOf", "other:bird"),
]
SHORT = ComplExConfig(dim=8, epochs=4, n3=0.01, folds=2)


def knowledge_folder(path, rows, number=None):
    record = KnowledgeRecord(
        source="a graph", entities=(), tables=(), triples=len(rows) if number is None else number
    )
    files = {
        "triples.tsv": "".join(
            "\t".join(row) + "\n" for row in [("head", "relation", "tail"), *rows]
        )
    }
    folder = write_knowledge(
        path,
        "test",
        KnowledgeTables(record, ()),
        inputs={},
        files=files if rows else {},
        force=True,
    )
    return str(folder)


def silent(*args):
    """Nobody watches."""


def fitted(settings, graph, triples, outside):
    model = fit(settings, triples_factory(graph, triples, outside), silent, graph.num_entities)
    tensors = scorer_tensors(settings, model, triples, graph.num_entities)
    return make_scorer(*tensors, graph.entities, graph.hash)


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    return knowledge_folder(tmp_path_factory.mktemp("outside") / "kitchen", KITCHEN)


@pytest.fixture(scope="module")
def joint(opened_kitchen, outside, tmp_path_factory):
    """A cross-fitted model with outside triples; read only."""
    return train(
        opened_kitchen,
        replace(SHORT, with_=(outside,)),
        tmp_path_factory.mktemp("models") / "joint",
    )


@pytest.mark.parametrize(("negatives", "tolerance"), [(0, 1e-5), (4_000, 0.02)])
def test_own_triples_rank_entities_and_outside_ones_all_nodes(tmp_path, negatives, tolerance):
    """Own triples compete with entities and outside triples with all nodes."""
    graph = random_graph(num_entities=7, num_recipes=9)
    rows = [
        ("e0", "isA", "x"),
        ("e1", "isA", "x"),
        ("y", "near", "e2"),
        ("y", "isA", "x"),
        ("e3", "near", "e4"),
    ]
    settings = ComplExConfig(dim=3, n3=0.2, init_scale=0.7, negatives=negatives, outside_weight=0.4)
    factory = triples_factory(
        graph, graph.triples, read_outside([knowledge_folder(tmp_path, rows)], graph.entities)
    )
    with pykeen_guard(0, threads=1):
        loop = make_training_loop(settings, factory, num_entities=7)
        loop.model.train()
        found = loop._process_batch((factory.mapped_triples,), 0, factory.num_triples).item()
    parts = loop.model.entity_representations[0], loop.model.relation_representations[0]
    entity, relation = (part._plain_forward().detach().numpy() for part in parts)
    assert (len(entity), len(relation)) == (9, 4)
    expected = 0.0
    for weight, candidates, triples in (
        (1.0, entity[:7], graph.triples.tolist()),
        (0.4, entity, factory.mapped_triples[len(graph.triples) :].tolist()),
    ):
        loss = equation_2(entity, relation, triples, candidates) + 0.2 * n3(
            entity, relation, triples
        )
        expected += weight * len(triples) / factory.num_triples * loss
    assert found == pytest.approx(expected, rel=tolerance)


def test_outside_triples_place_an_entity_that_no_recipe_mentions(tmp_path):
    fruits, metals = ([f"{kind} {n}" for n in range(8)] for kind in ("fruit", "metal"))
    recipes = [("press", thing, "juice") for thing in fruits] + [
        ("hammer", thing, "tool") for thing in metals
    ]
    graph = RecipeGraph.from_recipes(recipes)
    new = [graph.entities.index(name) for name in ("fruit 7", "metal 7")]
    triples = recipe_triples(
        graph.recipes[~torch.isin(torch.tensor(graph.recipes), torch.tensor(new)).any(1).numpy()]
    )
    rows = [
        (thing, "isA", kind)
        for kind, things in (("food", fruits), ("ore", metals))
        for thing in things
    ]
    outside = read_outside([knowledge_folder(tmp_path, rows)], graph.entities)
    scorer = fitted(
        ComplExConfig(dim=16, n3=0.01, epochs=30, batch_size=16), graph, triples, outside
    )
    for tool, own, other in (("press", "fruit 7", "metal 7"), ("hammer", "metal 7", "fruit 7")):
        unknown = [label for label in graph.entities if label not in fruits[:7] + metals[:7]]
        scores = {label: scorer.score(tool, 0, label).item() for label in unknown}
        assert max(scores, key=scores.__getitem__) == own
        assert scores[own] > scores[other] + 0.5


def test_the_saved_model_holds_the_entities_and_the_two_relations_alone(joint, opened_kitchen):
    scorer, metrics = load_scorer(joint.folder), joint.metrics
    assert scorer.entities == opened_kitchen.graph.entities
    assert scorer.table(0).shape == (80, 80)
    assert "other:" not in (joint.folder / "vocabulary.json").read_text()
    assert (metrics.outside.triples, metrics.outside.nodes, metrics.outside.relations) == (3, 2, 2)
    assert metrics.outside.coverage == 2 / 80
    assert metrics.triples == len(opened_kitchen.split.partial)
    assert "3 outside triples, 2 relations, 2 nodes" in (joint.folder / "README.md").read_text()


@pytest.mark.slow
def test_each_fold_and_the_choice_of_weights_use_the_outside_triples(
    joint, opened_kitchen, outside
):
    graph, folds = opened_kitchen.graph, make_folds(opened_kitchen.split, 2)
    known = read_outside([outside], graph.entities)
    expected = fitted(SHORT, graph, folds.triples([0]), known)
    torch.testing.assert_close(
        load_scorer(joint.folder).left_out(0).table(1), expected.table(1), rtol=0, atol=0
    )
    assert not torch.equal(
        expected.table(1), fitted(SHORT, graph, folds.triples([0]), None).table(1)
    )
    settings = ComplExConfig(dim=4, epochs=1, negatives=0)
    assert choose(opened_kitchen, settings, silent, outside=known) != choose(
        opened_kitchen, settings, silent
    )


@pytest.mark.slow
def test_a_changed_knowledge_folder_is_refused_and_the_same_one_resumes(
    joint, opened_kitchen, outside, tmp_path
):
    copy = knowledge_folder(tmp_path / "outside", KITCHEN)
    stopped = train(
        opened_kitchen,
        replace(SHORT, with_=(copy,)),
        tmp_path / "model",
        progress=interrupt_after(2),
    )
    assert stopped.interrupted
    run = json.loads((Path(copy) / "run.json").read_text())
    assert read_run(stopped.folder).inputs["outside graph 1"] == run["outputs"]["triples.tsv"]
    knowledge_folder(Path(copy), KITCHEN[:2])
    with pytest.raises(WordCraftKGError, match="another outside graph 1"):
        resume(stopped.folder)
    knowledge_folder(Path(copy), KITCHEN)
    assert resume(stopped.folder).metrics.train_mrr == joint.metrics.train_mrr
    assert LinksConfig.read(stopped.folder).settings.with_ == (copy,)


def test_folders_share_nodes_and_relations(tmp_path):
    folders = [
        knowledge_folder(tmp_path / name, KITCHEN[start:])
        for name, start in (("one", 0), ("two", 1))
    ]
    both, one = read_outside(folders, ["egg"]), read_outside(folders[:1], ["egg"])
    assert (
        (both.nodes, both.relations)
        == (one.nodes, one.relations)
        == (("other:food", "flour", "other:bird"), ("isA", "partOf"))
    )
    assert both.triples.tolist() == one.triples.tolist() == [[0, 2, 1], [0, 3, 3], [2, 2, 1]]


@pytest.mark.parametrize(
    ("rows", "number", "message"),
    [
        ([], 0, "holds tables and no triples"),
        (
            [("ei", "isA", "essen"), ("mehl", "isA", "essen")],
            2,
            "none of the 3 nodes .* 80 entities",
        ),
        ([("egg", "combinesWith", "flour")], 1, "'combinesWith' is a relation of recipes"),
        ([("egg", "isA")], 1, "line 2: expected 3 columns"),
    ],
)
def test_a_folder_that_does_not_fit_is_refused(opened_kitchen, tmp_path, rows, number, message):
    settings = replace(SHORT, with_=(knowledge_folder(tmp_path / "outside", rows, number),))
    with pytest.raises(WordCraftKGError, match=message):
        train(opened_kitchen, settings, tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_a_path_that_is_no_knowledge_folder_and_a_weight_of_0_are_refused(opened_kitchen, tmp_path):
    with pytest.raises(ArtefactError, match="knowledge folder"):
        train(opened_kitchen, replace(SHORT, with_=("everyday",)), tmp_path / "model")
    with refuses("outside_weight"):
        ComplExConfig(outside_weight=0)
