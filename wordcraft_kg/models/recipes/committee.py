"""Fit a committee of rankers: small networks that learn from the same queries; their mean scores.

Held-out recipes are few and their features many, so a single network learns noise too. The mean of
three networks that begin with different weights errs less: on validation parts of by-goal splits 0
to 2 it solves .461 and .783 of the tasks of Little Alchemy 2 with 8 and 1 distractors, a single
network .450 and .769. See "The rankers" in docs/explanation/recipe-scorer.md.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from wordcraft_kg.models.scorers.ranker import Ranker

HIDDEN = 32
"""Hidden units of a network; 64 are worse, 16 as well."""


class Schedule(NamedTuple):
    """How a committee learns.

    Attributes:
        members: networks.
        batch: queries of a step.
        epochs: passes over all queries.
        rate: largest step size.
        steps: fewest steps: more passes over the queries of a small book.
    """

    members: int
    batch: int
    epochs: int
    rate: float
    steps: int


TABLES = Schedule(members=3, batch=256, epochs=6, rate=1e-2, steps=60)
"""For tables: four networks are no better, nor are 10 epochs, with several draws of distractors
for each recipe; half and twice the step size give the same success within .005."""
LINKS = Schedule(members=1, batch=64, epochs=5, rate=1e-2, steps=60)
"""For links: three networks, 10 epochs or smaller batches are no better."""
WEIGHT_DECAY = 1e-4
_SMALL = 1e-6
"""Deviations and spans up to this number are rounding."""


class Examples(NamedTuple):
    """Queries from which rankers learn: N queries with P candidates.

    A query is a table, whose candidates are pairs of slots, or an open link.

    Attributes:
        features: shape (N, P, F).
        competes: shape (N, P): whether a candidate counts: a pair without empty slots, an unknown
            link or the right one.
        is_right: shape (N, P): whether the pair makes the goal by a recipe that the model knows, or
            the link is the one asked for.
    """

    features: Tensor
    competes: Tensor
    is_right: Tensor


def fit_committee(
    examples: Examples,
    generator: torch.Generator,
    schedule: Schedule = TABLES,
) -> Ranker:
    """Fit networks that score right candidates above competing ones, and return their mean.

    The loss of a query is ``-log Σ_right softmax(scores)``, minimised by AdamW with one cycle of
    the step size. All networks see the queries in the same order, and do not meet.

    Args:
        examples: queries with a right candidate each.
        generator: draws initial weights and the order of queries.
        schedule: number of networks, and how they learn.

    Returns:
        a ranker of all features, with the hidden units of all networks side by side. Features that
        are the same everywhere have weight 0.
    """
    members, size, _, rate, _ = schedule
    mean, scale = _moments(examples)
    networks = [_drawn_network(len(mean), generator) for _ in range(members)]
    # The same queries are together in all epochs, so that they are prepared once.
    parts = torch.randperm(len(examples.features), generator=generator).split(size)
    batches = [_prepared(examples, rows, mean, scale) for rows in parts]
    epochs = max(schedule.epochs, math.ceil(schedule.steps / len(batches)))
    optimizer = torch.optim.AdamW(
        [weights for network in networks for weights in network],
        lr=rate,
        weight_decay=WEIGHT_DECAY,
        # One loop over all weights: the networks are small, and many calls would cost more.
        fused=True,
    )
    cycle = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        rate,
        total_steps=epochs * len(batches),
    )
    for _ in range(epochs):
        for place in torch.randperm(len(batches), generator=generator).tolist():
            _set_gradients(networks, *batches[place])
            optimizer.step()
            cycle.step()
    # Standardise the weights instead of the features: far fewer numbers when the ranker is used.
    standardised = torch.cat([network.first for network in networks], dim=1)
    first = standardised / scale[:, None]
    first_bias = torch.cat([network.first_bias for network in networks])
    second = torch.cat([network.second for network in networks])
    return Ranker(
        first=first,
        first_bias=first_bias - mean @ first,
        second=second / members,
        bias=torch.zeros(()),
    )


def _drawn_network(features: int, generator: torch.Generator) -> Ranker:
    """Draw the weights of a network for F features; its bias stays 0, which changes no loss."""
    return Ranker(
        first=_drawn(features, HIDDEN, fan=features, generator=generator),
        first_bias=_drawn(HIDDEN, fan=features, generator=generator),
        second=_drawn(HIDDEN, fan=HIDDEN, generator=generator),
        bias=torch.zeros(()),
    )


def _prepared(
    examples: Examples, rows: Tensor, mean: Tensor, scale: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the queries of a step. Most tables have fewer pairs than the widest.

    Args:
        examples: all queries.
        rows: numbers of the step's queries, shape (n,).
        mean: means of the features, shape (F,).
        scale: their deviations, shape (F,).

    Returns:
        standardised features of the competing candidates, shape (c, F); where they are among all
        candidates, query by query, shape (c,); and which are right, shape (n, P).
    """
    width = examples.competes.shape[1]
    # (n, P) to (n · P,).
    places = examples.competes[rows].view(-1).nonzero()[:, 0]
    # The candidates' numbers among those of all queries, (N · P,): one copy takes a third of the
    # time of two, by query and by candidate.
    numbers = (rows[:, None] * width + torch.arange(width)).view(-1)[places]
    features = examples.features.flatten(0, 1).index_select(0, numbers)
    return features.sub_(mean).div_(scale), places, examples.is_right[rows]


