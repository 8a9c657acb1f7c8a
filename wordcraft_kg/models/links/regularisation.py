"""Choosing the regularisation of ComplEx on a small book, by what held-out train recipes say.

A weight that suits thousands of recipes is wrong for hundreds, and no single one suits them all. So a few short
trainings leave out a part of the train recipes, as the split left out the test recipes, and rank it. Each training
serves all weights of popularity, which only changes the scores.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import numpy as np
import torch

from wordcraft_kg.errors import SplitError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import ComplExConfig, LinkSettings
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.folds import split_of_train
from wordcraft_kg.models.links.popularity import log_counts
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.records import Candidate, Choice
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES

SMALL = 2_000
"""Most train recipes of a small book; above it the fixed default was chosen on validation parts."""
FOLDS = 4
HELD_OUT = 0.2
SHARE_OF_EPOCHS = 0.1
"""Each fold trains for this share of the epochs, so that all of them take no longer than the training itself."""
N3 = (0.01, 0.1)
POPULARITY = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Weights of the log counts. At 16 they nearly decide the order alone, and the embeddings break their ties."""


def choose(opened: OpenedGraph, settings: LinkSettings, after_epoch: Callable[[int, int], None]) -> Choice | None:
    """Choose N3 weight and popularity if they are left open and the book is small.

    Args:
        opened: graph and split; only the train recipes are used.
        settings: those of the training.
        after_epoch: called with the number of epochs trained and their total; what it raises ends the choice.

    Returns:
        the best candidate by MRR of the held-out triples, with all others; None if there is nothing to choose, or too
        little to choose on.
    """
    split = opened.split
    if not isinstance(settings, ComplExConfig) or not settings.is_open or int(split.is_in("train").sum()) > SMALL:
        return None
    folds = list(_folds(split, settings.seed))
    queries = 2 * sum(len(fold.held_out("test")) for fold in folds)
    if queries < 2 * MIN_TRIPLES:
        return None
    epochs = max(round(SHARE_OF_EPOCHS * settings.epochs), 1)
    total, done = len(N3) * len(folds) * epochs, count(1)
    sums = np.zeros((len(N3), len(POPULARITY) + 1))
    for row, n3 in zip(sums, N3, strict=True):
        for fold in folds:
            short = replace(settings, n3=n3, popularity=0.0, epochs=epochs, eval_every=0, patience=0)
            row += _reciprocal_ranks(fold, short, lambda _: after_epoch(next(done), total))
    means = sums / queries
    candidates = [
        Candidate(n3=n3, popularity=popularity, mrr=float(mrr))
        for n3, row in zip(N3, means, strict=True)
        for popularity, mrr in zip(POPULARITY, row, strict=False)
    ]
    best = max(candidates, key=lambda candidate: candidate.mrr)
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


def _folds(split: Split, seed: int) -> Iterator[Split]:
    """Yield the splits of the train recipes that leave something to rank."""
    for number in range(FOLDS):
        try:
            fold = split_of_train(split, HELD_OUT, seed + number)
        except SplitError:  # on a book where most entities occur once, nothing can be held out
            continue
        if len(fold.held_out("test")):
            yield fold


def _reciprocal_ranks(fold: Split, settings: ComplExConfig, after_epoch: Callable[[int], None]) -> np.ndarray:
    """Train on a fold and rank what it holds out.

    Returns:
        shape (P + 1,): sum of the reciprocal ranks for each of :data:`POPULARITY`, and for the log counts alone.
    """
    graph, held_out = fold.graph, fold.held_out("test")
    model = fit(settings, triples_factory(graph, fold.partial), after_epoch)
    scorer = make_scorer(*scorer_tensors(settings, model, fold.partial), graph.entities, graph.hash)
    as_head, as_tail = log_counts(fold.partial, graph.num_entities)
    scores = torch.stack([scorer.table(relation) for relation in range(len(as_head))])
    known = torch.zeros_like(scores, dtype=torch.bool)
    known[tuple(torch.from_numpy(graph.triples[:, [1, 0, 2]].copy()).T)] = True
    heads, relations, tails = torch.from_numpy(held_out.copy()).T
    sides = (
        (scores[relations, heads], as_tail[relations], known[relations, heads], tails),
        (scores[relations, :, tails], as_head[relations], known[relations, :, tails], heads),
    )
    weights = [(1.0, popularity) for popularity in POPULARITY] + [(0.0, 1.0)]
    return np.array(
        [
            sum(
                filtered_ranks(a * x + b * counts, out, true).reciprocal().sum().item()
                for x, counts, out, true in sides
            )
            for a, b in weights
        ]
    )


def filtered_ranks(scores: torch.Tensor, known: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """Return the realistic ranks of the true entities, as :func:`~wordcraft_kg.models.scorers.ranking.rank_triples`.

    Args:
        scores: shape (Q, E).
        known: shape (Q, E), bool: entities that do not compete.
        true: shape (Q,), ids.

    Returns:
        shape (Q,), float.
    """
    reference = scores.gather(1, true[:, None])
    competing = scores.masked_fill(known.scatter(1, true[:, None], True), -torch.inf)
    return 1 + (competing > reference).sum(1) + (competing == reference).sum(1) / 2
