"""The texts of thirty important errors, in full: value found, value expected, remedy."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

import wordcraft_kg as wk
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs.export import export_graph
from wordcraft_kg.graphs.folder import write_graph_folder
from wordcraft_kg.graphs.task_search import make_tasks
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.queries import parse_query
from wordcraft_kg.studies.study import parse_study

HEADER = "ingredient_a,ingredient_b,result\n"
STUDY = 'title = "Mine"\n[settings]\nbook = "kitchen"\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory, kitchen):
    """A folder with books, graph folders and an untrained model."""
    home = tmp_path_factory.mktemp("home")
    book = wk.open_book("kitchen")
    for name in ("graph", "damaged"):
        write_graph_folder(home / name, book, wk.make_split(kitchen, wk.SplitConfig()))
    (home / "damaged/graph.json").write_text("{")
    (home / "half.csv").write_text(HEADER + "flour,,dough\n")
    (home / "wrong.csv").write_text("a,b,c\nflour,water,dough\n")
    (home / "empty.csv").write_text(HEADER)
    opened = wk.open_graph(home / "graph")
    wk.save_scorer(home / "model", FrequencyScorer(opened.graph, opened.split.partial), opened, kg="partial")
    return home


def kitchen():
    return wk.open_graph("kitchen").graph


TEXTS = """
no book of this name | RecipeFileError: 'kichen' is neither a file nor a known book. Did you mean 'kitchen'?
    `wordcraft-kg books` lists all known books.
a recipe of one ingredient | RecipeFileError: half.csv, line 2: 'flour' is the only ingredient; a recipe needs two.
    Write it twice, or build the graph with `single_ingredient` self, which reads flour + flour, or the name of what
    it is combined with.
a book without recipes | RecipeFileError: empty.csv has no recipe to keep (0 self results dropped).
a book without its columns | RecipeFileError: wrong.csv, line 1: the header is 'a,b,c'; expected
    'ingredient_a,ingredient_b,result'; kind may follow.
an unknown entity | UnknownEntityError: no entity 'bred' in kitchen. Did you mean 'bread'?
an unknown kind of split | ConfigError: `kind` 'by-goals': expected one of by-recipe, by-recipe-plain, by-slot,
    by-goal, by-goal-terminals, by-kind, none. Did you mean 'by-goal', 'by-goal-terminals'?
a ratio outside its range | ConfigError: `train_ratio` 2: expected more than 0 and less than 1, such as 0.8.
a graph too small to split | SplitError: the test part of a by-recipe split of 1 recipe in 1 group is empty; choose
    another `train_ratio` or `valid_ratio`, or `kind` none for the full graph only.
a damaged graph folder | ArtefactError: damaged/graph.json, line 1, column 2: not JSON (Expecting property name
    enclosed in double quotes). The graph folder is damaged; build it again.
a graph folder that exists | OutputExistsError: 'graph' exists. Choose another `out`, or replace it with `force`.
an unknown format | ConfigError: `format` 'owl': expected one of tsv, graphml, nt, parquet, csv, json.
no task of a depth | TaskError: graph has no task of depth 3.
too many distractors | ConfigError: `num_distractors` 100: kitchen has 80 entities, of which a task needs up to 3;
    expected at most 77.
a setting below its range | ConfigError: `depth` 0: expected a whole number, 1 to 5.
an unknown keyword | UnknownSettingError: unexpected keyword argument 'distractors'; expected one of part, depth,
    num_distractors, max_attempts, reward, distractor_weighting, distractor_policy, task_weighting, ambiguity,
    illegal_action, num_tasks, task_seed. Did you mean 'num_distractors', 'distractor_policy', 'distractor_weighting'?
a step before the reset | EpisodeError: call reset() before step().
a number that is not whole | ConfigError: `dim` 1.5: expected a whole number, 1 or more.
a number that is none | ConfigError: `n3` nan: expected a number, 0 or more.
a choice with a nearest one | ConfigError: `mixing` 'fre': expected one of softmax, free. Did you mean 'free'?
patience without validation | ConfigError: `patience` counts validations; give `eval_every` too, such as 5.
settings of a scorer without one | ConfigError: `use` configures the use of a scorer: give a `scorer` too.
no model of this name | ArtefactError: 'models/none' does not exist; expected a model folder from train-complex,
    train-links or train-recipes.
a graph where a model is expected | ArtefactError: 'graph' is a graph folder; expected a model folder from
    train-complex, train-links or train-recipes.
