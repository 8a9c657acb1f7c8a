"""People's judgements of single ingredient pairs, and a recipe scorer's answers to the same questions.

Brändle et al. (2023) asked 103 people about pairs of Little Alchemy 2: do these two combine (1 to 7), and which of four
things do they make? The file is published under the MIT licence.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from msgspec.structs import replace

from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.errors import ArtefactError, ConfigError, LeakError
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.base.statistics import RESAMPLES, bootstrap, interval
from wordcraft_kg.graphs.library import cache_folder, data_folder, fetch_file
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.models.scorers.recipes import RecipeScorer

FILE = "validation_behavior.json"
URL = (
    "https://raw.githubusercontent.com/franziskabraendle/alchemy_empowerment/8f6537658d2902fca48aa03227ae38f27c14b6dd"
    f"/empowermentexploration/additionalexperiments/validation_analysis/{FILE}"
)
SHA256 = "2778f542776823def65ee1824c396a588a3ec8ed69e3f2208db48618f79c8e74"
CAVEATS = (
    "the pairs are balanced on a prediction model's answer, so recipes are far more frequent than in the book",
    "the four options come from the same model",
    "most people had not played the game (23 of 103 had)",
    "a pair outside the book may be sensible",
)
_Bounds = tuple[Share, Share]


class Judgement(NamedTuple):
    """A person's answers about a pair: rating from 1 to 7, chosen result and the four options, as labels."""

    person: int
    pair: tuple[int, int]
    rating: int
    answer: str
    options: tuple[str, ...]


class PairView(Record, omit_defaults=True):
    """People and a scorer on single pairs.

    Attributes:
        pairs: number of pairs with both ingredients in the graph.
        recipes: number of them that are recipes.
        judgements: number of ratings by people.
        auc_people: area under the ROC curve for one person's rating of "is it a recipe"; .5 is chance.
        auc: the same for the scorer's best score for any result, over pairs.
        questions: answers by people to "which of four results" with a right option.
        right_people: share of right answers; .25 is chance.
        right: the same for the scorer.
        auc_people_ci, right_people_ci, auc_ci, right_ci: 95 % intervals, by resampling people, or pairs for the scorer.
        caveats: limits of the comparison.
    """

    graph: str
    hash: Hash
    pairs: Count
    recipes: Count
    judgements: Count
    questions: Count
    auc_people: Share
    auc_people_ci: _Bounds
    right_people: Share
    right_people_ci: _Bounds
    model: str | None = None
    auc: Share | None = None
    auc_ci: _Bounds | None = None
    right: Share | None = None
    right_ci: _Bounds | None = None
    caveats: tuple[str, ...] = CAVEATS


def judgements_file(*, fetch: bool = False) -> Path:
    """Return the published file; ArtefactError if missing or changed, FetchError if a download fails."""
    data, cached = data_folder(), cache_folder() / "alchemy_pairs" / FILE
    own = [data / "alchemy_pairs" / FILE] if data else []
    path = next((path for path in (*own, cached) if path.is_file()), None)
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
    """Return all judgements of pairs with both ingredients in the graph."""
    ids = {label: entity for entity, label in enumerate(graph.entities)}
    judgements = []
    for number, person in enumerate(json.loads(path.read_text(encoding="utf-8")).values()):
        columns = (
            "currentcombinationstring",
            "linkanswers",
            "elementanswers",
            "elementoptionsshuffeld",
        )
        for pair, rating, answer, options in zip(*(person[name] for name in columns), strict=True):
            if pair[0] in ids and pair[1] in ids:
                a, b = sorted(ids[label] for label in pair)
                judgements.append(Judgement(number, (a, b), int(rating), answer, tuple(options)))
    if not judgements:
        raise ConfigError(f"{graph.name} has none of the rated pairs; expected little-alchemy-2.")
    return judgements


def judged_recipes(judgements: Sequence[Judgement], graph: RecipeGraph) -> list[Recipe]:
    """Return the graph's recipes of rated pairs, as labels: a model that is judged must not know them."""
    pairs = {judgement.pair for judgement in judgements}
    return graph.recipe_labels(
        np.array([row for row in graph.recipes.tolist() if (row[0], row[1]) in pairs])
    )


