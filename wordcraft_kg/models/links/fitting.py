"""Train a PyKEEN model, in a run folder or without, and choose its regularisation.

PyKEEN draws from global generators. They are seeded for each epoch by (seed, epoch), so a resumed
training draws the same numbers as an uninterrupted one, and a checkpoint needs no state of a
generator.

:func:`choose` finds the regularisation for ComplEx on small and large recipe books by train recipes
alone: no single weight suits hundreds and thousands of recipes, and on tens of thousands of
entities a few epochs learn less than the frequency rule. So short trainings hold out and rank train
recipes, as the split holds out test recipes. Each training covers all popularity weights, which
change scores only. Validation and test recipes are not read.

The page docs/link-prediction.md describes trainings under *Train*, and
docs/evidence/links.md#complex measures the choice.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import count, product
from typing import Any

import numpy as np
import torch
from pykeen.models import Model
from pykeen.training import NonFiniteLossError, TrainingLoop
from pykeen.training.callbacks import TrainingCallback
from pykeen.triples import TriplesFactory
from torch import Tensor

from wordcraft_kg.base.errors import SplitError, TrainingError
from wordcraft_kg.base.tensors import copied, with_prefix
from wordcraft_kg.graphs import Ids, OpenedGraph, RecipeGraph, Split, SplitConfig, make_split
from wordcraft_kg.models.links.builders import make_training_loop, scorer_tensors
from wordcraft_kg.models.links.link_config import N3_PARTIAL, ComplExConfig, LinkSettings
from wordcraft_kg.models.links.link_records import Candidate, Choice, LinkProgress
from wordcraft_kg.models.links.pykeen_bridge import (
    OutsideTriples,
    pykeen_guard,
    seed_everything,
    triples_factory,
)
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, rank_triples, sampled
from wordcraft_kg.models.scorers.scorer_folder import make_scorer
from wordcraft_kg.runs.checkpoints import Checkpoint


def train_epochs(
    loop: TrainingLoop,
    factory: TriplesFactory,
    settings: LinkSettings,
    after_epoch: Callable[[int, float], None],
) -> None:
    """Train from the loop's epoch to the last one, or until the loop is told to stop.

    Args:
        loop: PyKEEN's loop with the model and, in a resumed run, its optimiser.
        factory: training triples.
        settings: model and training settings.
        after_epoch: called with the number and the loss of each epoch; may raise to end the
            training.

    Raises:
        TrainingError: if the loss is not finite.
    """
    # Building a model may draw any number of values; each epoch begins by its number.
    seed_everything(settings.seed, loop._epoch + 1)
    try:
        loop.train(
            factory,
            num_epochs=settings.epochs,
            batch_size=settings.batch_size,
            continue_training=loop._epoch > 0,
            use_tqdm=False,
            use_tqdm_batch=False,
            pin_memory=torch.device(settings.device).type == "cuda",
            callbacks=_Epochs(settings.seed, after_epoch),
        )
    except NonFiniteLossError:
        raise TrainingError(
            "the loss became infinite or not a number. Train with a lower `learning_rate`."
        ) from None


class _Epochs(TrainingCallback):
    """PyKEEN callback that seeds the next epoch."""

    def __init__(self, seed: int, after_epoch: Callable[[int, float], None]):
        super().__init__()
        self.seed = seed
        self.after_epoch = after_epoch

    def post_epoch(self, epoch: int, epoch_loss: float, **kwargs: Any) -> None:
        self.after_epoch(epoch, epoch_loss)
        seed_everything(self.seed, epoch + 1)


def fit(
    settings: LinkSettings,
    factory: TriplesFactory,
    after_epoch: Callable[[int], None],
    num_entities: int | None = None,
) -> Model:
    """Train a model without a run folder; equal settings and triples give the model of a run.

    Args:
        settings: model and training settings.
        factory: training triples.
        after_epoch: called with the number of each epoch; may raise to end the training.
        num_entities: number of the graph's entities, for joint training with outside triples.

    Raises:
        ConfigError: if PyKEEN cannot build the model.
        TrainingError: if the loss is not finite.
    """
    with pykeen_guard(settings.seed, settings.threads):
        loop = make_training_loop(settings, factory, num_entities)
        train_epochs(loop, factory, settings, lambda epoch, loss: after_epoch(epoch))
    loop.model.eval()
    return loop.model


# --- checkpoints ----------------------------------------------------------------------------------


def checkpoint_tensors(loop: TrainingLoop) -> dict[str, Tensor]:
    """Return a checkpoint's tensors: the model's and the optimiser's."""
    tensors = {f"model.{name}": value for name, value in loop.model.state_dict().items()}
    for index, values in loop.optimizer.state_dict()["state"].items():
        for key, value in values.items():
            tensors[f"optimizer.{index}.{key}"] = torch.as_tensor(value)
    return copied(tensors)


