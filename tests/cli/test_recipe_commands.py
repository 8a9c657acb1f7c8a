"""Recipe scores on the command line: what a pair makes, why, what is remembered, and why an agent
picked something."""

import pytest
import torch

from wordcraft_kg import load_scorer, open_graph
from wordcraft_kg.evaluation.queries import RecipeQuery, parse_query

LABELS = {"flour", "water", "dough", "cocoa bean", "c++", "_x", "a->b"}
NOTE = "the scorer was trained on this recipe"


@pytest.fixture(scope="module")
def scorer(recipes_folder):
    return load_scorer(recipes_folder).whole


def in_part(part):
    """A recipe of the kitchen that is in a part."""
    opened = open_graph("kitchen")
    a, b, result = opened.graph.labels(opened.split.recipes(part)[3])
    return a, b, result


@pytest.mark.parametrize(
    ("words", "slots"),
    [
        (["flour", "+", "water"], ("flour", "water", None)),
        (["flour+water"], ("flour", "water", None)),
        (["flour + water"], ("flour", "water", None)),
        (["flour", "+", "water", "="], ("flour", "water", None)),
        (["flour", "+", "water", "=", "_"], ("flour", "water", None)),
        (["flour", "+", "water", "dough"], ("flour", "water", "dough")),
        (["flour", "+", "water", "=", "dough"], ("flour", "water", "dough")),
        (["flour", "+", "water", "→", "dough"], ("flour", "water", "dough")),
        (["flour + water -> dough"], ("flour", "water", "dough")),
        (["flour+water=dough"], ("flour", "water", "dough")),
        (["_", "+", "water", "dough"], (None, "water", "dough")),
        (["water", "+", "?", "=", "dough"], ("water", None, "dough")),
        (["_+water=dough"], (None, "water", "dough")),
        (["cocoa bean", "+", "water"], ("cocoa bean", "water", None)),
        (["cocoa bean+water=cocoa bean"], ("cocoa bean", "water", "cocoa bean")),
        (["c++", "+", "a->b", "_x"], ("c++", "a->b", "_x")),
    ],
)
def test_a_recipe_may_be_written_in_many_ways(words, slots):
    assert parse_query(words, LABELS).slots == slots


@pytest.mark.parametrize(
    ("words", "kind", "said"),
    [
        (
            ["flour", "+", "waater"],
            "UnknownEntityError",
            "no entity 'waater'. Did you mean 'water'",
        ),
        (["_", "+", "water"], "ConfigError", "_ + water = _ has several open slots"),
        (["_", "+", "_", "=", "dough"], "ConfigError", "_ + _ = dough has several open slots"),
        (["flour", "+"], "ConfigError", "cannot parse recipe 'flour +'"),
        (["flour", "water", "+"], "ConfigError", "cannot parse recipe 'flour water +'"),
        (["flour", "+", "water", "+", "dough"], "ConfigError", "cannot parse recipe"),
        (
            ["flour", "+", "water", "dough", "bread"],
            "ConfigError",
            "Quote labels with several words",
        ),
        (["flour", "combinesWith", "water", "+"], "ConfigError", "cannot parse query"),
        (["flour"], "ConfigError", "a recipe such as a + b"),
        (["flour", "+", "water-"], "UnknownEntityError", "no entity 'water-'"),
    ],
)
def test_what_is_no_recipe_is_said(refused, recipes_folder, words, kind, said):
    assert said in refused("score", recipes_folder, *words, kind=kind)


def test_an_arrow_that_a_shell_has_read_as_a_redirection_is_explained(refused, recipes_folder):
    """A shell reads `flour + water -> dough` as these words, and writes the output to a file
    `dough`."""
    message = refused("score", recipes_folder, "flour", "+", "water", "-", code=2)
    assert "a shell has read the > as a redirection to a file: write a + b = c" in message


def test_results_of_a_pair_are_ranked_marked_and_explained(printed, run, recipes_folder, scorer):
    a, b, result = in_part("train")
    values = printed("score", recipes_folder, f"{a} + {b}", "--top", "5")
    assert (values["ingredient_a"], values["ingredient_b"], values["result"]) == (a, b, None)
    assert values["trained_on"] == "partial"
    scores = scorer.score_recipes(a, b, torch.arange(len(scorer.entities)))
    ranked = scores.sort(descending=True, stable=True).indices.tolist()
    best = [entity for entity in ranked if scorer.entities[entity] not in (a, b)][:5]
    assert [row["result"] for row in values["top"]] == [scorer.entities[entity] for entity in best]
    assert [row["score"] for row in values["top"]] == pytest.approx(scores[best].tolist(), rel=1e-4)
    opened = open_graph("kitchen")
    parts = {
        opened.graph.labels(one): part
        for part in ("test", "train")
        for one in opened.split.recipes(part)
    }
    for row in values["top"]:
        recipe = (row["ingredient_a"], row["ingredient_b"], row["result"])
        assert row["known"] == parts.get((*sorted(recipe[:2]), recipe[2]), "new")
        assert row["in_sample"] == (row["known"] == "train")
        evidence = scorer.supporting_recipes(*recipe, limit=3)
        assert [tuple(one.values()) for one in row["because"]] == [
            (*one.recipe, *map(pytest.approx, (one.weight, one.share, one.strength)))
            for one in evidence
        ]
    lines = run("score", recipes_folder, a, "+", b, "--top", "5").out.splitlines()
    assert lines[0].split() == ["nats", "part", "recipe", "probability"]
    assert sum(" because " in line for line in lines) == 3
    (strongest,) = {one["strength"] for one in values["top"][0]["because"] if one["share"] > 0.5}
    assert strongest == 1
    first = values["top"][0]["because"][0]
    made = f"{first['ingredient_a']} + {first['ingredient_b']} -> {first['result']}"
    assert f"because {made} {first['strength']:.2g}" in lines[2]
    assert "because: similar train recipes, one part of a score: those with the same" in lines[-2]
    assert any(
        f"train  {a} + {b} -> {result}" in line for line in lines if line.endswith("(in-sample)")
    )
    assert NOTE in lines[-1]


