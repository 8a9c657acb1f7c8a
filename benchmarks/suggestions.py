"""How many removed recipes of a book are among the first suggestions?

    for seed in 0 1 2; do
        wordcraft-kg build-graph kitchen --split by-recipe --seed $seed --out graphs/kitchen-$seed
        wordcraft-kg train-recipes graphs/kitchen-$seed --out models/kitchen-$seed
        wordcraft-kg train-complex graphs/kitchen-$seed --folds 0 --out models/complex-kitchen-$seed
    done
    python benchmarks/suggestions.py models/kitchen-0 models/kitchen-1 models/kitchen-2 \
        --complex models/complex-kitchen-0 models/complex-kitchen-1 models/complex-kitchen-2

A split by-recipe removes a fifth of the recipes (its test part). Each method suggests recipes
outside the train part; a hit is a removed recipe. Precision@k is the share of hits among the first
k suggestions, recall@k the share of removed recipes among them. Intervals resample results: recipes
of one thing are found together.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import bootstrap, interval
from wordcraft_kg.evaluation.likely_recipes import PAIRS, RecipeFinder
from wordcraft_kg.evaluation.suggestions import open_suggesting, varied
from wordcraft_kg.graphs.arrays import Ids, are_among, recipe_keys
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.scorers.scorer import Scorer

FIRST = (20, 100)
"""Suggestions that count: a page, and five."""
RESULTS = 8
"""Results of a pair that ComplEx ranks: more than the first are never among the first 100."""
SUBSTITUTES = 20
"""Nearest words that may replace an ingredient."""


def ordered(rows: Ids, scores: np.ndarray, finder: RecipeFinder) -> Ids:
    """Return the recipes outside the book, each once, best first, on pages with variety."""
    low = rows[:, :2].min(axis=1)
    high = rows[:, :2].max(axis=1)
    rows = np.column_stack([low, high, rows[:, 2]])
    order = np.argsort(-scores, kind="stable")
    keys = recipe_keys(*rows[order].T, num_entities=finder.size)
    _, first = np.unique(keys, return_index=True)
    order = order[np.sort(first)]
    rows = rows[order]
    is_known = are_among(recipe_keys(*rows.T, num_entities=finder.size), finder.known)
    is_self = (rows[:, 2:] == rows[:, :2]).any(axis=1)
    rows = rows[~is_known & ~is_self][:20_000]
    return rows[varied(rows.tolist(), max(FIRST))]


def by_curve(finder: RecipeFinder) -> Ids:
    """Suggest by the calibrated curve of whole recipes, among the same candidates."""
    likely = finder.likely(finder.pairs_like_known())
    curve = finder.scorer.probabilities.recipes
    recipes = torch.from_numpy(likely.rows)
    values = [
        curve.log_probabilities(
            finder.whole.knowledge,
            part[:, 2],
            part[:, :2],
            torch.zeros(len(part), dtype=torch.int64),
            (torch.tensor([0]), torch.tensor([1])),
        )[:, 0]
        for part in recipes.split(4_096)
    ]
    return ordered(likely.rows, torch.cat(values).numpy(), finder)


def by_links(scorer: Scorer, finder: RecipeFinder) -> Ids:
    """Suggest by ComplEx: the sum of its three standardised link scores of a recipe.

    Without pairs of an entity with itself, whose links it scores far too high.
    """
    with torch.no_grad():
        pairs = scorer.table(COMBINES_WITH)
        parts = scorer.table(COMPONENT_OF)
    pairs = ((pairs + pairs.T) / 2 - pairs.mean()) / pairs.std()
    parts = (parts - parts.mean()) / parts.std()
    a, b = torch.triu_indices(finder.size, finder.size, 1)
    keys = (a * finder.size + b).numpy()
    scores = pairs[a, b].masked_fill(torch.from_numpy(are_among(keys, finder.known_pairs)), -99)
    best = scores.topk(min(PAIRS, len(scores))).indices
    a, b = a[best], b[best]
    sums, results = (parts[a] + parts[b]).topk(min(RESULTS, finder.size), dim=1)
    total = scores[best][:, None] + sums
    rows = torch.stack([a[:, None].expand_as(results), b[:, None].expand_as(results), results], 2)
    return ordered(rows.reshape(-1, 3).numpy(), total.flatten().numpy(), finder)


def by_words(finder: RecipeFinder) -> Ids:
    """Suggest known recipes with an ingredient replaced by a near word, added up by recipe."""
    vectors = finder.whole.knowledge.vectors.float()[: finder.size]
    cosines = vectors @ vectors.T
    cosines.fill_diagonal_(-1)
    near, neighbours = cosines.topk(min(SUBSTITUTES, finder.size - 1), dim=1)
    recipes = torch.from_numpy(finder.book)
    rows, scores = [], []
    for place in (0, 1):
        changed = neighbours[recipes[:, place]]
        table = recipes[:, None].repeat(1, changed.shape[1], 1)
        table[..., place] = changed
        rows.append(table.reshape(-1, 3))
        scores.append(near[recipes[:, place]].flatten())
    recipes = torch.cat(rows).numpy()
    # Powers as of the recipe scorer's kernel by words: the nearest ones count.
    weights = torch.cat(scores).clamp(min=0).numpy() ** 4
    keys = recipe_keys(*recipes.T, num_entities=finder.size)
    _, first, same = np.unique(keys, return_index=True, return_inverse=True)
    recipes, values = recipes[first], np.bincount(same, weights)
    pairs = recipe_keys(recipes[:, 0], recipes[:, 1], 0, num_entities=finder.size) // finder.size
    is_open = ~are_among(pairs, finder.known_pairs)
    return ordered(recipes[is_open], values[is_open], finder)


def at_random(finder: RecipeFinder) -> Ids:
    """Suggest unknown pairs of ingredients with a result, all that train recipes use, at random."""
    rng = np.random.default_rng(0)
    ingredients = np.unique(finder.book[:, :2])
    results = np.unique(finder.book[:, 2])
    rows = np.column_stack(
        [rng.choice(ingredients, 1_000), rng.choice(ingredients, 1_000), rng.choice(results, 1_000)]
    )
    return ordered(rows, np.zeros(len(rows)), finder)


def main() -> None:
    """Print precision and recall of each method, over all models together."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("models", type=Path, nargs="+", help="of train-recipes, one a split seed")
    parser.add_argument("--complex", type=Path, nargs="*", default=[], help="in the same order")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    suggested: dict[str, list[Ids]] = {}
    removed: list[Ids] = []
    promised = []
    for number, folder in enumerate(options.models):
        model = open_suggesting(folder)
        split = model.opened.split
        finder = RecipeFinder.of(model.scorer, split.recipes("train"))
        removed.append(np.sort(recipe_keys(*split.recipes("test").T, num_entities=finder.size)))
        likely = finder.likely(finder.pairs_like_known())
        rows = varied(likely.rows.tolist(), max(FIRST))
        promised.append(likely.probabilities[rows])
        methods: dict[str, Callable[[], Ids]] = {
            "suggest": lambda rows=rows, likely=likely: likely.rows[rows],
            "probability of the whole recipe": lambda finder=finder: by_curve(finder),
            "nearest words": lambda finder=finder: by_words(finder),
            "random": lambda finder=finder: at_random(finder),
        }
        if options.complex:
            scorer = open_model(options.complex[number]).scorer
            methods["ComplEx"] = lambda scorer=scorer, finder=finder: by_links(scorer, finder)
        for name, method in methods.items():
            suggested.setdefault(name, []).append(method())
    size = finder.size
    figures: dict[str, dict[str, float]] = {}
    num_removed = np.mean([len(keys) for keys in removed])
    for name, lists in suggested.items():
        figures[name] = {}
        for first in FIRST:
            heads = [rows[:first] for rows in lists]
            hits = [
                are_among(recipe_keys(*rows.T, num_entities=size), keys)
                for rows, keys in zip(heads, removed, strict=True)
            ]
            clusters = [rows[:, 2] + size * seed for seed, rows in enumerate(heads)]
            values = np.concatenate(hits).astype(float)
            means = bootstrap(values, np.concatenate(clusters))
            low, high = interval(means)
            share = first / num_removed
            figures[name] |= {
                f"precision@{first}": values.mean(),
                f"precision@{first} low": low,
                f"precision@{first} high": high,
                f"recall@{first}": values.mean() * share,
                f"recall@{first} low": low * share,
                f"recall@{first} high": high * share,
            }
    for first in FIRST:
        figures["suggest"][f"promised@{first}"] = float(
            np.mean([probabilities[:first].mean() for probabilities in promised])
        )
    for name, values in figures.items():
        cells = "  ".join(f"{key} {value:.3f}" for key, value in values.items())
        print(f"{name}: {cells}", flush=True)
    print(f"removed recipes, mean: {num_removed:.0f}")
    if options.json is not None:
        record = {"models": [path.name for path in options.models], "removed": num_removed}
        write_atomically(options.json, json.dumps(record | {"figures": figures}, indent=1))


if __name__ == "__main__":
    main()
