import json
import logging
import math
from collections import defaultdict
from dataclasses import replace
from itertools import combinations

import graph_oracles as oracles
import numpy as np
import pytest
from graph_strategies import configs, splittable_graphs
from helpers import refuses
from hypothesis import assume, given

from wordcraft_kg.base.errors import (
    ArtefactError,
    ConfigError,
    NotRegisteredError,
    SplitError,
)
from wordcraft_kg.graphs import (
    PARTS,
    RELATIONS,
    SPLITS,
    RecipeBook,
    RecipeGraph,
    Split,
    SplitConfig,
    audit,
    default_split,
    make_folds,
    make_split,
    open_graph,
    write_graph_folder,
)
from wordcraft_kg.graphs.splits import SplitKind, groups_of, read_published_split, read_split

HELD_OUT_KINDS = [
    kind for kind in SPLITS if kind not in ("none", "by-kind")
]  # the kitchen names no kinds


def drawn(graph, config):
    """Split, or give the example up where the graph is too small for it."""
    try:
        return make_split(graph, config)
    except SplitError:
        assume(False)
        raise


def parts_by(split, key):
    """The parts of all recipes of a pair, a result or, with "kind", a kind."""
    graph = split.graph
    keys = graph.kinds if key == "kind" else [recipe[key] for recipe in graph.recipe_labels()]
    parts = defaultdict(set)
    for one, part in zip(keys, split.parts.tolist(), strict=True):
        parts[one].add(part)
    return parts


def on_every_split(test):
    """Run a property on random graphs for each kind of split."""

    @pytest.mark.hypothesis  # which hypothesis does not see from outside
    @pytest.mark.parametrize("kind", SPLITS)
    def run(kind):
        @given(splittable_graphs(), configs(kind))
        def check(graph, config):
            test(drawn(graph, config))

        check()

    run.__name__ = test.__name__
    return run


@on_every_split
def test_every_recipe_is_in_exactly_one_part(split):
    recipes = [
        recipe for part in PARTS for recipe in split.graph.recipe_labels(split.recipes(part))
    ]
    assert sorted(recipes) == split.graph.recipe_labels()


@on_every_split
def test_full_partial_and_unseen_triples_follow_from_the_recipes(split):
    train = oracles.triples(split.graph.recipe_labels(split.recipes("train")))
    full = oracles.triples(split.graph.recipe_labels())
    assert set(oracles.labelled(split.graph, split.partial)) == train
    assert set(oracles.labelled(split.graph, split.unseen)) == full - train
    assert len(split.partial) + len(split.unseen) == len(split.graph.triples) == len(full)


@on_every_split
def test_held_out_triples_are_those_that_no_earlier_part_gives(split):
    of = {part: oracles.triples(split.graph.recipe_labels(split.recipes(part))) for part in PARTS}
    assert set(oracles.labelled(split.graph, split.triples_of("test"))) == of["test"]
    assert set(oracles.labelled(split.graph, split.held_out("valid"))) == of["valid"] - of["train"]
    assert (
        set(oracles.labelled(split.graph, split.held_out("test")))
        == of["test"] - of["train"] - of["valid"]
    )


@on_every_split
def test_each_triple_belongs_to_the_first_part_that_gives_it(split):
    of = [oracles.triples(split.graph.recipe_labels(split.recipes(part))) for part in PARTS]
    size = min(split.graph.num_entities, 8)
    grid = np.stack(np.meshgrid(range(size), range(2), range(size)), axis=-1).reshape(-1, 3)
    triples = np.concatenate([split.graph.triples, grid])
    names = split.graph.entities
    for (head, relation, tail), part in zip(
        triples.tolist(), split.part_of(triples).tolist(), strict=True
    ):
        triple = (names[head], RELATIONS[relation], names[tail])
        assert part == next((i for i, given_by in enumerate(of) if triple in given_by), -1)


def mentioned(graph, ids=None):
    return {label for recipe in graph.recipe_labels(ids) for label in recipe}


@on_every_split
def test_uncovered_entities_and_pairs_on_both_sides_are_counted(split):
    covered = mentioned(split.graph, split.recipes("train"))
    assert set(split.graph.labels(split.uncovered)) == set(split.graph.entities) - covered
    assert split.pairs_on_both_sides == sum(
        len(parts) > 1 for parts in parts_by(split, slice(2)).values()
    )


@on_every_split
def test_a_split_made_again_or_read_back_from_its_json_is_the_same(split):
    for again in (
        read_split(json.loads("".join(split.to_json())), split.graph),
        make_split(split.graph, split.config),
    ):
        assert np.array_equal(again.parts, split.parts)
        assert (again.config, again.hash) == (split.config, split.hash)
        assert again.moved_for_coverage == split.moved_for_coverage


