"""Choose the regularisation for ComplEx on small and large recipe books, by train recipes alone.

No single weight suits hundreds and thousands of recipes, and on tens of thousands of entities a few
epochs learn less than the frequency rule. So short trainings hold out and rank train recipes, as
the split holds out test recipes. Each training covers all popularity weights, which change scores
only. Validation and test recipes are not read.

The page docs/evidence/links.md#complex has the measurements.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import numpy as np

from wordcraft_kg.base.errors import SplitError
from wordcraft_kg.graphs import Ids, OpenedGraph, RecipeGraph, Split, SplitConfig, make_split
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import N3_PARTIAL, ComplExConfig, LinkSettings
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.outside import OutsideTriples
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.records import Candidate, Choice
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, rank_triples, sampled
from wordcraft_kg.models.scorers.scorer import Scorer

SMALL = 2_000
"""Largest number of train recipes in a small book; larger books use the fixed default."""
FOLDS = 4
"""Number of held-out samples for a small book; a large book needs only one sample."""
HELD_OUT = 0.2
"""Share of the pairs (goals) of train recipes that a sample holds out."""
RANKED = 2_000
"""Largest number of ranked triples per fold; fewer above 30,000 entities."""
SHARE_OF_EPOCHS = 0.1
"""Epochs per fold as a fraction of all epochs.

With two N3 weights and four folds, the choice takes about as long as another training.
"""
N3 = (0.01, 0.1)
"""Candidate N3 weights for a small book."""
POPULARITY = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Candidate weights for the log counts.

At 16 the counts nearly decide the order, and the embeddings break ties.
"""

CAUTION = 0.05
"""Share of the best MRR to trade for more popularity.

Short trainings overfit less than the full training, so they favour the embeddings too much.
"""


def choose(
    opened: OpenedGraph,
    settings: LinkSettings,
    after_epoch: Callable[[int, int], None],
    *,
    recipes: Ids | None = None,
    outside: OutsideTriples | None = None,
) -> Choice | None:
    """Choose the N3 weight and the weight of training counts in the scores (popularity), if open.

    On a large book, N3 is fixed, and only popularity is chosen, if the settings use a sampled
    softmax.

    Args:
        opened: graph and split; only the train recipes are read.
        settings: settings of the training.
        after_epoch: called with the finished and the total epochs; may raise to end the choice.
        recipes: training recipes, rows of ``graph.sets``; None for all train recipes.
        outside: triples from outside the book, in every training; None without.

    Returns:
        the candidate with most popularity among all candidates with nearly the best MRR on held-out
        recipes, and all candidates; None without open weights, or with too few held-out triples.

    Raises:
        TrainingError: if a loss is not finite.
    """
    split = opened.split
    # Other models have neither weight, and given weights are kept.
    if not isinstance(settings, ComplExConfig) or not settings.is_open:
        return None
    recipes = split.sets("train") if recipes is None else recipes
    is_small = len(recipes) <= SMALL
    if not is_small and not settings.negatives:
        return None
    weights = N3 if is_small else (N3_PARTIAL,)
    num_folds = FOLDS if is_small else 1
    folds = list(_folds(split, recipes, settings.seed, num_folds))
    queries = 2 * sum(len(_queries(fold)) for fold in folds)
    if queries < 2 * MIN_TRIPLES:
        return None
    epochs = max(round(SHARE_OF_EPOCHS * settings.epochs), 1)
    total = len(weights) * len(folds) * epochs
    epoch_number = count(1)
    # By N3 weight, and by popularity with the frequency rule last.
    sums = np.zeros((len(weights), len(POPULARITY) + 1))
    for row, n3 in zip(sums, weights, strict=True):
        for fold in folds:
            # Without popularity: it changes scores only, so one training serves all weights.
            short = replace(settings, n3=n3, popularity=0.0, epochs=epochs, eval_every=0)
            row += _reciprocal_ranks(
                fold, short, outside, lambda _: after_epoch(next(epoch_number), total)
            )
    means = sums / queries
    candidates = []
    for n3, row in zip(weights, means[:, :-1].tolist(), strict=True):
        for popularity, mrr in zip(POPULARITY, row, strict=True):
            candidates.append(Candidate(n3=n3, popularity=popularity, mrr=mrr))
    best = _best(candidates)
    return Choice(
        n3=best.n3,
        popularity=best.popularity,
        mrr=best.mrr,
        frequency_mrr=float(means[0, -1]),
        candidates=tuple(candidates),
        folds=len(folds),
        epochs=epochs,
        queries=queries,
    )


