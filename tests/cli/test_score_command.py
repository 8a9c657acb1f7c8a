"""``score`` on links: triples, open slots, files of queries, and labels that are in no graph."""

import functools

import numpy as np
import pytest
import torch
from helpers import write_graph
from quick import QUICK

from wordcraft_kg.evaluation.scores import parse_query
from wordcraft_kg.graphs import RELATIONS, open_book, open_graph
from wordcraft_kg.models.scorers.scorer_folder import load_scorer

QUERIES = (
    "head,relation,tail\nflour,combinesWith,water\n\n_,componentOf,bread\nflour,componentOf,\n"
)


def answer_to(values):
    """The only answer of a printed object."""
    (answer,) = values["answers"]
    return answer


def unranked(answers):
    """Answers without their rank in a list, which others may have moved."""
    return [{**answer, "rank": None} for answer in answers]


def recipe_of(answer):
    """The labels of an answer, in the order of the slots."""
    return tuple(answer["slots"].values())


@functools.cache
def parts_of(graph):
    """The triples of a graph by label, each with the part whose recipes give it,
    train before test."""
    opened = open_graph(graph)
    parts = {}
    for part in ("test", "valid", "train"):
        for head, relation, tail in opened.split.triples_of(part).tolist():
            parts[opened.graph.entities[head], RELATIONS[relation], opened.graph.entities[tail]] = (
                part
            )
    return parts


def test_score_prints_one_object_with_the_score_of_a_triple(printed, trained):
    values = answer_to(printed("score", trained / "one", "flour", "combinesWith", "water"))
    scorer = load_scorer(trained / "one")
    assert values["slots"] == {"head": "flour", "relation": "combinesWith", "tail": "water"}
    assert values["score"] == pytest.approx(float(scorer.score("flour", "combinesWith", "water")))
    better = (scorer.score("flour", "combinesWith", torch.arange(80)) > values["score"]).sum()
    assert values["ranks"]["tail"] == 1 + int(better)


@pytest.mark.parametrize(
    "question",
    [
        "_ componentOf bread",
        "? componentOf bread",
        "flour componentOf _",
        "flour componentOf ?",
        "flour componentOf",
    ],
)
def test_score_lists_the_best_entities_of_an_open_slot(printed, run, trained, question):
    command = ("score", trained / "one", *question.split(), "--top", "3")
    values = printed(*command)
    head, relation, tail = (
        "" if slot in ("_", "?") else slot for slot in [*question.split(), ""][:3]
    )
    # Reading drops recipes that make their ingredient, so no entity is a component of itself.
    ranked = load_scorer(trained / "one").top(head or None, relation, tail or None, limit=4)
    expected = [(name, score) for name, score in ranked if name != (head or tail)][:3]
    slot = "tail" if head else "head"
    answers = values["answers"]
    assert [(row["slots"][slot], row["score"]) for row in answers] == expected
    assert {row["slots"]["head" if head else "tail"] for row in answers} == {head or tail}
    assert [row["rank"] for row in answers] == [1, 2, 3]
    for line, (name, _) in zip(run(*command).out.splitlines()[1:], expected, strict=True):
        assert f"{head or name} componentOf {tail or name}" in line


def test_score_proposes_nothing_that_reading_drops(printed, trained, tmp_path):
    """Neither in a list nor in a file: no result is among its own ingredients."""
    (tmp_path / "in.csv").write_text(
        "head,relation,tail\n_,componentOf,bread\nbread,componentOf,\n"
    )
    file = ("--in", tmp_path / "in.csv")
    for query in (("_", "componentOf", "bread"), ("bread", "componentOf", "_"), file):
        values = printed("score", trained / "one", *query, "--top", 1_000)
        rows = values["answers"]
        assert len(rows) > 50
        assert ("bread", "componentOf", "bread") not in set(map(recipe_of, rows))
    pairs = printed("score", trained / "one", "bread", "combinesWith", "_", "--top", 1_000)
    assert "bread" in {row["slots"]["tail"] for row in pairs["answers"]}