def view_pairs(
    judgements: Sequence[Judgement],
    graph: RecipeGraph,
    model: tuple[str, RecipeScorer] | None = None,
) -> PairView:
    """Compare people and a named scorer with the graph; LeakError if the scorer learned from judged pairs."""
    pairs = sorted({judgement.pair for judgement in judgements})
    results = {pair: set(graph.labels(graph.outcomes.get(pair, ()))) for pair in pairs}
    questions = [
        judgement for judgement in judgements if results[judgement.pair] & {*judgement.options}
    ]
    if not questions or all(results.values()):
        raise ConfigError(
            f"{graph.name} has only recipes or none among the rated pairs; expected little-alchemy-2."
        )
    people = [judgement.person for judgement in judgements]
    is_recipe = [bool(results[judgement.pair]) for judgement in judgements]
    auc, auc_ci = area_under_curve(
        is_recipe, [judgement.rating for judgement in judgements], people
    )
    right = [judgement.answer in results[judgement.pair] for judgement in questions]
    share, share_ci = _share(right, [judgement.person for judgement in questions])
    view = PairView(
        graph=graph.name,
        hash=graph.hash,
        pairs=len(pairs),
        recipes=sum(map(bool, results.values())),
        judgements=len(judgements),
        questions=len(questions),
        auc_people=auc,
        auc_people_ci=auc_ci,
        right_people=share,
        right_people_ci=share_ci,
    )
    if model is None:
        return view
    name, scorer = model
    known = {(min(a, b), max(a, b)) for a, b, _ in scorer.recipes.tolist()} & {*pairs}
    if known or not len(scorer.recipes):
        seen = (
            f"trained on recipes of {len(known)}"
            if known
            else "made without recipes (`kg` none), its sources with"
        )
        raise LeakError(
            f"{name} was {seen} rated pairs. Write these recipes with --recipes FILE, and train again: "
            f"wordcraft-kg train-recipes {graph.name} --kg full --without FILE"
        )
    entities = torch.arange(graph.num_entities)
    scores = {
        pair: scorer.score_recipes(torch.tensor(pair[0]), torch.tensor(pair[1]), entities)
        for pair in pairs
    }
    ids = {label: entity for entity, label in enumerate(graph.entities)}
    right = []
    for judgement in questions:
        options = [option for option in judgement.options if option in ids]
        best = max(options, key=lambda option: float(scores[judgement.pair][ids[option]]))
        right.append(best in results[judgement.pair])
    best_scores = [float(scores[pair].max()) for pair in pairs]
    auc, auc_ci = area_under_curve(
        [bool(results[pair]) for pair in pairs], best_scores, range(len(pairs))
    )
    share, share_ci = _share(right, [pairs.index(judgement.pair) for judgement in questions])
    return replace(view, model=name, auc=auc, auc_ci=auc_ci, right=share, right_ci=share_ci)


def _share(right: Sequence[bool], clusters: Sequence[int]) -> tuple[float, _Bounds]:
    return float(np.mean(right)), interval(
        bootstrap(np.array(right, dtype=float), np.array(clusters))
    )


def area_under_curve(
    is_right: Sequence[bool], scores: Sequence[float], clusters: Sequence[int]
) -> tuple[float, _Bounds]:
    """Return the area under the ROC curve, and its 95 % interval by resampling whole clusters."""
    _, cluster = np.unique(clusters, return_inverse=True)
    _, level = np.unique(scores, return_inverse=True)
    counts = np.zeros((2, cluster.max() + 1, level.max() + 1))
    np.add.at(counts, (np.array(is_right, dtype=int), cluster, level), 1)
    number = counts.shape[1]
    draws = np.random.default_rng(0).multinomial(
        number, np.full(number, 1 / number), size=RESAMPLES
    )
    wrong, right = np.vstack([np.ones(number), draws]) @ counts
    wins, cases = (
        (right * (wrong.cumsum(axis=1) - wrong / 2)).sum(axis=1),
        wrong.sum(axis=1) * right.sum(axis=1),
    )
    value, *areas = wins[cases > 0] / cases[cases > 0]
    return float(value), interval(np.array(areas))