def _best(candidates: list[Candidate]) -> Candidate:
    # Most popularity first; the MRR decides between N3 weights.
    threshold = (1 - CAUTION) * max(candidate.mrr for candidate in candidates)
    good = [candidate for candidate in candidates if candidate.mrr >= threshold]
    return max(good, key=lambda candidate: (candidate.popularity, candidate.mrr))


def _folds(split: Split, recipes: Ids, seed: int, number: int) -> Iterator[Split]:
    """Yield the splits of train recipes that leave something to rank, at most ``number``."""
    for fold_seed in range(seed, seed + number):
        try:
            fold = split_of_train(split, HELD_OUT, fold_seed, recipes)
        except SplitError:
            # Happens in small books if most entities occur only once.
            continue
        if len(fold.held_out("test")):
            yield fold


def _queries(fold: Split) -> Ids:
    # Each query scores all entities for each popularity weight.
    return sampled(fold.held_out("test"), min(RANKED, 2**26 // fold.graph.num_entities))


def _reciprocal_ranks(
    fold: Split,
    settings: ComplExConfig,
    outside: OutsideTriples | None,
    after_epoch: Callable[[int], None],
) -> np.ndarray:
    """Train on a fold and rank what it holds out.

    Returns:
        shape (P + 1,): sums of reciprocal ranks for the P weights in :data:`POPULARITY`, and for
        counts alone.
    """
    graph = fold.graph
    trained_on = fold.partial
    queries = _queries(fold)
    model = fit(
        settings, triples_factory(graph, trained_on, outside), after_epoch, graph.num_entities
    )
    sums = []
    for weight in POPULARITY:
        popular = replace(settings, popularity=weight)
        tensors = scorer_tensors(popular, model, trained_on, graph.num_entities)
        scorer = make_scorer(*tensors, graph.entities, graph.hash)
        sums.append(_sum_of_reciprocal_ranks(scorer, queries, graph))
    sums.append(_sum_of_reciprocal_ranks(FrequencyScorer(graph, trained_on), queries, graph))
    return np.array(sums)


def _sum_of_reciprocal_ranks(scorer: Scorer, queries: Ids, graph: RecipeGraph) -> float:
    ranks = rank_triples(scorer, queries, graph.triples)
    return float((1 / ranks["rank"]).sum())


def split_of_train(split: Split, held_out: float, seed: int, recipes: Ids | None = None) -> Split:
    """Split the train recipes again into a train and a test part, with the same kind of split.

    Settings chosen on this test part have seen neither the validation nor the test recipes. With
    the same kind of split, the choice meets the same difficulty as the test: whole goals are held
    out for by-goal, single pairs for by-recipe. There is no validation part.

    Args:
        split: split whose train recipes are split again.
        held_out: share of their pairs, or goals, in the new test part.
        seed: seed of the draw.
        recipes: recipes to split, rows of ``graph.sets``; None for all train recipes.

    Returns:
        a split of a graph with these recipes and all entities, with the same entity ids.

    Raises:
        SplitError: if a part is empty, because there are too few train recipes.
    """
    recipes = split.sets("train") if recipes is None else recipes
    graph = RecipeGraph(split.graph.entities, recipes, split.graph.base_ids, split.graph.name)
    return make_split(graph, SplitConfig(split.config.kind, train_ratio=1 - held_out, seed=seed))