def _set_gradients(
    networks: Sequence[Ranker], features: Tensor, places: Tensor, is_right: Tensor
) -> None:
    """Set the gradients of the mean loss of a batch, network by network.

    With a query's softmax p over its candidates and q over the right ones alone, the loss
    ``-log Σ_right p`` has the derivative ``p - q`` by the scores. The rest is the chain rule of a
    network with one hidden layer, written out: it takes three quarters of the time of automatic
    differentiation, which keeps more numbers than it needs.

    Args:
        networks: the ``grad`` of all weights but the bias is overwritten.
        features: of the competing candidates, see :func:`_prepared`.
        places: where they are among all candidates.
        is_right: which candidates are right.
    """
    units = []
    shape = is_right.shape
    num_queries, _ = shape
    # A candidate that does not compete keeps the score -inf, and so the probability 0.
    scores = torch.full((len(networks), shape.numel()), -torch.inf)
    # A product for each network takes half the time of one for all: its units fit into the
    # processor's cache.
    for row, network in zip(scores, networks, strict=True):
        # (n, H)
        hidden = torch.addmm(network.first_bias, features, network.first).relu_()
        row[places] = hidden @ network.second
        units.append(hidden)
    scores = scores.view(-1, *shape)
    right_scores = scores.masked_fill(~is_right, -torch.inf)
    among_all = scores.softmax(-1)
    among_right = right_scores.softmax(-1)
    by_score = (among_all - among_right) / num_queries
    # Candidates that do not compete have no row among the features: (networks, queries, P) to
    # (networks, n).
    errors = by_score.flatten(1)[:, places]
    for network, hidden, error in zip(networks, units, errors, strict=True):
        network.second.grad = hidden.T @ error
        # The derivative of relu is 1 for positive units and 0 for the others: their sign.
        by_unit = hidden.sign_().mul_(error[:, None])
        by_input = features.T @ by_unit
        network.first.grad = by_input * network.second
        network.first_bias.grad = by_unit.sum(0) * network.second


def _moments(examples: Examples) -> tuple[Tensor, Tensor]:
    """Return means and deviations of features, (F,) each; a constant has an infinite deviation."""
    # A row for each feature: along its numbers, sums and extremes take half of the time.
    competing = examples.competes.view(-1).nonzero()[:, 0]
    by_feature = examples.features.flatten(0, 1).index_select(0, competing).T.contiguous()
    # One after the other takes a sixth of the time of all together.
    deviation = torch.stack([numbers.std() for numbers in by_feature])
    span = by_feature.amax(1) - by_feature.amin(1)
    # A rare feature may differ in so few pairs that its deviation is rounding: its span serves.
    scale = torch.where(deviation > _SMALL, deviation, span)
    is_constant = span <= _SMALL
    return by_feature.mean(1), scale.masked_fill(is_constant, torch.inf)


def _drawn(*shape: int, fan: int, generator: torch.Generator) -> Tensor:
    """Draw initial weights, uniform up to ``1 / √fan``."""
    weights = torch.rand(*shape, generator=generator) * 2 - 1
    return weights / math.sqrt(fan)
