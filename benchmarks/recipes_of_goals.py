"""The best recipe of an unseen goal on a book of pairs: how often is the first pair right?

    wordcraft-kg build-graph everyday --split by-goal --out graphs/goals
    wordcraft-kg train-recipes graphs/goals --out models/pairs
    wordcraft-kg train-complex graphs/goals --folds 0 --out models/links
    wordcraft-kg train-recipes graphs/goals --parts none --features minilm --out models/sets
    python -m benchmarks.recipes_of_goals models/pairs models/links models/sets

Prints the lines of docs/evidence/tables.csv for the page of inorganic materials, with intervals of
Wilson, and each method's lead over nearest words, goals resampled in pairs.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg import open_model
from wordcraft_kg.base.statistics import paired_difference, wilson_interval
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.features import make_features
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

SHOWN = (1, 5, 10)
SHORTLIST = 150
"""Ingredients whose pairs the recipe scorer compares for a goal."""
Pairs = list[tuple[str, ...]]


def sets_of_model(folder: Path, goals: list[str]) -> list[Pairs]:
    """Return the first sets that a model of sets suggests for each goal."""
    scorer = open_model(folder).scorer
    assert isinstance(scorer, SetScorer)
    ranked = (scorer.recipes(goal, max(SHOWN)) for goal in goals)
    return [
        [tuple(sorted(scorer.entities[entity] for entity in each.ingredients)) for each in sets]
        for sets in ranked
    ]


def pairs_of_recipes(folder: Path, goals: list[str]) -> list[Pairs]:
    """Rank the pairs of the ingredients that best link to each goal by a recipe scorer."""
    scorer = whole_of(open_model(folder).scorer)
    assert isinstance(scorer, RecipeScorer)
    entities = scorer.entities
    answers = []
    for goal in scorer.entity_ids(goals).tolist():
        links = scorer.score(torch.arange(len(entities)), COMPONENT_OF, goal)
        links[goal] = -torch.inf
        shortlist = torch.topk(links, SHORTLIST).indices
        pairs = torch.combinations(shortlist, with_replacement=True)
        scores = scorer.score_recipes(pairs[:, 0], pairs[:, 1], goal)
        best = torch.sort(scores, descending=True, stable=True).indices[: max(SHOWN)]
        answers.append([tuple(sorted(entities[int(each)] for each in pairs[row])) for row in best])
    return answers


def pairs_of_links(model: Model, goals: list[str]) -> list[Pairs]:
    """Rank all pairs by the links of both to the goal, and between them."""
    scorer = whole_of(model.scorer)
    together = scorer.table(COMBINES_WITH)
    parts = scorer.table(COMPONENT_OF)
    ids = scorer.entity_ids(goals).tolist()
    return [
        best_pairs(together + parts[:, goal, None] + parts[None, :, goal], goal, scorer.entities)
        for goal in ids
    ]


def pairs_of_words(model: Model, goals: list[str]) -> list[Pairs]:
    """Rank all pairs by the similarity of both words to the goal's."""
    entities = model.opened.graph.entities
    vectors = torch.tensor(make_features("minilm", entities).unit_vectors)
    ids = model.opened.graph.ids_of(goals)
    cosines = vectors @ vectors.T
    return [
        best_pairs(cosines[goal, :, None] + cosines[goal, None], int(goal), entities)
        for goal in ids
    ]


def best_pairs(scores: torch.Tensor, goal: int, entities: tuple[str, ...]) -> Pairs:
    """Return the best pairs of a symmetric table, shape (E, E); the goal makes nothing of itself."""
    scores = scores.clone()
    scores[goal] = scores[:, goal] = -torch.inf
    size = len(scores)
    flat = scores.masked_fill(torch.ones(size, size).tril(-1).bool(), -torch.inf).flatten()
    rows = torch.topk(flat, max(SHOWN)).indices.tolist()
    return [tuple(sorted((entities[row // size], entities[row % size]))) for row in rows]


def main() -> None:
    """Rank pairs for all test goals, and print the lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("pairs", "links", "sets"):
        parser.add_argument(name, type=Path)
    given = parser.parse_args()
    model = open_model(given.links)
    split = model.opened.split
    right: dict[str, set[tuple[str, ...]]] = defaultdict(set)
    for recipe in split.recipes("test").tolist():
        *ingredients, result = (model.opened.graph.entities[each] for each in recipe)
        right[result].add(tuple(sorted(ingredients)))
    goals = sorted(right)
    methods = {
        "nearest words": pairs_of_words(model, goals),
        "ComplEx": pairs_of_links(model, goals),
        "model of sets, by words": sets_of_model(given.sets, goals),
        "**recipe scorer of pairs**": pairs_of_recipes(given.pairs, goals),
    }
    hits: dict[str, NDArray[np.bool_]] = {}
    for name, answers in methods.items():
        rows = [
            [not right[goal].isdisjoint(pairs[:k]) for k in SHOWN]
            for goal, pairs in zip(goals, answers, strict=True)
        ]
        hits[name] = np.array(rows)
    for name, table in hits.items():
        for column, k in enumerate(SHOWN):
            share = table[:, column].mean()
            low, high = wilson_interval(float(table[:, column].sum()), len(table))
            cell = f"{share:.3f},{low:.3f},{high:.3f}"
            print(f"inorganic-synthesis,everyday,{name},top-{k},{cell}")
        words = hits["nearest words"]
        if table is not words:
            lead, low, high = paired_difference(table[:, [0]], words[:, [0]], None)
            cell = f"{lead:+.3f},{low:+.3f},{high:+.3f}"
            print(f"inorganic-synthesis,everyday,{name},lead over words at one,{cell}")
    print(f"{len(goals)} goals")


if __name__ == "__main__":
    main()
