"""Training into a model folder: determinism, interruption and resumption, early stopping, failures
and bad settings."""

import json
import re
import tomllib
import warnings
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import refuses, resume, write_graph
from link_helpers import (
    contents,
    equation_2,
    global_states,
    interrupt_after,
    interrupted,
    n3,
    random_graph,
    train,
)

from wordcraft_kg import (
    ComplExConfig,
    LinkModelConfig,
    LinksConfig,
    RecipeGraph,
    load_scorer,
    open_graph,
    open_model,
)
from wordcraft_kg.base import ArtefactError, ConfigError, TrainingError, WordCraftKGError, as_values
from wordcraft_kg.graphs import OpenedGraph, SplitConfig, make_split, recipe_triples
from wordcraft_kg.models.knowledge.knowledge_folder import (
    KnowledgeRecord,
    KnowledgeTables,
    write_knowledge,
)
from wordcraft_kg.models.links import fitting, link_training
from wordcraft_kg.models.links.builders import make_training_loop, scorer_tensors
from wordcraft_kg.models.links.fitting import (
    N3,
    POPULARITY,
    choose,
    fit,
    folds_of_train,
)
from wordcraft_kg.models.links.link_config import N3_PARTIAL, LinkSettings
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, read_outside, triples_factory
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.scorer_folder import make_scorer
from wordcraft_kg.runs.record import read_run

SHORT = ComplExConfig(dim=8, epochs=5, n3=0.1, folds=0)

RESUMED: dict[str, LinkSettings] = {
    "complex": SHORT,
    "complex with a sampled softmax": replace(SHORT, negatives=16, batch_size=100),
    "complex with a checkpoint each epoch": replace(SHORT, checkpoint_every=1),
    "distmult by softmax": LinkModelConfig(
        model="distmult", loop="symmetric", dim=4, epochs=5, folds=0
    ),
    "distmult by negatives": LinkModelConfig(
        model="distmult", dim=4, epochs=5, negatives=3, folds=0
    ),
    "rotate by negatives": LinkModelConfig(model="rotate", dim=4, epochs=5, negatives=3, folds=0),
}

FAST = ("complex", "rotate by negatives")

EACH = pytest.mark.parametrize(
    "config",
    [
        pytest.param(config, marks=[] if name in FAST else pytest.mark.slow)
        for name, config in RESUMED.items()
    ],
    ids=RESUMED,
)


def weights(trained):
    return (trained.folder / "model.safetensors").read_bytes()


def without_times(rows):
    return [
        {name: value for name, value in row.items() if not name.startswith("seconds")}
        for row in rows
    ]


def same(one, other):
    assert weights(one) == weights(other)
    assert (trace(one), figures(one)) == (trace(other), figures(other))
    assert sorted(contents(one.folder)) == sorted(contents(other.folder))
    return True


def trace(trained):
    return without_times(
        json.loads(line) for line in (trained.folder / "trace.jsonl").read_text().splitlines()
    )


def figures(trained):
    return without_times([as_values(trained.metrics)])