@given(splittable_graphs(), configs("by-recipe"))
def test_by_recipe_moves_whole_pairs_until_all_is_covered(graph, config):
    """A by recipe split moves whole pairs to train until every entity is covered."""
    split, plain = drawn(graph, config), drawn(graph, replace(config, kind="by-recipe-plain"))
    assert all(len(parts) == 1 for parts in parts_by(split, slice(2)).values())
    assert set(graph.labels(split.uncovered)) == set(graph.entities) - mentioned(graph)
    moved = split.parts != plain.parts
    assert split.moved_for_coverage == np.sum(moved)
    assert not np.any(split.parts[moved])


@pytest.mark.parametrize(
    ("kind", "key"), [("by-recipe-plain", slice(2)), ("by-goal", 2), ("by-kind", "kind")]
)
@given(graph=splittable_graphs(), config=configs("by-goal"))
def test_pairs_goals_and_kinds_are_held_out_whole_in_exact_shares(kind, key, graph, config):
    sides = [
        tuple(parts) for parts in parts_by(drawn(graph, replace(config, kind=kind)), key).values()
    ]
    assert all(len(side) == 1 for side in sides)
    assert sides.count((0,)) == round(config.train_ratio * len(sides))
    assert sides.count((1,)) == round(config.valid_ratio * len(sides))


@given(splittable_graphs(), configs("by-slot"))
def test_by_slot_never_repeats_an_ingredient_with_its_result(graph, config):
    """In a by slot split no ingredient and result of a held out recipe occur in an earlier part."""
    split = drawn(graph, config)
    seen = [
        {(x, r.result) for r in graph.recipe_labels(split.recipes(part)) for x in r[:2]}
        for part in PARTS
    ]
    assert not any(one & other for one, other in combinations(seen, 2))


@given(splittable_graphs(), configs("by-slot"))
def test_by_slot_groups_are_smallest_and_in_exact_shares(graph, config):
    """The groups of a by slot split are as small as they can be and drawn in exact shares."""
    # Merge groups that share a slot until none do: a slow search for the connected components.
    groups = [
        ({row}, {(x, r.result) for x in r[:2]}) for row, r in enumerate(graph.recipe_labels())
    ]
    while found := next(((g, h) for g, h in combinations(groups, 2) if g[1] & h[1]), None):
        groups = [g for g in groups if g not in found] + [
            tuple(one | other for one, other in zip(*found, strict=True))
        ]
    slots, parts = groups_of(graph, "by-slot"), drawn(graph, config).parts
    assert {frozenset(np.flatnonzero(slots == slot).tolist()) for slot in slots} == {
        frozenset(g) for g, _ in groups
    }
    sides = [set(parts[list(rows)].tolist()) for rows, _ in groups]
    assert all(len(side) == 1 for side in sides)
    assert sides.count({0}) == round(config.train_ratio * len(groups))
    assert sides.count({1}) == round(config.valid_ratio * len(groups))


@pytest.mark.parametrize("kind", HELD_OUT_KINDS)
def test_another_seed_gives_another_split(kitchen, kind):
    hashes = {make_split(kitchen, SplitConfig(kind, seed=seed)).hash for seed in range(5)}
    assert len(hashes) == 5


def test_the_hash_of_a_split_covers_its_graph(kitchen):
    other = RecipeGraph(kitchen.entities, kitchen.recipes, [0])
    one, two = make_split(kitchen, SplitConfig()), make_split(other, SplitConfig())
    assert np.array_equal(one.parts, two.parts)
    assert one.hash != two.hash


def test_a_split_needs_one_function_the_groups_of_recipes(kitchen, monkeypatch):
    def first_letters(graph):
        return np.array([ord(graph.entities[result][0]) for result in graph.recipes[:, 2]])

    monkeypatch.setitem(SPLITS, "by-letter", SplitKind(first_letters, "by first letter"))
    split = make_split(kitchen, SplitConfig("by-letter", train_ratio=0.7, valid_ratio=0.1))
    letters = [
        {kitchen.entities[result][0] for result in split.recipes(part)[:, 2]} for part in PARTS
    ]
    assert all(letters)
    assert sum(map(len, letters)) == len(set.union(*letters))
    folds = make_folds(split, 3)
    of_letter = {}
    for row in np.flatnonzero(split.is_in("train")):
        letter = kitchen.entities[kitchen.recipes[row, 2]][0]
        assert of_letter.setdefault(letter, folds.of_recipe[row]) == folds.of_recipe[row]
    content = json.loads("".join(split.to_json()))
    assert read_split(content, kitchen).hash == split.hash
    # Another process does not know the split; its folder is whole.
    monkeypatch.delitem(SPLITS, "by-letter")
    with pytest.raises(NotRegisteredError, match=r"'by-letter.*--plugin"):
        read_split(content, kitchen)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("train_ratio", ratio) for ratio in (0.0, 1.0, -0.1, 1.5, math.nan, math.inf)],
        *[
            ("valid_ratio", ratio) for ratio in (-0.1, 0.2, 0.3, 1.0, math.nan)
        ],  # of train and test together, or more
        ("seed", -1),
        ("kind", "by-goals"),
    ],
)
def test_a_setting_outside_its_range_is_refused(name, value):
    with refuses(name, NotRegisteredError if name == "kind" else ConfigError):
        SplitConfig(**{name: value})


