"""Compare people's published judgements of single pairs with a recipe scorer's answers to the same
questions.

    python benchmarks/people_pairs.py --fetch --recipes rated.csv
    wordcraft-kg train-recipes little-alchemy-2 --kg full --without rated.csv --out models/glove
    python benchmarks/people_pairs.py --model models/glove --json people-pairs.json

Brändle et al. (2023) asked 103 people about pairs of Little Alchemy 2: do these two combine (1 to
7), and which of four things do they make? The file is published under the MIT licence. The scorer
must not have learned from the rated pairs, so ``--recipes`` writes their recipes for
``train-recipes --without``.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from wordcraft_kg.base.artefacts import sha256_of, staged_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, LeakError, WordCraftKGError
from wordcraft_kg.base.statistics import RESAMPLES, bootstrap, interval
from wordcraft_kg.cli.console import aligned
from wordcraft_kg.graphs.book_files import recipe_table
from wordcraft_kg.graphs.graph_folder import open_graph
from wordcraft_kg.graphs.library import cache_folder, data_folder, fetch_file
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer_folder import load_scorer

FILE = "validation_behavior.json"
COMMIT = "8f6537658d2902fca48aa03227ae38f27c14b6dd"
URL = (
    f"https://raw.githubusercontent.com/franziskabraendle/alchemy_empowerment/{COMMIT}"
    f"/empowermentexploration/additionalexperiments/validation_analysis/{FILE}"
)
SHA256 = "2778f542776823def65ee1824c396a588a3ec8ed69e3f2208db48618f79c8e74"
CAVEATS = (
    "the pairs are balanced on a prediction model's answer, so recipes are far more frequent than "
    "in the book",
    "the four options come from the same model",
    "most people had not played the game (23 of 103 had)",
    "a pair outside the book may be sensible",
)


class Judgement(NamedTuple):
    """A person's answers about a pair.

    Attributes:
        person: number of the person.
        pair: entity ids of the two ingredients, the smaller one first.
        rating: from 1 (do not combine) to 7 (combine).
        answer: label of the chosen result.
        options: labels of the four results to choose from.
    """

    person: int
    pair: tuple[int, int]
    rating: int
    answer: str
    options: tuple[str, ...]


class Estimate(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]"


class Answers(NamedTuple):
    """The answers of people, or of a scorer, compared with the book.

    Attributes:
        auc: area under the ROC curve for "is it a recipe": one person's rating, or the scorer's
            best score for any result; .5 is chance.
        right: share of right answers to "which of four results", among questions with a right
            option; .25 is chance.
    """

    auc: Estimate
    right: Estimate


def judgements_file(*, fetch: bool = False) -> Path:
    """Return the published file.

    Args:
        fetch: download the file into the cache if it is not on this machine.

    Raises:
        ArtefactError: if the file is missing or changed.
        FetchError: if the download fails.
    """
    cached = cache_folder() / "alchemy_pairs" / FILE
    places = [cached]
    if data := data_folder():
        places.insert(0, data / "alchemy_pairs" / FILE)
    path = next((place for place in places if place.is_file()), None)
    if path is None and fetch:
        return fetch_file("people's judgements of pairs", URL, SHA256, cached)
    if path is None:
        raise ArtefactError(
            "people's judgements of pairs are not on this machine. Fetch them: add --fetch."
        )
    if sha256_of(path) != SHA256:
        raise ArtefactError(
            f"{path} is not the published file (its SHA-256 differs). Remove it, and add --fetch."
        )
    return path


def read_judgements(path: Path, graph: RecipeGraph) -> list[Judgement]:
    """Return all judgements of pairs with both ingredients in the graph; ConfigError if there are
    none."""
    ids = {label: entity for entity, label in enumerate(graph.entities)}
    judgements = []
    for number, person in enumerate(json.loads(path.read_text(encoding="utf-8")).values()):
        questions = zip(
            person["currentcombinationstring"],
            person["linkanswers"],
            person["elementanswers"],
            person["elementoptionsshuffeld"],
            strict=True,
        )
        for pair, rating, answer, options in questions:
            if pair[0] in ids and pair[1] in ids:
                a, b = sorted(ids[label] for label in pair)
                judgements.append(Judgement(number, (a, b), int(rating), answer, tuple(options)))
    if not judgements:
        raise ConfigError(f"{graph.name} has none of the rated pairs; expected little-alchemy-2.")
    return judgements


def judged_recipes(judgements: Sequence[Judgement], graph: RecipeGraph) -> list[Recipe]:
    """Return the graph's recipes of rated pairs, as labels: the compared scorer
    must not know them."""
    pairs = {judgement.pair for judgement in judgements}
    rows = [row for row in graph.recipes.tolist() if (row[0], row[1]) in pairs]
    return graph.recipe_labels(np.array(rows))


def _results(
    judgements: Sequence[Judgement], graph: RecipeGraph
) -> dict[tuple[int, int], set[str]]:
    """Return the labels that each rated pair makes in the book, by pair in order."""
    pairs = sorted({judgement.pair for judgement in judgements})
    results = {pair: set(graph.labels(graph.outcomes.get(pair, ()))) for pair in pairs}
    if all(results.values()) or not any(results.values()):
        raise ConfigError(
            f"{graph.name} has only recipes or none among the rated pairs; expected "
            "little-alchemy-2."
        )
    return results


def with_right_option(judgements: Sequence[Judgement], graph: RecipeGraph) -> list[Judgement]:
    """Return the judgements whose four options hold a result of the pair."""
    results = _results(judgements, graph)
    return [each for each in judgements if results[each.pair] & set(each.options)]


def answers_of_people(judgements: Sequence[Judgement], graph: RecipeGraph) -> Answers:
    """Compare people with the book; the intervals resample people."""
    results = _results(judgements, graph)
    questions = with_right_option(judgements, graph)
    return Answers(
        area_under_curve(
            [bool(results[each.pair]) for each in judgements],
            [each.rating for each in judgements],
            [each.person for each in judgements],
        ),
        _share(
            [each.answer in results[each.pair] for each in questions],
            [each.person for each in questions],
        ),
    )


def answers_of_scorer(
    judgements: Sequence[Judgement], graph: RecipeGraph, name: str, scorer: RecipeScorer
) -> Answers:
    """Compare a recipe scorer with the book; the intervals resample pairs.

    Args:
        judgements: people's judgements, for the pairs and the four options of each.
        graph: the book's graph.
        name: the scorer's name in messages.
        scorer: a scorer for this graph.

    Raises:
        LeakError: if the scorer learned from rated pairs, or its sources cannot be known.
    """
    results = _results(judgements, graph)
    known = {(min(a, b), max(a, b)) for a, b, _ in scorer.recipes.tolist()} & set(results)
    if known or not len(scorer.recipes):
        seen = (
            f"trained on recipes of {len(known)}"
            if known
            else "made without recipes (`kg` none), its sources with"
        )
        raise LeakError(
            f"{name} was {seen} rated pairs. Write these recipes with --recipes FILE, and train "
            f"again: wordcraft-kg train-recipes {graph.name} --kg full --without FILE"
        )
    entities = torch.arange(graph.num_entities)
    scores = {
        pair: scorer.score_recipes(torch.tensor(pair[0]), torch.tensor(pair[1]), entities)
        for pair in results
    }
    ids = {label: entity for entity, label in enumerate(graph.entities)}
    number_of = {pair: number for number, pair in enumerate(results)}
    right, right_pairs = [], []
    for judgement in with_right_option(judgements, graph):
        of_pair = scores[judgement.pair]
        options = [option for option in judgement.options if option in ids]
        best = max(options, key=lambda option: float(of_pair[ids[option]]))
        right.append(best in results[judgement.pair])
        right_pairs.append(number_of[judgement.pair])
    return Answers(
        area_under_curve(
            [bool(made) for made in results.values()],
            [float(scores[pair].max()) for pair in results],
            list(number_of.values()),
        ),
        _share(right, right_pairs),
    )


def _share(right: Sequence[bool], clusters: Sequence[int]) -> Estimate:
    values = np.array(right, dtype=float)
    return Estimate(float(values.mean()), *interval(bootstrap(values, np.array(clusters))))


def area_under_curve(
    is_right: Sequence[bool], scores: Sequence[float], clusters: Sequence[int]
) -> Estimate:
    """Return the area under the ROC curve, and its 95 % interval by resampling whole clusters.

    The area is the share of (right, wrong) pairs of cases in which the right case has the higher
    score; ties count half. Resamples without a right or without a wrong case have no area, and are
    left out of the interval.

    Args:
        is_right: whether each of N cases is a right one.
        scores: score of each case.
        clusters: cluster of each case; cases of one cluster (a person, a pair) are drawn together.
    """
    _, cluster = np.unique(clusters, return_inverse=True)
    _, level = np.unique(scores, return_inverse=True)
    # Cases by (wrong or right, cluster, level of the score): a resample only weights the clusters.
    counts = np.zeros((2, cluster.max() + 1, level.max() + 1))
    np.add.at(counts, (np.array(is_right, dtype=int), cluster, level), 1)
    number = counts.shape[1]
    rng = np.random.default_rng(0)
    draws = rng.multinomial(number, np.full(number, 1 / number), size=RESAMPLES)
    # The first row holds each cluster once: the estimate itself.
    wrong, right = np.vstack([np.ones(number), draws]) @ counts
    wins = (right * (wrong.cumsum(axis=1) - wrong / 2)).sum(axis=1)
    cases = wrong.sum(axis=1) * right.sum(axis=1)
    value, *areas = wins[cases > 0] / cases[cases > 0]
    return Estimate(float(value), *interval(np.array(areas)))


def store(answers: dict[str, Answers], path: Path) -> None:
    """Write answers to a file, in place of its rows of the same names."""
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    rows = [row for row in old if row["row"] not in answers]
    for name, each in answers.items():
        rows.append(
            {
                "row": name,
                "auc": [round(value, 4) for value in each.auc],
                "right": [round(value, 4) for value in each.right],
            }
        )
    write_atomically(path, "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


def main() -> None:
    """Print the table, and write the recipes of rated pairs if asked."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", nargs="?", default="little-alchemy-2")
    parser.add_argument("--model", type=Path, help="model of train-recipes, without rated pairs")
    parser.add_argument("--recipes", type=Path, help="CSV file to write: recipes of rated pairs")
    parser.add_argument("--fetch", action="store_true", help="download the judgements, by SHA-256")
    parser.add_argument("--json", type=Path, help="file to write the rows to, after its other rows")
    given = parser.parse_args()
    graph = open_graph(given.graph).graph
    judgements = read_judgements(judgements_file(fetch=given.fetch), graph)
    rows = [("", "is it a recipe (AUC)", "which of four results")]
    by_name: dict[str, Answers] = {}
    if given.model is not None:
        scorer = whole_of(load_scorer(given.model, graph=graph))
        if not isinstance(scorer, RecipeScorer):
            raise ConfigError(
                f"{given.model} is not a recipe scorer; expected one of train-recipes."
            )
        answers = answers_of_scorer(judgements, graph, given.model.name, scorer)
        by_name[given.model.name] = answers
    by_name["one person"] = answers_of_people(judgements, graph)
    rows += [(name, str(each.auc), str(each.right)) for name, each in by_name.items()]
    rows.append(("chance", "0.500", "0.250"))
    if given.json is not None:
        store(by_name, given.json)
    if given.recipes is not None:
        with staged_file(given.recipes) as file:
            judged = RecipeBook("judged", judged_recipes(judgements, graph))
            write_atomically(file, recipe_table(judged))
    results = _results(judgements, graph)
    num_recipes = sum(bool(made) for made in results.values())
    questions = with_right_option(judgements, graph)
    print(
        f"{graph.name}: {len(results)} pairs, {num_recipes} of them recipes; "
        f"{len(judgements):,} ratings by people, {len(questions)} answers with a right option"
    )
    print(*aligned(rows), *(f"note: {caveat}" for caveat in CAVEATS), sep="\n")


if __name__ == "__main__":
    try:
        main()
    except WordCraftKGError as error:
        sys.exit(f"error: {error}")