def test_score_says_which_recipes_give_each_triple(printed, run, trained):
    known = parts_of(trained / "graph")
    query = ("score", trained / "one", "_", "componentOf", "bread", "--top", "80")
    values = printed(*query)
    assert printed(*query[:-2])["answers"] == values["answers"][:10]
    assert printed(*query[:-1], "500")["answers"] == values["answers"]
    new = printed(*query[:-1], "7", "--new-only")["answers"]
    is_new = [row for row in values["answers"] if row["known"] == "new"]
    assert unranked(new) == unranked(is_new[:7])
    parts = [row["known"] for row in values["answers"]]
    assert parts == [
        known.get((row["slots"]["head"], "componentOf", "bread"), "new")
        for row in values["answers"]
    ]
    assert set(parts) == {"train", "test", "new"}
    assert values["trained_on"] == "partial"
    assert [line.split()[1] for line in run(*query).out.splitlines()] == ["part", *parts]
    for triple, part in list(known.items())[::97]:
        assert answer_to(printed("score", trained / "one", *triple))["known"] == part


def test_score_says_how_probable_triples_outside_training_are(printed, run, world, put, tmp_path):
    model, scorer = world / "scorer", load_scorer(world / "scorer")
    query = ("score", model, "_", "componentOf", "bread", "--top", "80")
    top = printed(*query)["answers"]
    for row in top:
        expected = float(scorer.probability(row["slots"]["head"], "componentOf", "bread"))
        probability = None if row["known"] == "train" else pytest.approx(expected)
        assert row.get("probability") == probability
    heading, *lines = run(*query).out.splitlines()
    assert heading.split() == ["score", "part", "triple", "probability"]
    has_probability = [line.count(".") == 2 for line in lines]
    assert has_probability == [row["known"] != "train" for row in top]
    new = next(row for row in top if row["known"] == "new")
    single = run("score", model, new["slots"]["head"], "componentOf", "bread").out
    assert f"  {new['probability']:.3f}" in single
    queries = put(
        f"head,relation,tail\n{new['slots']['head']},componentOf,bread\n_,componentOf,bread\n",
        "queries.csv",
    )
    rows = printed("score", model, "--in", queries, "--top", "80")["answers"]
    assert rows[0]["probability"] == pytest.approx(new["probability"])
    assert [row.get("probability") for row in rows[1:]] == [row.get("probability") for row in top]
    run("score", model, "--in", queries, "--out", tmp_path / "scores.csv")
    header, first, *_ = (tmp_path / "scores.csv").read_text().splitlines()
    assert header.endswith(",known,probability")
    assert float(first.rsplit(",", 1)[1]) == pytest.approx(new["probability"], rel=1e-4)


def test_score_says_that_a_full_model_has_seen_the_test(run, trained):
    """Score says that a model of the full graph has seen the test triples."""
    note = "trained on the full graph, test triples included"
    triple = next(triple for triple, part in parts_of(trained / "graph").items() if part == "test")
    assert note in run("score", trained / "full", *triple).out
    assert note not in run("score", trained / "one", *triple).out
    query = ("score", trained / "full", "_", "componentOf", "bread", "--top", "80")
    assert note in run(*query).out
    assert note not in run(*query, "--new-only").out


def test_a_model_whose_graph_has_moved_asks_for_it(refused, run, trained, tmp_path):
    write_graph(tmp_path / "graph")
    run("train-complex", tmp_path / "graph", *QUICK, "--out", tmp_path / "one")
    (tmp_path / "graph").rename(tmp_path / "moved")
    query = ("score", tmp_path / "one", "_", "componentOf", "bread")
    refused(*query, says="--graph", kind="ArtefactError")
    assert run(*query, "--graph", tmp_path / "moved").code == 0
    assert run(*query, "--graph", "everyday").kind == "GraphMismatchError"


