"""Choose the regularisation for ComplEx on small and large recipe books, with held-out train recipes.

No single weight suits hundreds and thousands of recipes, and on tens of thousands of entities a few epochs learn less
than the frequency rule. So short trainings hold out and rank train recipes, as the split does. Each training covers all
popularity weights, which change scores only.
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
from wordcraft_kg.models.links.outside import OutsideTriples
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.records import Candidate, Choice
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, rank_triples, sampled

SMALL = 2_000
"""Largest number of train recipes in a small book; larger books use the fixed default."""
FOLDS = 4
"""Number of held-out samples for a small book; a large book needs only one sample."""
HELD_OUT = 0.2
RANKED = 2_000
"""Largest number of ranked triples per fold; fewer above 30,000 entities."""
SHARE_OF_EPOCHS = 0.1
"""Epochs per fold as a fraction of all epochs: with two N3 weights and four folds, about one more training."""
N3 = (0.01, 0.1)
"""Candidate N3 weights for a small book."""
POPULARITY = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Candidate weights for the log counts. At 16 the counts nearly decide the order, and the embeddings break ties."""

CAUTION = 0.05
"""Share of the best MRR to trade for more popularity: short trainings overfit less than the full training."""


def choose(
    opened: OpenedGraph,
    settings: LinkSettings,
    after_epoch: Callable[[int, int], None],
    *,
    recipes: Ids | None = None,
    outside: OutsideTriples | None = None,
) -> Choice | None:
    """Choose the N3 weight and the weight of training counts in the scores (popularity), by MRR on held-out recipes.

    On a large book, N3 is fixed, and only popularity is chosen, if the settings use a sampled softmax.

    ``recipes`` (n, 3) are by default all train recipes; ``outside`` triples are in every training. ``after_epoch`` is
    called with the finished and total epochs; may raise to end the choice. The result has all candidates and the
    choice, most popularity among all candidates with nearly the best MRR; None without open weights, or with too few
    held-out triples.
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
            short = replace(
                settings, n3=n3, popularity=0.0, epochs=epochs, eval_every=0, patience=0
            )
            row += _reciprocal_ranks(fold, short, outside, lambda _: after_epoch(next(done), total))
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
    enough = (1 - CAUTION) * max(candidate.mrr for candidate in candidates)
    good = (candidate for candidate in candidates if candidate.mrr >= enough)
    return max(good, key=lambda candidate: (candidate.popularity, candidate.mrr))


def _folds(split: Split, recipes: Ids, seed: int, number: int) -> Iterator[Split]:
    for fold_seed in range(seed, seed + number):
        try:
            fold = split_of_train(split, HELD_OUT, fold_seed, recipes)
        except SplitError:  # raised if most entities occur only once
            continue
        if len(fold.held_out("test")):
            yield fold


def _queries(fold: Split) -> Ids:
    return sampled(fold.held_out("test"), min(RANKED, 2**26 // fold.graph.num_entities))


def _reciprocal_ranks(
    fold: Split,
    settings: ComplExConfig,
    outside: OutsideTriples | None,
    after_epoch: Callable[[int], None],
) -> np.ndarray:
    graph, seen = fold.graph, fold.partial
    model = fit(settings, triples_factory(graph, seen, outside), after_epoch, graph.num_entities)
    popular = (replace(settings, popularity=weight) for weight in POPULARITY)
    tensors = (scorer_tensors(each, model, seen, graph.num_entities) for each in popular)
    scorers = (make_scorer(*each, graph.entities, graph.hash) for each in tensors)
    ranks = [
        rank_triples(scorer, _queries(fold), graph.triples)
        for scorer in (*scorers, FrequencyScorer(graph, seen))
    ]
    return np.array([(1 / table["rank"]).sum() for table in ranks])


def split_of_train(split: Split, held_out: float, seed: int, recipes: Ids | None = None) -> Split:
    """Split the train recipes again into a train and a test part, with the same kind of split.

    ``held_out`` is the share of pairs, or goals, in the new test part; ``recipes`` (n, 3) are by default all train
    recipes. The new split's graph contains only these recipes, with the same entity ids. Raises SplitError if a part is
    empty.
    """
    recipes = split.recipes("train") if recipes is None else recipes
    graph = RecipeGraph(split.graph.entities, recipes, split.graph.base_ids, split.graph.name)
    return make_split(graph, SplitConfig(split.config.kind, train_ratio=1 - held_out, seed=seed))