a model of another graph | GraphMismatchError: model was trained on graph 43fe37e2e912 (80 entities) but
    'paper-examples' is 8e9614822341 (93). Train on this graph, or use the training graph.
a model folder that exists | OutputExistsError: 'model' exists. Choose another `out`, or replace it with `force`.
a scorer that cannot be used so | ConfigError: `use` w needs recipe scores, and this scorer only has link scores. Use
    a scorer from `wordcraft-kg train-recipes`, or leave out w.
a query that cannot be parsed | UnknownEntityError: no relation 'and'; expected combinesWith or componentOf.
an unknown setting of a study | ConfigError: study.toml: unknown setting 'settings.bok'. Did you mean 'book'?
a study without variants | ConfigError: study.toml: Object missing required field 'variants'.
a rate that is negative | ConfigError: `learning_rate` -1: expected a number above 0, at most 1e+09.
an extra that is not installed | MissingExtraError: ray is not installed: pip install 'ray>=2.40'
"""
CALLS: dict[str, Callable[[], object]] = {
    "no book of this name": lambda: wk.open_book("kichen"),
    "a recipe of one ingredient": lambda: wk.open_book("half.csv"),
    "a book without recipes": lambda: wk.open_book("empty.csv"),
    "a book without its columns": lambda: wk.open_book("wrong.csv"),
    "an unknown entity": lambda: kitchen().id_of("bred"),
    "an unknown kind of split": lambda: wk.SplitConfig("by-goals"),
    "a ratio outside its range": lambda: wk.SplitConfig(train_ratio=2),
    "a graph too small to split": lambda: wk.make_split(
        wk.RecipeGraph.from_recipes([("a", "b", "c")]), wk.SplitConfig()
    ),
    "a damaged graph folder": lambda: wk.open_graph("damaged"),
    "a graph folder that exists": lambda: write_graph_folder(
        Path("graph"), wk.open_book("kitchen"), wk.open_graph("kitchen").split
    ),
    "an unknown format": lambda: export_graph(wk.open_graph("kitchen"), "owl", Path("graph.owl")),
    "no task of a depth": lambda: make_tasks(wk.RecipeGraph.from_recipes([("a", "b", "c")]), 3),
    "too many distractors": lambda: wk.World(wk.open_graph("kitchen"), wk.WordCraftConfig(num_distractors=100)),
    "a setting below its range": lambda: wk.WordCraftConfig(depth=0),
    "an unknown keyword": lambda: WordCraftEnv("kitchen", distractors=2),
    "a step before the reset": lambda: WordCraftEnv("kitchen").step(0),
    "a number that is not whole": lambda: wk.ComplExConfig(dim=1.5),
    "a number that is none": lambda: wk.ComplExConfig(n3=float("nan")),
    "a choice with a nearest one": lambda: wk.PolicyConfig(mixing="fre"),
    "patience without validation": lambda: wk.ComplExConfig(patience=3),
    "settings of a scorer without one": lambda: wk.AgentConfig("kitchen", policy=wk.PolicyConfig(use="u,v,w")),
    "no model of this name": lambda: wk.open_model("models/none"),
    "a graph where a model is expected": lambda: wk.open_model("graph"),
    "a model of another graph": lambda: wk.load_scorer("model", graph=wk.open_graph("paper-examples").graph),
    "a model folder that exists": lambda: wk.train_links(
        wk.LinksConfig("kitchen", wk.ComplExConfig(epochs=1)), "model"
    ),
    "a scorer that cannot be used so": lambda: wk.make_sources(
        ["w"], wk.load_scorer("model"), tasks=wk.World(wk.open_graph("kitchen"), wk.WordCraftConfig()).tasks
    ),
    "a query that cannot be parsed": lambda: parse_query(["flour", "and", "water"], kitchen().entities),
    "an unknown setting of a study": lambda: parse_study(
        STUDY.replace("book", "bok") + "[variants.none]\n", "study.toml"
    ),
    "a study without variants": lambda: parse_study(STUDY, "study.toml"),
    "a rate that is negative": lambda: wk.ImpalaConfig(learning_rate=-1),
    "an extra that is not installed": lambda: (_ for _ in ()).throw(missing_extra("ray", ["ray"])),
}


EXPECTED = dict(" ".join(text.split()).split(" | ") for text in re.split(r"\n(?! )", TEXTS.strip()))


@pytest.mark.parametrize("name", EXPECTED)
def test_an_error_says_what_was_found_what_was_expected_and_what_to_do(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    with pytest.raises(WordCraftKGError) as raised:
        CALLS[name]()
    assert f"{raised.value.kind}: {raised.value}" == EXPECTED[name]