def test_an_entity_called_like_an_open_slot_goes_before_it(printed, run, tmp_path):
    book = tmp_path / "book.csv"
    rows = [f"{a},{b},{c}" for a, b, c in open_book("kitchen").recipes]
    book.write_text("ingredient_a,ingredient_b,result\n_,water,bread\n" + "\n".join(rows))
    run("train-complex", book, *QUICK, "--out", tmp_path / "model")
    model = tmp_path / "model"
    values = answer_to(printed("score", model, "_", "combinesWith", "water"))
    assert (values["slots"]["head"], values["known"]) == ("_", "train")
    assert printed("score", model, "?", "combinesWith", "water")["scored"] == 10
    assert printed("score", model, "water", "combinesWith")["scored"] == 10


def test_a_file_of_queries_gives_what_single_ones_give(printed, trained, tmp_path):
    (tmp_path / "pairs.csv").write_text(QUERIES)
    values = printed("score", trained / "one", "--in", tmp_path / "pairs.csv", "--top", "3")
    assert (values["queries"], values["scored"], len(values["answers"])) == (3, 7, 7)
    triple, *listed = values["answers"]
    single = answer_to(printed("score", trained / "one", "flour", "combinesWith", "water"))
    assert (triple["line"], triple.get("rank"), triple["known"]) == (2, None, single["known"])
    assert triple["score"] == pytest.approx(single["score"])
    cases = (
        (4, ("_", "componentOf", "bread"), listed[:3]),
        (5, ("flour", "componentOf"), listed[3:]),
    )
    for line, query, rows in cases:
        best = printed("score", trained / "one", *query, "--top", "3")["answers"]
        for rank, (row, one) in enumerate(zip(rows, best, strict=True), 1):
            assert (row["line"], row["rank"]) == (line, rank)
            assert {**row, "line": None} == {**one, "line": None}


@pytest.mark.parametrize("termination", ["csv", "tsv"])
def test_the_scores_of_a_file_go_to_a_file(printed, refused, run, trained, tmp_path, termination):
    (tmp_path / "pairs.csv").write_text(QUERIES)
    out = tmp_path / "new" / f"scores.{termination}"
    command = ("score", trained / "one", "--in", tmp_path / "pairs.csv", "--top", "3", "--out", out)
    assert printed(*command)["out"] == str(out)
    rows = printed(*command[:6])["answers"]
    header, *lines = [
        line.split("," if termination == "csv" else "\t") for line in out.read_text().splitlines()
    ]
    assert header == ["line", "head", "relation", "tail", "score", "rank", "known", "probability"]
    assert [tuple(line[1:4]) for line in lines] == [recipe_of(row) for row in rows]
    assert [np.float32(line[4]) for line in lines] == [np.float32(row["score"]) for row in rows]
    assert [line[5] for line in lines] == [
        "" if row.get("rank") is None else str(row["rank"]) for row in rows
    ]
    before = out.read_bytes()
    refused(*command, says="--force", kind="OutputExistsError")
    assert out.read_bytes() == before
    assert run(*command, "--force").code == 0


def test_new_only_leaves_known_triples_out_of_a_file_too(printed, trained):
    triples, known = trained / "graph" / "triples" / "full.tsv", parts_of(trained / "graph")
    assert printed("score", trained / "one", "--in", triples, "--new-only").get("answers", []) == []
    rows = printed("score", trained / "one", "--in", triples)["answers"]
    assert [row["known"] for row in rows] == [known[recipe_of(row)] for row in rows]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("flour,combineWith,water\n", "line 1: no relation 'combineWith'"),
        (
            "head,relation,tail\n_,componentOf,?\n",
            "line 2: '_ componentOf ?' has several open slots",
        ),
        ("\n\nflour,water\n", "line 3: 'flour,water' has 2 columns; expected head, relation, tail"),
        ('flour,combinesWith,"wa\n', "line 1: "),
        ("head,relation,tail\n", "has no query"),
        ("", "has no query"),
        ("\xff", "not UTF-8"),
    ],
)
def test_a_wrong_file_of_queries_is_refused_with_the_line(
    refused, trained, tmp_path, content, message
):
    (tmp_path / "pairs.csv").write_text(content, encoding="latin-1")
    command = (
        "score",
        trained / "one",
        "--in",
        tmp_path / "pairs.csv",
        "--out",
        tmp_path / "scores.csv",
    )
    refused(*command, says=message, kind="QueryFileError")
    assert [path.name for path in tmp_path.iterdir()] == ["pairs.csv"]