@pytest.mark.parametrize("kind", ["by-recipe", "by-recipe-plain", "by-slot", "by-goal"])
def test_a_graph_too_small_for_the_ratios_is_refused(kind):
    graph = RecipeGraph.from_recipes([("a", "b", "c")])
    with pytest.raises(
        SplitError,
        match=rf"the test part of a {kind} split of 1 recipe in 1 group is empty; .*`kind` none",
    ):
        make_split(graph, SplitConfig(kind))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"format": "wordcraft-kg split 9"},
            "has the format 'wordcraft-kg split 9'; expected 'wordcraft-kg split 1'",
        ),
        ({"train": []}, "its content does not match its hash"),
        (
            lambda parts: parts["test"].append(parts["train"].pop()),
            "its content does not match its hash",
        ),
        (lambda parts: parts["train"].append(parts["test"][0]), r"split\.json is damaged"),
        ({"test": [["seed", "water", "gold"]]}, "is damaged .*gold"),
        ({"test": [["seed"]]}, "is damaged .*TypeError"),
        ({"train_ratio": 7}, "is damaged .*`train_ratio` 7"),
        ({"kind": ["by-mood"]}, "is damaged .*by-mood"),
        ({"hash": "0"}, "its content does not match its hash"),
        ({"valid": None}, r"split\.json is damaged \(KeyError: 'valid'\)\. Build the graph again"),
    ],
)
def test_a_damaged_split_is_refused(kitchen, change, message):
    content = json.loads("".join(make_split(kitchen, SplitConfig()).to_json()))
    if callable(change):
        change(content)
    else:
        content |= change
    with pytest.raises(ArtefactError, match=message):
        read_split({key: value for key, value in content.items() if value is not None}, kitchen)


def test_by_kind_needs_a_book_with_kinds(kitchen):
    with pytest.raises(SplitError, match="names no kinds of recipes"):
        make_split(kitchen, SplitConfig("by-kind"))


def test_the_hash_of_a_split_by_kind_covers_the_kinds():
    graphs = [open_graph("everyday").graph for _ in range(2)]
    graphs[1].kinds = graphs[1].kinds[::-1]
    parts = np.zeros(graphs[0].num_recipes, dtype=np.int8)
    hashes = {Split(graph, SplitConfig("by-kind"), parts).hash for graph in graphs}
    assert len(hashes) == 2


@pytest.mark.parametrize("train_ratio", [0.1, 0.8])
def test_a_test_part_that_the_cover_of_entities_empties_names_this_cause(train_ratio):
    # Each recipe has three entities of its own, so no recipe can be held out.
    graph = RecipeGraph.from_recipes([(f"a{i}", f"b{i}", f"c{i}") for i in range(30)])
    drawn = 30 - round(train_ratio * 30) - round(0.1 * 30)
    with pytest.raises(SplitError) as error:
        make_split(graph, SplitConfig("by-recipe", train_ratio, 0.1))
    assert "moved to train, so that train covers every entity" in str(error.value)
    assert "`kind` by-recipe-plain moves none" in str(error.value)
    plain = make_split(graph, SplitConfig("by-recipe-plain", train_ratio, 0.1))
    assert len(plain.recipes("test")) == drawn


ROWS = [
    ("water", "earth", "mud"),
    ("rain", "earth", "mud"),
    ("mud", "straw", "fire", "brick"),
    ("brick", "brick", "wall"),
]

GRAPH = RecipeGraph.from_recipes(ROWS)

FILES = {
    "results.json": json.dumps({"train": ["mud", "brick"], "test": ["wall"]}),
    "recipes.json": json.dumps({"train": ROWS[:3], "test": ROWS[3:]}),
    "sets.json": json.dumps(
        {
            "train": {"mud": [["earth", "water"], ["earth", "rain"]], "brick": [ROWS[2][:-1]]},
            "test": {"wall": [["brick", "brick"]], "gold": [["lead", "stone"]]},
        }
    ),
}


def read(tmp_path, text, graph=GRAPH, name="split.json"):
    path = tmp_path / name
    path.write_text(text)
    return read_published_split(path, graph)