@EACH
def test_the_same_seed_gives_the_same_bytes_and_settings(parted_kitchen, tmp_path, config):
    """The same seed gives the same bytes without a warning and the settings are recorded."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        one, two = (train(parted_kitchen, config, tmp_path / name) for name in ("one", "two"))
    assert same(one, two)
    assert [str(warning.message) for warning in caught] == []
    recorded = LinksConfig.read(one.folder)
    assert recorded.settings == config.for_size(parted_kitchen.graph.num_entities)
    assert open_graph(recorded.graph).split.hash == parted_kitchen.split.hash


def test_the_global_generators_do_not_influence_a_training(opened_kitchen, tmp_path):
    models = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        models.append(train(opened_kitchen, SHORT, tmp_path / str(seed)))
    assert weights(models[0]) == weights(models[1])


def fail(*arguments, **settings):
    raise RuntimeError("no more")


ROTATE = RESUMED["rotate by negatives"]


@pytest.mark.parametrize(
    ("config", "end"),
    [
        (ROTATE, "interrupted"),
        *(
            pytest.param(config, end, marks=pytest.mark.slow)
            for config, end in (
                (SHORT, "done"),
                (SHORT, "interrupted"),
                (SHORT, "failed"),
                (ROTATE, "done"),
                (ROTATE, "failed"),
            )
        ),
    ],
)
def test_training_leaves_all_global_states_as_they_were(
    parted_kitchen, tmp_path, config, end, monkeypatch
):
    if end == "failed":
        monkeypatch.setattr(link_training, "write_scorer", fail)
    before = global_states()
    config = replace(config, threads=before["threads"] + 1)
    if end == "interrupted":
        interrupted(parted_kitchen, config, tmp_path / "model", 1)
    else:
        with pytest.raises(RuntimeError, match="no more") if end == "failed" else nullcontext():
            train(parted_kitchen, config, tmp_path / "model")
    assert read_run(tmp_path / "model").status == end
    assert global_states() == before


def test_a_finished_folder_holds_what_it_should_and_nothing_else(complex_folder):
    names = (
        "README.md",
        "config.toml",
        "metrics.json",
        "model.safetensors",
        "run.json",
        "trace.jsonl",
    )
    assert sorted(contents(complex_folder)) == sorted([*names, "vocabulary.json"])
    assert [path for path in complex_folder.iterdir() if path.is_dir()] == []


@pytest.mark.slow
def test_the_full_graph_trains_on_all_triples_and_remembers_them(opened_kitchen, tmp_path):
    trained = train(opened_kitchen, ComplExConfig(kg="full", dim=32, epochs=60), tmp_path / "model")
    assert (
        trained.metrics.triples
        == len(opened_kitchen.graph.triples)
        > len(opened_kitchen.split.partial)
    )
    assert trained.metrics.train_mrr > 0.9
    assert open_model(trained.folder).kg == "full"
    assert "test recipes" in (trained.folder / "README.md").read_text()


@EACH
def test_a_resumed_run_equals_an_undisturbed_one_bit_for_bit(parted_kitchen, tmp_path, config):
    folder = interrupted(parted_kitchen, config, tmp_path / "halves", 2)
    assert same(resume(folder), train(parted_kitchen, config, tmp_path / "whole"))


@pytest.mark.parametrize(("name", "value"), [("epochs", 7), ("epochs", 2), ("seed", 1), ("dim", 9)])
def test_an_unfinished_run_of_other_settings_is_refused(unfinished, opened_kitchen, name, value):
    """An unfinished run of other settings is refused by their name and stays."""
    before = contents(unfinished)
    with pytest.raises(ConfigError, match=f"`{name}` .* and this command has {value}"):
        train(opened_kitchen, replace(SHORT, **{name: value}), unfinished)
    assert contents(unfinished) == before


def test_resuming_on_another_split_is_an_error(tmp_path, opened_kitchen, parted_folder):
    folder = interrupted(opened_kitchen, SHORT, tmp_path / "model", 1)
    with pytest.raises(ConfigError, match="another split"):
        resume(folder, graph=str(parted_folder))


@pytest.fixture
def unfinished(opened_kitchen, tmp_path):
    return interrupted(opened_kitchen, SHORT, tmp_path / "model", 1)


NO_GPU = pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")


@pytest.mark.parametrize(
    ("config", "match"),
    [
        *(
            (replace(SHORT, device=name), f"`device` {name!r}")
            for name in ("nonsense", "cpu:x", "", "meta")
        ),
        pytest.param(replace(SHORT, device="cuda"), "^`device` 'cuda'.*Use cpu", marks=NO_GPU),
        (
            LinkModelConfig(model="rotat", dim=4),
            "'rotat': expected one of .*distmult.*Did you mean 'rotate'",
        ),
        *(
            (LinkModelConfig(model=name, dim=4, epochs=1), f"'{name}'")  # needs more than triples
            for name in ("nodepiece", "inductivenodepiece", "compgcn", "distmultliteral")
        ),
    ],
)
def test_settings_that_cannot_be_met_are_refused_by_name_and_leave_nothing(
    opened_kitchen, tmp_path, config, match
):
    with pytest.raises(ConfigError, match=match):
        train(opened_kitchen, config, tmp_path / "model")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("model", ["TransE", "tucker", "rescal", "rgcn", "conve", "quate"])
def test_other_models_train_and_load(opened_kitchen, tmp_path, model):
    config = LinkModelConfig(model=model, dim=8, epochs=1, negatives=2, folds=0)
    scorer = load_scorer(
        train(opened_kitchen, config, tmp_path / "model").folder, graph=opened_kitchen.graph
    )
    assert scorer.table("combinesWith").shape == (80, 80)
    assert torch.isfinite(scorer.table("componentOf")).all()


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["slcwa", "symmetric"])
def test_every_model_of_pykeen_trains_or_is_refused_clearly(opened_kitchen, tmp_path, loop):
    from pykeen.models import model_resolver

    crashed = {}
    for model in sorted(model_resolver.lookup_dict):
        config = LinkModelConfig(model=model, dim=8, epochs=1, negatives=2, loop=loop)
        try:
            load_scorer(train(opened_kitchen, config, tmp_path / model).folder)
        except ConfigError:
            continue
        except Exception as error:
            crashed[model] = repr(error)
    assert crashed == {}


def test_a_graph_without_a_split_has_no_partial_graph_to_train_on(tmp_path):
    opened = open_graph(write_graph(tmp_path / "graph", "paper-examples", kind="none"))
    with refuses("kg"):
        train(opened, SHORT, tmp_path / "model")
    trained = train(opened, replace(SHORT, kg="full"), tmp_path / "model")
    assert trained.metrics.triples == len(opened.graph.triples)


def test_a_diverging_training_is_a_clear_error_and_leaves_nothing(opened_kitchen, tmp_path):
    with refuses("learning_rate", TrainingError):
        train(opened_kitchen, replace(SHORT, learning_rate=1e30), tmp_path / "model")
    assert not list(tmp_path.iterdir())


def test_a_misspelt_model_leaves_an_unfinished_run_alone(opened_kitchen, tmp_path):
    folder = interrupted(opened_kitchen, SHORT, tmp_path / "model", 2)
    with refuses("model"):
        train(opened_kitchen, LinkModelConfig(model="nosuch"), tmp_path / "model", force=True)
    assert (folder / "checkpoints" / "epoch-3.json").exists()


NAN, INF = float("nan"), float("inf")

BOTH = (ComplExConfig, LinkModelConfig)

OUT_OF_RANGE = {
    "kg": ["half"],
    "epochs": [0, -3],
    **{name: [0] for name in ("batch_size", "checkpoint_every", "threads", "dim")},
    "seed": [-1, 2**32],
    "learning_rate": [0.0, -1.0, NAN, INF],
}


@pytest.mark.parametrize(
    ("config", "setting", "value"),
    [
        *(
            (config, name, value)
            for config in BOTH
            for name, values in OUT_OF_RANGE.items()
            for value in values
        ),
        *(
            (ComplExConfig, name, value)
            for name in ("n3", "popularity")
            for value in (-1.0, NAN, INF)
        ),
        *((ComplExConfig, "init_scale", value) for value in (0.0, -1e-3, NAN, INF)),
        *((ComplExConfig, "negatives", value) for value in (-1, 1.5, True)),
        (LinkModelConfig, "negatives", 0),
        (LinkModelConfig, "loop", "lcwa"),
    ],
)
def test_a_setting_out_of_range_is_an_error_that_names_it_and_its_value(config, setting, value):
    with pytest.raises(ConfigError, match=re.escape(f"`{setting}` {value!r}: expected")):
        config(**{setting: value})


@pytest.mark.parametrize("config", BOTH)
def test_the_least_allowed_settings_are_allowed(config):
    least = {
        "epochs": 1,
        "batch_size": 1,
        "checkpoint_every": 1,
        "threads": 1,
        "dim": 1,
        "seed": 0,
    }
    assert vars(replace(config(), **least)).items() >= least.items()


def test_regularisation_is_off_on_full_and_open_on_partial():
    """The regularisation is off by default on the full graph and open on the partial."""
    full, partial = ComplExConfig(kg="full"), ComplExConfig(kg="partial")
    assert (full.n3, full.popularity) == (0, 0)
    assert (partial.n3, partial.popularity) == (None, None)
    assert (partial.fixed().n3, partial.fixed().popularity) == (N3_PARTIAL, 0)


@pytest.mark.parametrize(
    ("given", "n3", "popularity"), [({"n3": 0.3}, 0.3, 0), ({"popularity": 2.0}, N3_PARTIAL, 2)]
)
def test_naming_one_part_of_the_regularisation_fixes_the_other(given, n3, popularity):
    config = ComplExConfig(**given)
    assert (config.n3, config.popularity) == (n3, popularity)
    assert config.fixed() == config


def test_a_config_file_fills_the_defaults_of_settings_that_it_lacks(tmp_path):
    (tmp_path / "config.toml").write_text('[train-complex]\ngraph = "kitchen"\ndim = 5\n')
    assert LinksConfig.read(tmp_path) == LinksConfig("kitchen", ComplExConfig(dim=5))


@pytest.mark.parametrize("name", ['"', "\\", "\t", "\x1b", "\x7f", "é", "😀"], ids=repr)
def test_any_name_of_a_graph_is_read_again(tmp_path, name):
    config = LinksConfig(f"{name}kitchen", ComplExConfig(dim=5))
    config.write(tmp_path)
    assert LinksConfig.read(tmp_path) == config


TABLE = '[train-complex]\ngraph = "kitchen"\n'


@pytest.mark.parametrize(
    "text",
    [
        None,
        "",
        "not toml",
        "\udcff\udcfe",
        *(f"{TABLE}{line}\n" for line in ("epoch = 3", "epochs = 0", 'epochs = "ten"')),
        f'{TABLE}[train-links]\ngraph = "kitchen"\n',
        *("[train-complex]\nepochs = 3\n", "[train-complex]\ngraph = 3\n"),
        *('[train-magic]\ngraph = "kitchen"\n', 'train-complex = "kitchen"\n'),
    ],
    ids=repr,
)
def test_a_missing_or_damaged_config_file_is_an_error_that_names_it(tmp_path, text):
    if text is not None:
        (tmp_path / "config.toml").write_bytes(text.encode(errors="surrogateescape"))
    says = "is missing" if text is None else "(is damaged|: this version has no setting 'epoch')"
    with pytest.raises(ArtefactError, match=rf"config\.toml ?{says}"):
        LinksConfig.read(tmp_path)


Rows = list[tuple[str, ...]]

KITCHEN: Rows = [
    ("egg", "isA", "other:food"),
    ("flour", "isA", "other:food"),
    ("egg", "partOf", "other:bird"),
]

JOINT_TRAINING_SHORT = ComplExConfig(dim=8, epochs=4, n3=0.01, folds=2)


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
        replace(JOINT_TRAINING_SHORT, with_=(outside,)),
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
    assert "outside triples: 3, relations: 2, nodes" in (joint.folder / "README.md").read_text()


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
        ([("egg", "isA")], 1, "lines of other than 3 columns"),
    ],
)
def test_a_folder_that_does_not_fit_is_refused(opened_kitchen, tmp_path, rows, number, message):
    """Also beside a folder that fits."""
    folders = (
        knowledge_folder(tmp_path / "fits", [("egg", "isA", "food")], 1),
        knowledge_folder(tmp_path / "outside", rows, number),
    )
    settings = replace(JOINT_TRAINING_SHORT, with_=folders)
    with pytest.raises(WordCraftKGError, match=message):
        train(opened_kitchen, settings, tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_a_path_that_is_no_knowledge_folder_and_a_weight_of_0_are_refused(opened_kitchen, tmp_path):
    with pytest.raises(ArtefactError, match="knowledge folder"):
        train(
            opened_kitchen, replace(JOINT_TRAINING_SHORT, with_=("everyday",)), tmp_path / "model"
        )
    with refuses("outside_weight"):
        ComplExConfig(outside_weight=0)


OPEN = ComplExConfig(dim=8, epochs=5)


def chosen(opened, settings):
    return choose(opened, settings, silent, recipes=opened.split.sets("train"))


def of_train(split, seed=3):
    (fold,) = folds_of_train(split, split.sets("train"), seed, 1)
    return fold


def opened(graph, **settings):
    return OpenedGraph(graph, make_split(graph, SplitConfig(**settings)), "here")


@pytest.fixture(scope="module")
def choice(opened_kitchen):
    return chosen(opened_kitchen, OPEN)


def test_the_most_cautious_of_the_good_combinations_is_chosen(choice):
    """Every combination is a candidate and the most cautious of the good ones is chosen."""
    assert {(found.n3, found.popularity) for found in choice.candidates} == {
        (n, p) for n in N3 for p in POPULARITY
    }
    best = max(found.mrr for found in choice.candidates)
    good = [found for found in choice.candidates if found.mrr >= 0.95 * best]
    most = max(found.popularity for found in good)
    chosen = max((found for found in good if found.popularity == most), key=lambda found: found.mrr)
    assert (choice.n3, choice.popularity, choice.mrr) == (chosen.n3, chosen.popularity, chosen.mrr)
    assert len({found.mrr for found in choice.candidates}) > len(N3)


def test_the_same_seed_chooses_the_same(opened_kitchen, choice):
    assert chosen(opened_kitchen, OPEN) == choice
    assert chosen(opened_kitchen, replace(OPEN, seed=7)) != choice


def test_only_train_recipes_are_held_out(opened_kitchen):
    split = opened_kitchen.split
    fold = of_train(split)
    np.testing.assert_array_equal(fold.graph.recipes, split.recipes("train"))
    assert fold.graph.entities == split.graph.entities
    assert len(fold.held_out("test"))


def test_a_split_by_goal_holds_out_goals_of_train(kitchen):
    fold = of_train(make_split(kitchen, SplitConfig("by-goal")))
    assert fold.config.kind == "by-goal"
    assert not set(fold.recipes("train")[:, 2]) & set(fold.recipes("test")[:, 2])


def test_the_figures_are_those_of_a_ranking_of_what_was_held_out(opened_kitchen, monkeypatch):
    monkeypatch.setattr(fitting, "FOLDS", 1)
    found = chosen(opened_kitchen, OPEN)
    fold = of_train(opened_kitchen.split, OPEN.seed)

    def mrr(scorer):
        return mean_reciprocal_rank(rank_triples(scorer, fold.held_out("test"), fold.graph.triples))

    for candidate in found.candidates[::3]:
        settings = replace(OPEN, n3=candidate.n3, popularity=candidate.popularity, epochs=1)
        model = fit(settings, triples_factory(fold.graph, fold.partial), lambda epoch: None)
        scorer = make_scorer(
            *scorer_tensors(settings, model, fold.partial), fold.graph.entities, fold.graph.hash
        )
        assert candidate.mrr == pytest.approx(mrr(scorer))


@pytest.mark.parametrize(
    "settings",
    [
        replace(OPEN, n3=0.1),
        ComplExConfig(popularity=1.0),
        ComplExConfig(kg="full"),
        LinkModelConfig(),
    ],
    ids=["n3", "popularity", "full", "another model"],
)
def test_what_is_given_or_does_not_exist_is_not_chosen(opened_kitchen, settings):
    assert chosen(opened_kitchen, settings) is None


def test_a_large_book_chooses_its_popularity_only_on_one_fold_and_a_sample(
    opened_kitchen, monkeypatch
):
    monkeypatch.setattr(fitting, "SMALL", 0)
    monkeypatch.setattr(fitting, "RANKED", 40)
    found = chosen(opened_kitchen, replace(OPEN, negatives=16))
    assert {(one.n3, one.popularity) for one in found.candidates} == {
        (N3_PARTIAL, p) for p in POPULARITY
    }
    assert found.queries == 80


def test_a_book_with_too_little_to_hold_out_keeps_the_fixed_default():
    assert chosen(opened(random_graph(num_entities=6, num_recipes=8)), OPEN) is None
    once = [
        (f"a{i}", f"b{i}", f"c{i}") for i in range(40)
    ]  # nothing can be held out without losing an entity
    graph = RecipeGraph.from_recipes(once, name="once")
    assert chosen(opened(graph, kind="none"), OPEN) is None


@pytest.mark.slow
def test_a_run_records_what_was_chosen_and_from_what(opened_kitchen, tmp_path, choice):
    trained = train(opened_kitchen, OPEN, tmp_path / "model")
    assert trained.metrics.choice == choice
    config = tomllib.loads((trained.folder / "config.toml").read_text())["train-complex"]
    assert (config["n3"], config["popularity"]) == (choice.n3, choice.popularity)
    assert "choice.json" in json.loads((trained.folder / "run.json").read_text())["inputs"]
    assert json.loads((trained.folder / "choice.json").read_text())["mrr"] == choice.mrr
    assert str(choice) in (trained.folder / "README.md").read_text()
    assert str(choice) in open_model(trained.folder).provenance.values()


@pytest.mark.slow
def test_a_resumed_run_does_not_choose_again(opened_kitchen, tmp_path, monkeypatch):
    settings = replace(OPEN, epochs=10)
    undisturbed = train(opened_kitchen, settings, tmp_path / "undisturbed")
    interrupted(opened_kitchen, settings, tmp_path / "model", 4)
    monkeypatch.setattr(link_training, "choose", lambda *arguments: pytest.fail("chosen again"))
    resumed = resume(tmp_path / "model")
    assert resumed.metrics.choice == undisturbed.metrics.choice is not None
    weights = [
        (folder / "model.safetensors").read_bytes()
        for folder in (resumed.folder, undisturbed.folder)
    ]
    assert weights[0] == weights[1]


def test_ctrl_c_while_choosing_leaves_nothing(opened_kitchen, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        train(opened_kitchen, OPEN, tmp_path / "model", progress=interrupt_after(0))
    assert list(tmp_path.iterdir()) == []