@pytest.mark.parametrize(
    ("query", "by_words", "notes"),
    [
        pytest.param(
            "yogurt componentOf cake",
            ["yogurt"],
            ["new   yogurt componentOf cake", "among all 81 entities"],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "yogurt combinesWith rice",
            ["yogurt", "rice"],
            ["not in the graph, scored by words alone: 'yogurt', 'rice'"],
            marks=pytest.mark.slow,
        ),
        (
            "bakery combinesWith water",
            ["bakery"],
            ["words alone: 'bakery'. Did you mean 'baker'"],
        ),
        ("flour combinesWith water", [], []),
    ],
)
def test_entities_outside_the_graph_are_scored_by_words(
    printed, run, recipes_folder, query, by_words, notes
):
    command = ("score", recipes_folder, *query.split())
    assert printed(*command).get("by_words", []) == by_words
    text = run(*command).out
    assert all(note in text for note in notes)
    assert ("not in the graph" in text) == bool(by_words)


def test_new_words_in_a_file_are_scored_and_unknown_words_refused(
    printed, refused, run, recipes_folder, tmp_path
):
    queries, out = tmp_path / "pairs.csv", tmp_path / "scores.csv"
    command = ("score", recipes_folder, "--in", queries, "--top", "2")
    queries.write_text("yogurt,combinesWith,water\nflour,combinesWith,flouurr\n")
    says = f"{queries}, line 2: no entity 'flouurr'. Did you mean 'flour'"
    refused(*command, "--out", out, says=says, kind="UnknownEntityError")
    assert not out.exists()
    queries.write_text("yogurt,combinesWith,water\n_,componentOf,rice\nflour,combinesWith,yogurt\n")
    values = printed(*command)
    assert (values["scored"], values["by_words"]) == (4, ["yogurt", "rice"])
    assert (
        "not in the graph, scored by words alone: 'yogurt', 'rice'"
        in run(*command, "--out", out).out
    )
    assert len(out.read_text().splitlines()) == 5


