"""Choosing the regularisation of ComplEx on a small or a large book, by ranking train recipes that are held out.

A weight that suits thousands of recipes is wrong for hundreds, and no single one suits them all. On tens of thousands
of entities a few epochs teach less than counting does. So short trainings leave out a part of the train recipes, as the
split left out the test recipes, and rank it. Each training serves all weights of popularity, which only change scores.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import numpy as np

from wordcraft_kg.base.errors import SplitError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split, SplitConfig, make_split
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import N3_PARTIAL, ComplExConfig, LinkSettings
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.records import Candidate, Choice
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, rank_triples, sampled

SMALL = 2_000
"""Most train recipes of a small book; above it the fixed default was chosen on validation parts."""
FOLDS = 4
"""For a small book; a large one has enough to rank in a single one."""
HELD_OUT = 0.2
RANKED = 2_000
"""Most held-out triples that are ranked in a fold; fewer of more than 30,000 entities, where each takes longer."""
SHARE_OF_EPOCHS = 0.1
"""Each fold trains for this share of the epochs: with two N3 weights and four folds, about one training more."""
N3 = (0.01, 0.1)
"""For a small book."""
POPULARITY = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Weights of the log counts. At 16 they nearly decide the order alone, and the embeddings break their ties."""

CAUTION = 0.05
"""Share of the best MRR that is given up for more popularity: the short trainings overfit less than the whole one."""


def choose(
    opened: OpenedGraph,
    settings: LinkSettings,
    after_epoch: Callable[[int, int], None],
    *,
    recipes: Ids | None = None,
) -> Choice | None:
    """Choose N3 weight and popularity if they are left open and the book is small, or popularity if it is large.

    A large book is one whose softmax is over a sample of the entities.

    Args:
        opened: graph and split; only the train recipes are used.
        settings: those of the training.
        after_epoch: called with the number of epochs trained and their total; what it raises ends the choice.
        recipes: those that are learned from, if these are not all train recipes, shape (n, 3).

    Returns:
        the candidate with the most popularity of those whose MRR of the held-out triples is nearly the best, with all
        others; None if there is nothing to choose, or too little to choose on.
    """
    split = opened.split
    if not isinstance(settings, ComplExConfig) or not settings.is_open:
        return None
    recipes = split.recipes("train") if recipes is None else recipes
    is_small = len(recipes) <= SMALL
    if not is_small and not settings.negatives:
        return None
    weights = N3 if is_small else (N3_PARTIAL,)
    folds = list(_folds(split, recipes, settings.seed, FOLDS if is_small else 1))
    queries = 2 * sum(len(_queries(fold)) for fold in folds)
    if queries < 2 * MIN_TRIPLES:
        return None
    epochs = max(round(SHARE_OF_EPOCHS * settings.epochs), 1)
    total, done = len(weights) * len(folds) * epochs, count(1)
    sums = np.zeros((len(weights), len(POPULARITY) + 1))
    for row, n3 in zip(sums, weights, strict=True):
        for fold in folds:
            short = replace(settings, n3=n3, popularity=0.0, epochs=epochs, eval_every=0, patience=0)
            row += _reciprocal_ranks(fold, short, lambda _: after_epoch(next(done), total))
    means = sums / queries
    candidates = [
        Candidate(n3=n3, popularity=popularity, mrr=float(mrr))
        for n3, row in zip(weights, means, strict=True)
        for popularity, mrr in zip(POPULARITY, row, strict=False)
    ]
    chosen = _best(candidates)
    return Choice(
        n3=chosen.n3,
        popularity=chosen.popularity,
        mrr=chosen.mrr,
        frequency_mrr=float(means[0, -1]),
        candidates=tuple(candidates),
        folds=len(folds),
        epochs=epochs,
        queries=queries,
    )


def _best(candidates: list[Candidate]) -> Candidate:
    """Return the candidate with the most popularity of those whose MRR is nearly the best."""
    enough = (1 - CAUTION) * max(candidate.mrr for candidate in candidates)
    good = (candidate for candidate in candidates if candidate.mrr >= enough)
    return max(good, key=lambda candidate: (candidate.popularity, candidate.mrr))


def _folds(split: Split, recipes: Ids, seed: int, number: int) -> Iterator[Split]:
    """Yield the splits of the recipes that leave something to rank."""
    for fold_seed in range(seed, seed + number):
        try:
            fold = split_of_train(split, HELD_OUT, fold_seed, recipes)
        except SplitError:  # on a book where most entities occur once, nothing can be held out
            continue
        if len(fold.held_out("test")):
            yield fold


def _queries(fold: Split) -> Ids:
    return sampled(fold.held_out("test"), min(RANKED, 2**26 // fold.graph.num_entities))


def _reciprocal_ranks(fold: Split, settings: ComplExConfig, after_epoch: Callable[[int], None]) -> np.ndarray:
    """Train on a fold and rank what it holds out.

    Returns:
        shape (P + 1,): sum of the reciprocal ranks for each of :data:`POPULARITY`, and for counting alone.
    """
    graph, seen = fold.graph, fold.partial
    model = fit(settings, triples_factory(graph, seen), after_epoch)
    popular = (replace(settings, popularity=weight) for weight in POPULARITY)
    scorers = (make_scorer(*scorer_tensors(one, model, seen), graph.entities, graph.hash) for one in popular)
    ranks = [rank_triples(scorer, _queries(fold), graph.triples) for scorer in (*scorers, FrequencyScorer(graph, seen))]
    return np.array([(1 / one["rank"]).sum() for one in ranks])


def split_of_train(split: Split, held_out: float, seed: int, recipes: Ids | None = None) -> Split:
    """Split the train recipes once more, in the way that the whole graph was split.

    Args:
        split: the split whose train recipes are taken.
        held_out: share of their pairs, or goals, to hold out as the test part of the result.
        seed: seed of the draw.
        recipes: those to split instead of all train recipes, shape (n, 3).

    Returns:
        a split of a graph that has these recipes and, with the same ids, all entities.

    Raises:
        SplitError: if a part is empty because there are too few train recipes.
    """
    recipes = split.recipes("train") if recipes is None else recipes
    graph = RecipeGraph(split.graph.entities, recipes, split.graph.base_ids, split.graph.name)
    return make_split(graph, SplitConfig(split.config.kind, train_ratio=1 - held_out, seed=seed))