def restore(loop: TrainingLoop, checkpoint: Checkpoint[LinkProgress]) -> None:
    """Load a checkpoint into a new loop.

    Raises:
        ValueError, KeyError, RuntimeError: if tensors do not fit the model.
    """
    loop.model.load_state_dict(with_prefix(checkpoint.tensors, "model."))
    state = defaultdict[int, dict[str, Tensor]](dict)
    for name, value in with_prefix(checkpoint.tensors, "optimizer.").items():
        index, _, key = name.partition(".")
        state[int(index)][key] = value
    # Checked here: the optimiser would notice a missing or misshapen tensor only in the next epoch.
    for number, parameter in enumerate(loop.optimizer.param_groups[0]["params"]):
        shapes = {value.shape for value in state[number].values()}
        if state[number].keys() != state[0].keys() or not shapes <= {(), parameter.shape}:
            raise ValueError("a part of the optimiser's state is missing, or has another shape")
    # The new optimiser keeps its settings; the checkpoint holds only its tensors.
    loop.optimizer.load_state_dict({**loop.optimizer.state_dict(), "state": state})
    loop._epoch = checkpoint.number


# --- choice of the regularisation -----------------------------------------------------------------

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
    recipes: Ids,
    outside: OutsideTriples | None = None,
) -> Choice | None:
    """Choose the N3 weight and the weight of training counts in the scores (popularity), if open.

    On a large book, N3 is fixed, and only popularity is chosen, if the settings use a sampled
    softmax.

    Args:
        opened: graph and split; only the train recipes are read.
        settings: settings of the training.
        after_epoch: called with the finished and the total epochs; may raise to end the choice.
        recipes: training recipes, rows of ``graph.sets``.
        outside: triples from outside the book, in every training; None without.

    Returns:
        the candidate with most popularity among all candidates with nearly the best MRR on held-out
        recipes, and all candidates; None without open weights, or with too few held-out triples.

    Raises:
        TrainingError: if a loss is not finite.
    """
    split = opened.split
    # Other models have neither weight, and given weights, both or neither, are kept.
    if not isinstance(settings, ComplExConfig) or settings.n3 is not None:
        return None
    is_small = len(recipes) <= SMALL
    if not is_small and not settings.negatives:
        return None
    weights = N3 if is_small else (N3_PARTIAL,)
    num_folds = FOLDS if is_small else 1
    folds = list(folds_of_train(split, recipes, settings.seed, num_folds))
    queries = 2 * sum(len(_queries(fold)) for fold in folds)
    if queries < 2 * MIN_TRIPLES:
        return None
    epochs = max(round(SHARE_OF_EPOCHS * settings.epochs), 1)
    total = len(weights) * len(folds) * epochs
    epoch_number = count(1)
    # By N3 weight and popularity.
    sums = np.zeros((len(weights), len(POPULARITY)))
    for row, n3 in zip(sums, weights, strict=True):
        # Without popularity: it changes scores only, so one training serves all weights.
        short = replace(settings, n3=n3, popularity=0.0, epochs=epochs)
        for fold in folds:
            row += _reciprocal_ranks(
                fold, short, outside, lambda _: after_epoch(next(epoch_number), total)
            )
    mrrs = (sums / queries).ravel().tolist()
    candidates = [
        Candidate(n3=n3, popularity=popularity, mrr=mrr)
        for (n3, popularity), mrr in zip(product(weights, POPULARITY), mrrs, strict=True)
    ]
    # Most popularity first; the MRR decides between N3 weights.
    threshold = (1 - CAUTION) * max(mrrs)
    good = [candidate for candidate in candidates if candidate.mrr >= threshold]
    best = max(good, key=lambda candidate: (candidate.popularity, candidate.mrr))
    return Choice(
        n3=best.n3,
        popularity=best.popularity,
        mrr=best.mrr,
        candidates=tuple(candidates),
        queries=queries,
    )


def folds_of_train(split: Split, recipes: Ids, seed: int, number: int) -> Iterator[Split]:
    """Yield splits of train recipes into a train and a test part, with the same kind of split.

    Settings chosen on these test parts have seen neither the validation nor the test recipes. With
    the same kind of split, the choice meets the same difficulty as the test: whole goals are held
    out for by-goal, single pairs for by-recipe. There is no validation part.

    Args:
        split: split whose train recipes are split again.
        recipes: train recipes to split, rows of ``graph.sets``.
        seed: seed of the first draw.
        number: most splits; those that leave nothing to rank are left out.

    Yields:
        a split of a graph with these recipes and all entities, with the same entity ids.
    """
    graph = RecipeGraph(split.graph.entities, recipes, split.graph.base_ids, split.graph.name)
    for fold_seed in range(seed, seed + number):
        config = SplitConfig(split.config.kind, train_ratio=1 - HELD_OUT, seed=fold_seed)
        # A part may be empty in small books if most entities occur only once.
        with suppress(SplitError):
            fold = make_split(graph, config)
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
        shape (P,): sums of reciprocal ranks for the P weights in :data:`POPULARITY`.
    """
    graph = fold.graph
    trained_on = fold.partial
    queries = _queries(fold)
    model = fit(
        settings, triples_factory(graph, trained_on, outside), after_epoch, graph.num_entities
    )

    sums = []
    # One scorer after the other: each has a copy of all embeddings.
    for weight in POPULARITY:
        popular = replace(settings, popularity=weight)
        tensors = scorer_tensors(popular, model, trained_on, graph.num_entities)
        scorer = make_scorer(*tensors, graph.entities, graph.hash)
        ranks = rank_triples(scorer, queries, graph.triples)
        sums.append(float((1 / ranks["rank"]).sum()))
    return np.array(sums)