@pytest.mark.parametrize(
    ("folder", "word", "says"),
    [
        ("recipes", "flouurr", ["no entity 'flouurr'.", "No word in this label has a vector"]),
        ("links", "yogurt", ["no entity 'yogurt'.", "knows only the graph's entities"]),
    ],
)
def test_words_that_a_model_cannot_score_are_refused(
    refused, recipes_folder, trained, folder, word, says
):
    model = recipes_folder if folder == "recipes" else trained / "one"
    refused("score", model, word, "combinesWith", "water", says=says, kind="UnknownEntityError")


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
        (["flour", "+", "water", "=", "_"], ("flour", "water", None)),
        (["flour", "+", "water", "=", "dough"], ("flour", "water", "dough")),
        (["flour", "+", "water", "→", "dough"], ("flour", "water", "dough")),
        (["flour + water -> dough"], ("flour", "water", "dough")),
        (["flour+water=dough"], ("flour", "water", "dough")),
        (["water", "+", "?", "=", "dough"], ("water", None, "dough")),
        (["_+water=dough"], (None, "water", "dough")),
        (["cocoa bean", "+", "water"], ("cocoa bean", "water", None)),
        (["cocoa bean+water=cocoa bean"], ("cocoa bean", "water", "cocoa bean")),
        (["c++", "+", "a->b", "=", "_x"], ("c++", "a->b", "_x")),
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
        (["_", "+", "water"], "ConfigError", "'_ water _' has several open slots"),
        (["_", "+", "_", "=", "dough"], "ConfigError", "'_ _ dough' has several open slots"),
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
    assert values["trained_on"] == "partial"
    scores = scorer.score_recipes(a, b, torch.arange(len(scorer.entities)))
    ranked = scores.sort(descending=True, stable=True).indices.tolist()
    best = [entity for entity in ranked if scorer.entities[entity] not in (a, b)][:5]
    assert [row["slots"]["result"] for row in values["answers"]] == [
        scorer.entities[entity] for entity in best
    ]
    assert [row["score"] for row in values["answers"]] == pytest.approx(
        scores[best].tolist(), rel=1e-4
    )
    opened = open_graph("kitchen")
    parts = {
        opened.graph.labels(one): part
        for part in ("test", "train")
        for one in opened.split.recipes(part)
    }
    for row in values["answers"]:
        recipe = recipe_of(row)
        assert recipe[:2] == (a, b)
        assert row["known"] == parts.get((*sorted(recipe[:2]), recipe[2]), "new")
        assert row.get("in_sample", False) == (row["known"] == "train")
        evidence = scorer.supporting_recipes(*recipe, limit=3)
        assert [tuple(one.values()) for one in row["because"]] == [
            (*one.recipe, *map(pytest.approx, (one.weight, one.share, one.strength)))
            for one in evidence
        ]
    lines = run("score", recipes_folder, a, "+", b, "--top", "5").out.splitlines()
    assert lines[0].split() == ["score", "part", "recipe", "probability"]
    assert sum(" because " in line for line in lines) == 3
    (strongest,) = {
        one["strength"] for one in values["answers"][0]["because"] if one["share"] > 0.5
    }
    assert strongest == 1
    first = values["answers"][0]["because"][0]
    made = f"{first['ingredient_a']} + {first['ingredient_b']} -> {first['result']}"
    assert f"because {made} {first['strength']:.2g}" in lines[2]
    assert "because: similar train recipes, one part of a score: those with the same" in lines[-2]
    assert any(
        f"train  {a} + {b} -> {result}" in line for line in lines if line.endswith("(learned)")
    )
    assert NOTE in lines[-1]


@pytest.mark.parametrize(("part", "in_sample"), [("train", True), ("test", False)])
def test_a_recipe_has_a_score_and_ranks_and_in_sample_is_only_its_training(
    printed, run, refused, recipes_folder, scorer, part, in_sample
):
    a, b, result = in_part(part)
    command = ("score", recipes_folder, b, "+", a, "=", result)
    values = answer_to(printed(*command))
    assert (values["known"], values.get("in_sample", False)) == (part, in_sample)
    score = float(scorer.score_recipes(a, b, result))
    assert values["score"] == pytest.approx(score, abs=1e-4)
    everything = torch.arange(len(scorer.entities))
    for rank, scores in (
        ("result", scorer.score_recipes(a, b, everything)),
        ("ingredient_a", scorer.score_recipes(everything, a, result)),
        ("ingredient_b", scorer.score_recipes(everything, b, result)),
    ):
        ties = int((scores - score).abs().lt(1e-3).sum()) - 1
        assert abs(values["ranks"][rank] - 1 - int((scores > score + 1e-4).sum())) <= ties
    assert (NOTE in run(*command).out) == in_sample
    refused(*command, "--new-only", says="leave a slot open", kind="ConfigError")


@pytest.mark.parametrize(
    ("query", "slot"),
    [("_ + {b} = {result}", "ingredient_a"), ("{b} + _ = {result}", "ingredient_b")],
)
def test_partners_are_listed_and_new_ones_only_if_asked(
    printed, recipes_folder, scorer, query, slot
):
    a, b, result = in_part("train")
    command = ("score", recipes_folder, *query.format(b=b, result=result).split(), "--top", "80")
    top = printed(*command)["answers"]
    others = [label for label in scorer.entities if label != result]
    scores = scorer.score_recipes(others, b, result).sort(descending=True).values.tolist()
    assert [row["score"] for row in top] == pytest.approx(scores, abs=1e-3)
    assert a in [row["slots"][slot] for row in top if row.get("in_sample")]
    new = printed(*command, "--new-only")["answers"]
    assert unranked(new) == unranked(row for row in top if row["known"] == "new")
    assert 0 < len(new) < len(top) == 79