@pytest.mark.parametrize(("part", "in_sample"), [("train", True), ("test", False)])
def test_a_recipe_has_a_score_and_ranks_and_in_sample_is_only_its_training(
    printed, refused, run, recipes_folder, scorer, part, in_sample
):
    a, b, result = in_part(part)
    command = ("score", recipes_folder, b, "+", a, "=", result)
    values = printed(*command)
    assert (values["known"], values["in_sample"]) == (part, in_sample)
    score = float(scorer.score_recipes(a, b, result))
    assert values["score"] == pytest.approx(score, abs=1e-4)
    everything = torch.arange(len(scorer.entities))
    for rank, scores in (
        ("rank_as_result", scorer.score_recipes(a, b, everything)),
        ("rank_as_ingredient_a", scorer.score_recipes(everything, a, result)),
        ("rank_as_ingredient_b", scorer.score_recipes(everything, b, result)),
    ):
        ties = int((scores - score).abs().lt(1e-3).sum()) - 1
        assert abs(values[rank] - 1 - int((scores > score + 1e-4).sum())) <= ties
    assert (NOTE in run(*command).out) == in_sample
    refused(*command, "--new-only", says="leave a slot open", kind="ConfigError")


@pytest.mark.parametrize(
    ("query", "slot"), [("_ + {b} {result}", "ingredient_a"), ("{b} + _ {result}", "ingredient_b")]
)
def test_partners_are_listed_and_new_ones_only_if_asked(
    printed, recipes_folder, scorer, query, slot
):
    a, b, result = in_part("train")
    command = ("score", recipes_folder, *query.format(b=b, result=result).split(), "--top", "80")
    top = printed(*command)["top"]
    others = [label for label in scorer.entities if label != result]
    scores = scorer.score_recipes(others, b, result).sort(descending=True).values.tolist()
    assert [row["score"] for row in top] == pytest.approx(scores, abs=1e-3)
    assert a in [row[slot] for row in top if row["in_sample"]]
    new = printed(*command, "--new-only")["top"]
    assert new == [row for row in top if row["known"] == "new"]
    assert 0 < len(new) < len(top) == 79


@pytest.mark.parametrize("termination", ["csv", pytest.param("tsv", marks=pytest.mark.slow)])
def test_a_file_of_recipes_gives_what_single_ones_give(
    printed, refused, recipes_folder, tmp_path, termination
):
    (a, b, result), (c, d, other) = in_part("train"), in_part("test")
    queries = tmp_path / "in.csv"
    header = "ingredient_a,ingredient_b,result\n"
    queries.write_text(f"{header}{a},{b},{result}\n\n{c},{d},\n_,{d},{other}\n{d},{c},{other}\n")
    command = ("score", recipes_folder, "--in", queries, "--top", "3")
    found = printed(*command)
    assert (found["queries"], found["scored"]) == (4, 8)
    assert [(row["line"], row["rank"]) for row in found["rows"]] == [
        (2, None), *((line, rank) for line in (4, 5) for rank in (1, 2, 3)), (6, None),
    ]  # fmt: skip
    single = printed("score", recipes_folder, a, "+", b, result)
    top = printed("score", recipes_folder, c, "+", d, "--top", "3")["top"]
    for row, expected in zip(found["rows"][:4], [single, *top], strict=True):
        for name in ("ingredient_a", "ingredient_b", "result", "known", "in_sample"):
            assert row[name] == expected[name]
        assert row["score"] == pytest.approx(expected["score"], abs=1e-4)
    out = tmp_path / f"out.{termination}"
    assert printed(*command, "--out", out)["out"] == str(out)
    header, *lines = [
        line.split("," if termination == "csv" else "\t") for line in out.read_text().splitlines()
    ]
    assert header == [
        "line",
        "ingredient_a",
        "ingredient_b",
        "result",
        "score",
        "rank",
        "known",
        "in_sample",
    ]
    assert [line[1:4] for line in lines] == [
        [row[name] for name in header[1:4]] for row in found["rows"]
    ]
    assert [line[7] for line in lines] == [str(row["in_sample"]).lower() for row in found["rows"]]
    rows = printed(*command, "--new-only")["rows"]
    assert {row["known"] for row in rows} == {"new"}
    queries.write_text("ingredient_a,ingredient_b,result\nflour,waater,\n")
    assert "in.csv, line 2: no entity 'waater'" in refused(*command, kind="QueryFileError")


def test_without_its_graph_memory_is_still_known(tmp_path, scorer):
    from wordcraft_kg.evaluation.scores import RecipeScoring, ScoringModel

    a, b, result = in_part("train")
    model = ScoringModel(scorer, None, None, "no graph")
    view = RecipeScoring(model).view_open(RecipeQuery((a, b, None)), 80)
    assert {row.known for row in view.top} == {None}
    assert result in [row.result for row in view.top if row.in_sample]
