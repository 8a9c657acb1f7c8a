"""The texts of errors that no other test has in full: value found, value expected, remedy."""

from pathlib import Path

import pytest

import wordcraft_kg as wk
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs.export import export_graph
from wordcraft_kg.graphs.folder import write_graph_folder
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

TEXTS = [
    (
        lambda: wk.open_book("half.csv"),
        "RecipeFileError: half.csv, line 2: 'flour' is the only ingredient, in a book of pairs. "
        "Write it twice, or build the graph with `single_ingredient` self (which reads flour + "
        "flour), alone (a recipe of one ingredient), or the name of what it is combined with.",
    ),
    (
        lambda: wk.SplitConfig("by-goals"),
        "ConfigError: `kind` 'by-goals': expected one of by-recipe, by-recipe-plain, by-slot, "
        "by-goal, by-kind, none. Did you mean 'by-goal'?",
    ),
    (
        lambda: wk.make_split(wk.RecipeGraph.from_recipes([("a", "b", "c")]), wk.SplitConfig()),
        "SplitError: the test part of a by-recipe split of 1 recipe in 1 group is empty; choose "
        "another `train_ratio` or `valid_ratio`, or `kind` none for the full graph only.",
    ),
    (
        lambda: wk.open_graph("damaged"),
        "ArtefactError: damaged/graph.json, line 1, column 2: not JSON (Expecting property name "
        "enclosed in double quotes). The graph folder is damaged; build it again.",
    ),
    (
        lambda: export_graph(wk.open_graph("kitchen"), "owl", Path("graph.owl")),
        "ConfigError: `format` 'owl': expected one of tsv, graphml, nt, parquet, csv, json, hif, sentences.",
    ),
    (
        lambda: WordCraftEnv("kitchen", distractors=2),
        "UnknownSettingError: unexpected keyword argument 'distractors'; expected one of part, "
        "depth, num_distractors, max_attempts, reward, distractor_weighting, distractor_policy, "
        "task_weighting, ambiguity, pays_held_out, illegal_action, num_tasks, task_seed. Did you mean "
        "'num_distractors', 'distractor_policy', 'distractor_weighting'?",
    ),
    (
        lambda: wk.ComplExConfig(dim=1.5),
        "ConfigError: `dim` 1.5: expected a whole number, 1 or more.",
    ),
    (
        lambda: wk.PolicyConfig(mixing="fre"),
        "ConfigError: `mixing` 'fre': expected one of softmax, free, residual. Did you mean 'free'?",
    ),
    (
        lambda: wk.load_scorer("model", graph=wk.open_graph("paper-examples").graph),
        "GraphMismatchError: model was trained on graph 43fe37e2e912 (80 entities) but "
        "'paper-examples' is 8e9614822341 (93). Train on this graph, or use the training graph.",
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, opened_kitchen):
    """A folder with a book, a damaged graph folder and an untrained model."""
    home = tmp_path_factory.mktemp("home")
    write_graph_folder(home / "damaged", wk.open_book("kitchen"), opened_kitchen.split)
    (home / "damaged/graph.json").write_text("{")
    (home / "half.csv").write_text("ingredient_a,ingredient_b,result\nflour,,dough\n")
    scorer = FrequencyScorer(opened_kitchen.graph, opened_kitchen.split.partial)
    wk.save_scorer(home / "model", scorer, opened_kitchen, kg="partial")
    return home


@pytest.mark.parametrize(("call", "text"), TEXTS)
def test_an_error_says_what_was_found_what_was_expected_and_what_to_do(
    call, text, folder, monkeypatch
):
    monkeypatch.chdir(folder)
    with pytest.raises(WordCraftKGError) as raised:
        call()
    assert f"{raised.value.kind}: {raised.value}" == text
