"""Scores of sets from a table, such as a language model's opinions, guide an agent."""

import numpy as np
import pytest
import torch

from wordcraft_kg.base.errors import ArtefactError, ConfigError, KnowledgeFileError
from wordcraft_kg.graphs import open_graph
from wordcraft_kg.models.knowledge.score_files import read_scores
from wordcraft_kg.models.policies.sources.registry import make_sources, source_class
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.set_table import SetTableScorer

GRAPH = open_graph("kitchen").graph
ROWS = (("flour", "water", "dough", 9), ("fire", "dough", "bread", 7), ("egg", "egg", "cake", 1))


@pytest.fixture
def file(tmp_path):
    def write(*lines):
        path = tmp_path / "scores.csv"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


@pytest.fixture(params=["set", "columns"])
def scorer(request, file):
    if request.param == "set":
        lines = [f"{a} + {b},{result},{score}" for a, b, result, score in ROWS]
        return read_scores(file("set,result,score", *lines), GRAPH)
    lines = [f"{score},{b},{a},{result}" for a, b, result, score in ROWS]
    return read_scores(file("score,one,two,result", *lines), GRAPH)


def test_the_source_is_the_score_of_the_selection_or_of_the_best_partner(scorer):
    (source,) = make_sources(["table"], scorer)
    nothing = GRAPH.num_entities
    flour, water, fire = (GRAPH.id_of(label) for label in ("flour", "water", "fire"))
    table = torch.tensor([[flour, water, fire, nothing]]).expand(3, -1)
    goal = torch.tensor([GRAPH.id_of("dough")] * 3)
    scores = source(States(goal, torch.tensor([nothing, water, fire]), table))
    # 9, 7 and 1 standardised; 0 is their mean.
    high = (9 - 17 / 3) / np.std([9, 7, 1])
    torch.testing.assert_close(
        scores, torch.tensor([[high, high, 0, 0], [high, 0, 0, 0], [0, 0, 0, 0]]).float()
    )
    restored = source_class("t").restored(nothing, source.state_dict())
    assert (restored.keys == source.keys).all()
    with pytest.raises(ValueError, match="ascending"):
        source_class("t").restored(nothing, {"keys": source.keys.flip(0), "values": source.values})


def test_a_triple_has_the_best_score_of_its_sets_and_a_set_its_own(scorer):
    assert scorer.score("flour", "componentOf", "dough") == scorer.values.max()
    assert scorer.score("water", "combinesWith", "flour") == scorer.values.max()
    assert scorer.score("egg", "combinesWith", "egg") == scorer.values.min()
    assert scorer.score("flour", "componentOf", "bread") == 0
    sets = np.full((2, 8), -1)
    sets[:, :2] = GRAPH.id_of("water"), GRAPH.id_of("flour")
    goals = np.array([GRAPH.id_of("dough"), GRAPH.id_of("bread")])
    assert scorer.score_sets(sets, goals).tolist() == [scorer.values.max(), 0]


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ((), "found the columns none"),
        (("set,result",), "found the columns 'set', 'result'"),
        (("result,score", "dough,1"), "found the columns"),
        (("set,result,score",), "no scores below the header"),
        (("set,result,score", "flour + watr,dough,1"), "line 2: .*'watr'.*water"),
        (("set,result,score", "flour + water,dough,high"), "line 2: .*a finite number"),
        (("set,result,score", "flour + water,dough,nan"), "line 2: .*a finite number"),
        (("set,result,score", "flour + water,dough,1e99"), "line 2: .*a finite number"),
        (("set,result,score", f"flour + water,dough,{'1' * 200_000}"), "line 2: field larger"),
        (("set,result,score", "flour + water,dough"), "line 2: .*a finite number"),
        (("set,result,score", "flour + water,dough,1,2"), "line 2: .*a finite number"),
        (("set,result,score", *["water + flour,dough,1"] * 2), "line 3: .*in an earlier line"),
        (("set,result,score", " + ".join(["egg"] * 9) + ",cake,1"), "1 to 8 ingredients"),
    ],
)
def test_a_faulty_table_is_refused_by_its_line(file, lines, says):
    with pytest.raises(KnowledgeFileError, match=says):
        read_scores(file(*lines), GRAPH)


@pytest.mark.parametrize(
    "tensors",
    [
        {"sets": torch.full((3, 8), 81)},
        {"results": torch.tensor([0, 1, 80])},
        {"values": torch.zeros(2)},
    ],
    ids=str,
)
def test_a_damaged_table_is_refused(file, tensors):
    lines = [f"{a} + {b},{result},{score}" for a, b, result, score in ROWS]
    scorer = read_scores(file("set,result,score", *lines), GRAPH)
    with pytest.raises(ValueError):  # noqa: PT011 - any reason
        SetTableScorer.check(scorer.tensors() | tensors, GRAPH.num_entities)


def test_a_folder_of_scores_serves_players_and_agents(run, file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipes = [recipe for recipe in GRAPH.recipe_labels() if recipe.result != "bread"]
    lines = [f"{' + '.join(recipe.ingredients)},{recipe.result},5" for recipe in recipes]
    path = file("set,result,score", *lines, "egg + fire,bread,1")
    made = run("import-knowledge", "kitchen", "--scores", path, "--out", "opinions")
    assert (made.code, "train-agent kitchen --scorer opinions --use table" in made.out) == (0, True)
    assert isinstance(load_scorer("opinions"), SetTableScorer)
    few = ("--distractors", 2, "--distractor-seeds", 1)
    (row,) = [
        line
        for line in run("evaluate-agent", "kitchen", "--scorer", "opinions", *few).out.splitlines()
        if line.startswith("opinions, t, best pair")
    ]
    assert float(row.split()[4]) > 0.8
    train = ("train-agent", "kitchen", "--scorer", "opinions", "--steps", 64, "--quiet")
    assert run(*train, "--use", "table", "--out", "agent").code == 0
    assert " t " in run("explain", "agent", "--episodes", 1).out
    refused = run("import-knowledge", "kitchen", "--scores", path, "--triples", path)
    assert (refused.code, "leave out other knowledge" in refused.err) == (1, True)


def test_other_scorers_have_no_table():
    from wordcraft_kg.models.scorers.baselines import SymbolicScorer

    with pytest.raises(ConfigError, match="import-knowledge --scores"):
        make_sources(["table"], SymbolicScorer(GRAPH, GRAPH.triples))


def test_a_missing_table_is_named(tmp_path):
    with pytest.raises(ArtefactError, match="nowhere"):
        read_scores(tmp_path / "nowhere.csv", GRAPH)