@pytest.mark.parametrize("name", FILES)
def test_a_published_split_is_read_from_results_recipes_or_sets(tmp_path, name):
    split = read(tmp_path, FILES[name], name=name)
    parts = {recipe: split.parts[row] for row, recipe in enumerate(GRAPH.recipe_labels())}
    assert {recipe for recipe, part in parts.items() if part == 2} == {("brick", "brick", "wall")}
    assert (split.config.kind, split.config.train_ratio) == ("by-goal", 0.75)
    assert (split.published.file, split.published.unknown) == (name, int(name == "sets.json"))


def test_a_published_split_by_recipe_has_three_parts(tmp_path):
    content = {"train": [ROWS[0], ROWS[3]], "val": [ROWS[2]], "test": [ROWS[1]]}
    split = read(tmp_path, json.dumps(content))
    assert (split.config.kind, np.bincount(split.parts).tolist()) == ("by-recipe-plain", [2, 1, 1])


def test_a_published_split_survives_a_folder_and_is_named_in_the_audit(tmp_path):
    split = read(tmp_path, FILES["results.json"])
    same_parts = read(tmp_path, FILES["recipes.json"])
    assert split.hash != same_parts.hash  # two files
    book = RecipeBook.of("published", ROWS)
    write_graph_folder(tmp_path / "graph", book, split)
    opened = open_graph(tmp_path / "graph")
    assert (opened.split.hash, opened.split.published) == (split.hash, split.published)
    assert audit(GRAPH, opened.split).split.published == split.published
    path = tmp_path / "graph" / "split.json"
    path.write_text(path.read_text().replace(split.published.sha256, "0" * 64))
    with pytest.raises(ArtefactError, match="does not match its hash"):
        open_graph(tmp_path / "graph")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"train": ["mud", "brick"], "test": ["mud", "wall"]}', r"-> mud is in train and test"),
        ('{"train": ["mud"], "test": ["wall"]}', r"1 recipe of 4 without a part, such as fire \+"),
        ('{"train": ["mud", "wall", "brick"], "test": []}', "test part has no recipe"),
        ('{"a": ["mud"]}', "no split .*expected JSON"),
        ('{"train": [1]}', "no split"),
        ('{"train": [[["water"], "mud"]], "test": ["wall"]}', "Expected `str`, got `array`"),
        ('{"train": [{"mud": 1}], "test": ["wall"]}', "got `object`"),
        ('{"train": [[]], "test": ["wall"]}', "Expected `array` of length >= 1"),
        ('{"train": {"mud": [[]]}, "test": ["wall"]}', "Expected `array` of length >= 1"),
        ('{"train": {"mud": ["water", "earth"]}, "test": ["wall"]}', "Expected `array`, got `str`"),
        ('{"train": ["mud"], "train": ["brick"], "test": ["wall"]}', "'train' occurs twice"),
        ('{"train": ' + 10_000 * "[" + 10_000 * "]" + "}", "nested too deeply"),
        ("part,result\ntrain,mud\n", "no split .*expected JSON"),
    ],
)
def test_a_wrong_split_file_is_refused(tmp_path, text, says):
    with pytest.raises(SplitError, match=says):
        read(tmp_path, text)


def test_a_table_of_results_with_one_recipe_each_is_split_by_goal(caplog):
    rows = [(f"a{i}", f"b{i % 7}", f"c{i % 5}", f"made {i}") for i in range(100)]
    with caplog.at_level(logging.WARNING):
        split = default_split(RecipeGraph.from_recipes(rows))
    assert split.config == SplitConfig("by-goal")
    assert "100 of 100 recipes are the only one of their result" in caplog.text
    few = default_split(RecipeGraph.from_recipes(rows[:99]))
    repeated = default_split(
        RecipeGraph.from_recipes([*rows, *((*row[:2], row[3]) for row in rows)])
    )
    assert few.config.kind == "none"  # by-recipe keeps all of them in train
    assert repeated.config.kind == "by-recipe"


def test_the_audit_counts_sets_and_pairs_that_train_knows():
    rows = [
        ("a", "b", "c", "r"),
        ("a", "b", "r"),
        ("a", "a", "b", "c", "d", "r"),
        ("a", "c", "s"),
        ("b", "c", "t"),
        ("x", "r"),
    ]
    graph = RecipeGraph.from_recipes(rows)
    split = make_split(graph, SplitConfig("none"))
    parts = np.array(
        [2 if len(recipe) > 3 else 0 for recipe in graph.recipe_labels()], dtype=np.int8
    )
    sets = audit(graph, Split(graph, split.config, parts)).sets
    assert sets.recipes_by_number_of_ingredients == {"1": 1, "2": 3, "3": 1, "5": 1}
    # Train combines a + b, a + c and b + c: all pairs of one set, and none with d or a + a.
    assert (sets.test_sets, sets.with_a_train_pair, sets.of_train_pairs) == (2, 2, 1)


def test_a_graph_of_pairs_has_no_statistics_of_sets(kitchen):
    assert audit(kitchen, make_split(kitchen, SplitConfig())).sets is None
