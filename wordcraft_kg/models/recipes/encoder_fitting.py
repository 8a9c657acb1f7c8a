"""Fit a pair encoder to recipes: results of pairs, and pairs of results.

A step has B recipes, and the sum of two losses. *Results*: each pair's result should score above
the other results of the batch and N sampled ones; a frequent result is drawn often, so the log of
its expected number of draws is subtracted from its score (Bengio and Senécal 2008). *Pairs*: among
the pairs of the batch and corrupted ones, with one ingredient or both drawn at random, each
result's pair should score highest. The first loss alone would never raise a goal that no known
recipe makes; the second one learns what such goals are made of.

The learnt vectors of single entities begin at 0 and are dropped at random, so that the network must
explain recipes by words, and an entity without recipes is no surprise.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs import Folds, Ids
from wordcraft_kg.graphs.arrays import different_ingredients
from wordcraft_kg.models.recipes.fitting import LeftOut
from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder, pair_inputs


@dataclass(frozen=True)
class EncoderSchedule:
    """Sizes of an encoder, and how it learns.

    Attributes:
        used: length of an ingredient's vector, U.
        hidden: hidden units of a pair, V.
        made: length of a result's vector, Z.
        batch: recipes of a step, B.
        sampled: results sampled for a step, N.
        epochs: passes over the recipes.
        rate: largest step size.
        weight_decay: of all weights but the vectors of single entities.
        drop_used: probability that an ingredient's own vector is dropped in a step.
        drop_made: probability that a result's own vector and bias are dropped in a step.
    """

    used: int = 192
    hidden: int = 256
    made: int = 128
    batch: int = 512
    sampled: int = 1_024
    epochs: int = 7
    rate: float = 4e-3
    weight_decay: float = 1e-4
    drop_used: float = 0.3
    drop_made: float = 0.5


SCHEDULE = EncoderSchedule()
"""Sizes and numbers of steps for books of all sizes, see the package for what else was tried."""
_RISING = 0.1
"""Share of the steps in which the step size rises."""
_SEED = 0xE


def _drawn_encoder(
    size: int, dim: int, plan: EncoderSchedule, generator: torch.Generator, device: str
) -> PairEncoder:
    """Draw the weights from which a fit begins.

    While an encoder is fitted, its ``used``, ``made`` and ``bias``, here (T, 1), are vectors of
    single entities alone, to which the parts by words are added.

    Args:
        size: T.
        dim: D.
        plan: the other sizes.
        generator: draws weights, on the CPU.
        device: where to compute.
    """

    def drawn(rows: int, columns: int) -> Tensor:
        uniform = torch.rand(rows, columns, generator=generator) * 2 - 1
        return uniform / math.sqrt(max(rows, 1))

    encoder = PairEncoder(
        used_words=drawn(dim, plan.used),
        used_bias=torch.zeros(plan.used),
        made_words=drawn(dim, plan.made),
        made_bias=torch.zeros(plan.made),
        bias_words=torch.zeros(dim),
        bias_base=torch.zeros(()),
        first=drawn(3 * plan.used, plan.hidden),
        first_bias=torch.zeros(plan.hidden),
        second=drawn(plan.hidden, plan.made),
        second_bias=torch.zeros(plan.made),
        pair=torch.zeros(plan.hidden),
        pair_bias=torch.zeros(()),
        used=torch.zeros(size, plan.used),
        made=torch.zeros(size, plan.made),
        bias=torch.zeros(size, 1),
    )
    return PairEncoder(*(part.to(device).requires_grad_() for part in encoder))


def _as_used(encoder: PairEncoder, vectors: Tensor, ids: Tensor, keep: Tensor) -> Tensor:
    """Return the vectors h of ingredients.

    Args:
        encoder: is fitted.
        vectors: unit word vectors, shape (T, D).
        ids: entity ids, shape (n,).
        keep: shape (n, 1): 0 where an entity's own vector is dropped, so that words must do.

    Returns:
        shape (n, U).
    """
    id_vectors = nn.functional.embedding(ids, encoder.used, sparse=True) * keep
    word_vectors = vectors[ids] @ encoder.used_words + encoder.used_bias
    return (word_vectors + id_vectors).relu()


def _as_made(
    encoder: PairEncoder, vectors: Tensor, ids: Tensor, keep: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the vectors g of results, and their biases.

    Args:
        encoder: is fitted.
        vectors: unit word vectors, shape (T, D).
        ids: entity ids, shape (n,).
        keep: shape (n, 1): 0 where a result's own vector and bias are dropped.

    Returns:
        shape (n, Z), and shape (n,).
    """
    words = vectors[ids]
    id_vectors = nn.functional.embedding(ids, encoder.made, sparse=True) * keep
    id_bias = nn.functional.embedding(ids, encoder.bias, sparse=True) * keep
    result_vectors = words @ encoder.made_words + encoder.made_bias + id_vectors
    bias = words @ encoder.bias_words + id_bias[:, 0]
    return result_vectors, bias


@torch.no_grad()
def _with_words(encoder: PairEncoder, vectors: Tensor, recipes: Tensor) -> PairEncoder:
    """Return a fitted encoder for inference, on the CPU, see :func:`_centred`.

    Args:
        encoder: has vectors of single entities alone.
        vectors: unit word vectors, shape (T, D).
        recipes: training recipes, ids (n, 3).
    """
    parts = encoder._replace(
        used=(vectors @ encoder.used_words + encoder.used_bias + encoder.used).relu(),
        made=vectors @ encoder.made_words + encoder.made_bias + encoder.made,
        bias=vectors @ encoder.bias_words + encoder.bias[:, 0],
    )
    centred = _centred(PairEncoder(*(part.detach().cpu() for part in parts)), recipes)
    return centred._replace(used=centred.used.half(), made=centred.made.half())


def _centred(encoder: PairEncoder, recipes: Tensor) -> PairEncoder:
    """Return an encoder with the same s, up to a constant, whose parts mean the same in all fits.

    The losses leave open how s is divided: a part that depends on the pair alone may be in u or in
    ``z · g``, one that depends on the result alone in its bias or in ``z · g``. Rankers learn from
    one encoder, and are used with another one. So z and g have a mean of 0 over the recipes, and
    the rest of their product goes to u and to the biases, whose means are 0, too::

        z · g = (z - z̄) · (g - ḡ) + z · ḡ + z̄ · (g - ḡ)

    Args:
        encoder: in single precision.
        recipes: training recipes, ids (n, 3).
    """
    a, b, results = recipes.unbind(1)
    mean_made = encoder.made[results].mean(0)
    result_vectors = encoder.made - mean_made
    made_bias = encoder.made_bias - mean_made
    z, u = encoder.encode(a, b)
    mean_z = z.mean(0)
    pair = encoder.pair + encoder.second @ mean_made
    mean_u = (u + z @ mean_made).mean()
    pair_bias = encoder.second_bias @ mean_made - mean_u
    bias = encoder.bias + result_vectors @ mean_z
    mean_bias = bias[results].mean()
    return encoder._replace(
        made=result_vectors,
        bias=bias - mean_bias,
        second_bias=encoder.second_bias - mean_z,
        pair=pair,
        pair_bias=pair_bias,
        made_bias=made_bias,
        bias_words=encoder.bias_words + encoder.made_words @ mean_z,
        bias_base=encoder.bias_base + made_bias @ mean_z - mean_bias,
    )


class _Draws(NamedTuple):
    """Distributions of random results and ingredients, by how often recipes have them.

    Attributes:
        result_ends: where the interval of each result ends, see :func:`_drawn`, shape (T,).
        use_ends: the same of ingredients.
        log_expected: log of how often a step has each result, shape (T,), at most 0.
    """

    result_ends: Tensor
    use_ends: Tensor
    log_expected: Tensor

    @classmethod
    def of(cls, recipes: Ids, size: int, batch: int, sampled: int, device: str) -> "_Draws":
        """Count recipes.

        Args:
            recipes: training recipes, ids (n, 3).
            size: T.
            batch: recipes of a step.
            sampled: results sampled for a step.
            device: where ``log_expected`` is used.
        """
        make_counts = np.bincount(recipes[:, 2], minlength=size)
        # Half by frequency to the power .75 (Mikolov et al. 2013), half evenly.
        by_count = make_counts**0.75
        of_results = 0.5 * by_count / by_count.sum() + 0.5 / size
        _, users = different_ingredients(recipes, size)
        # As environments draw distractors.
        uses = 1.0 + np.bincount(users, minlength=size)
        expected = batch * (make_counts / len(recipes)) + sampled * of_results
        return cls(
            torch.from_numpy(np.cumsum(of_results)),
            torch.from_numpy(np.cumsum(uses / uses.sum())),
            torch.from_numpy(np.log(np.minimum(expected, 1))).float().to(device),
        )


def _drawn(ends: Tensor, number: int, generator: torch.Generator) -> Tensor:
    """Draw numbers of intervals, which end at ``ends``, by their lengths."""
    shares = torch.rand(number, generator=generator, dtype=torch.float64)
    places = shares * ends[-1]
    numbers = torch.searchsorted(ends, places, right=True)
    # Rounding may put a place at the last end.
    return numbers.clamp(max=len(ends) - 1)


def fit_encoders(
    folds: Folds,
    vectors: Tensor,
    needed: Sequence[LeftOut],
    *,
    seed: int = 0,
    workers: int = 1,
    device: str = "cpu",
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[LeftOut, PairEncoder]]:
    """Fit an encoder for each entry of ``needed``, in this order.

    The result does not depend on the other entries, nor on ``workers``.

    Args:
        folds: folds of the train recipes.
        vectors: unit word vectors, shape (T, D).
        needed: the folds that encoders must not have seen, from
            :func:`~wordcraft_kg.models.recipes.fitting.encoders_of`.
        seed: seed of weights, batches and negatives.
        workers: encoders that are fitted beside each other.
        device: where to compute.
        stop: whether to end the fits.

    Yields:
        an entry of ``needed``, and its encoder.

    Raises:
        KeyboardInterrupt: if ``stop`` has returned True.
    """

    def fitted(left_out: LeftOut) -> PairEncoder:
        # Other numbers than those of the rankers' seeds.
        rng = np.random.default_rng([seed, len(left_out), *left_out, _SEED])
        generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
        recipes = folds.recipes(left_out)
        return fit_encoder(recipes, vectors, generator, device=device, stop=stop)

    pool = ThreadPoolExecutor(workers)
    try:
        yield from zip(needed, pool.map(fitted, needed), strict=True)
    finally:
        # After Ctrl-C, what is not begun is never made.
        pool.shutdown(cancel_futures=True)


def fit_encoder(
    recipes: Ids,
    vectors: Tensor,
    generator: torch.Generator,
    schedule: EncoderSchedule | None = None,
    *,
    device: str = "cpu",
    stop: Callable[[], bool] = lambda: False,
) -> PairEncoder:
    """Fit an encoder to recipes.

    Args:
        recipes: training recipes, ids (n, 3).
        vectors: unit word vectors, shape (T, D).
        generator: draws initial weights, batches, negatives and dropped vectors, on the CPU.
        schedule: sizes, and how it learns; None for :data:`SCHEDULE`.
        device: where to compute.
        stop: called before each step; True ends the fit.

    Raises:
        KeyboardInterrupt: if ``stop`` has returned True.
    """
    plan = schedule or SCHEDULE
    size, dim = vectors.shape
    encoder = _drawn_encoder(size, dim, plan, generator, device)
    words = vectors.to(device)
    batch = min(plan.batch, len(recipes))
    draws = _Draws.of(recipes, size, batch, plan.sampled, device)
    rows = torch.from_numpy(recipes)
    steps = len(recipes) // batch
    # Vectors of single entities have sparse gradients.
    single = [encoder.used, encoder.made, encoder.bias]
    of_entities = ("used", "made", "bias")
    shared = [part for name, part in encoder._asdict().items() if name not in of_entities]
    optimizers: list[torch.optim.Optimizer] = [
        torch.optim.AdamW(shared, lr=plan.rate, weight_decay=plan.weight_decay, fused=True),
        # Most entities are in no batch: their vectors rest.
        torch.optim.SparseAdam(single, lr=plan.rate),
    ]
    total = steps * plan.epochs
    num_steps = 0
    with torch_threads(1):
        for _ in range(plan.epochs):
            order = torch.randperm(len(rows), generator=generator)
            # The last recipes of an order are too few for a step; another order has others last.
            for batch_rows in order.split(batch)[:steps]:
                if stop():
                    raise KeyboardInterrupt
                rate = plan.rate * _share_of_rate(num_steps, total)
                num_steps += 1
                loss = _loss(encoder, words, rows[batch_rows], draws, plan, generator)
                for optimizer in optimizers:
                    optimizer.zero_grad()
                loss.backward()
                for optimizer in optimizers:
                    optimizer.param_groups[0]["lr"] = rate
                    optimizer.step()
        return _with_words(encoder, words, rows)


def _share_of_rate(num_steps: int, total: int) -> float:
    """Return the share of the largest step size for the step after ``num_steps`` ones of ``total``.

    It rises in a line over the first tenth, and falls as half a cosine to nearly 0 (one cycle, as
    the rankers have).
    """
    rising = max(1, round(total * _RISING))
    if num_steps < rising:
        return (num_steps + 1) / rising
    falling = total - rising
    share = (num_steps - rising + 1) / (falling + 1)
    return (1 + math.cos(math.pi * share)) / 2


def _loss(
    encoder: PairEncoder,
    words: Tensor,
    recipes: Tensor,
    draws: _Draws,
    plan: EncoderSchedule,
    generator: torch.Generator,
) -> Tensor:
    """Return the loss of a step.

    Args:
        encoder: is fitted.
        words: unit word vectors, shape (T, D).
        recipes: the step's recipes, ids (B, 3), on the CPU.
        draws: distributions of negatives.
        plan: sizes.
        generator: draws negatives and dropped vectors.
    """
    device = words.device
    batch = len(recipes)
    first, second, results = recipes.unbind(1)
    # Corrupted pairs: one ingredient stays in half of them, none in the others.
    corrupting_ids = _drawn(draws.use_ends, 2 * batch, generator)
    first_corrupted, second_corrupted = corrupting_ids.view(2, batch)
    stays = torch.arange(batch // 2)
    first_corrupted[stays] = torch.where(stays % 4 < 2, first[stays], second[stays])
    pairs = torch.cat([first, first_corrupted, second, second_corrupted])
    used_ids, pair_places = pairs.unique(return_inverse=True)
    sampled = _drawn(draws.result_ends, plan.sampled, generator)
    made_ids, result_places = torch.cat([results, sampled]).unique(return_inverse=True)
    right = result_places[:batch].to(device)
    keep_used = torch.rand(len(used_ids), 1, generator=generator) >= plan.drop_used
    keep_made = torch.rand(len(made_ids), 1, generator=generator) >= plan.drop_made
    used_ids = used_ids.to(device)
    made_ids = made_ids.to(device)

    ingredient_vectors = _as_used(encoder, words, used_ids, keep_used.to(device))
    first_vectors, second_vectors = ingredient_vectors[pair_places.to(device)].chunk(2)
    inputs = pair_inputs(first_vectors, second_vectors)
    units = (inputs @ encoder.first + encoder.first_bias).relu()
    z = units @ encoder.second + encoder.second_bias
    u = units @ encoder.pair
    result_vectors, bias = _as_made(encoder, words, made_ids, keep_made.to(device))
    # A result that steps have often is no better an answer: its frequency is taken off.
    corrected = bias - draws.log_expected[made_ids]
    # (B, results of the batch and sampled ones, each once)
    result_logits = z[:batch] @ result_vectors.T + corrected
    result_loss = nn.functional.cross_entropy(result_logits, right)
    # (B, pairs of the batch and corrupted ones)
    pair_logits = result_vectors[right] @ z.T + u
    goals = results.to(device)
    is_same = goals[:, None] == goals
    is_same.fill_diagonal_(False)
    # Another recipe's pair that makes the same result is no wrong answer.
    competing = nn.functional.pad(is_same, (0, batch), value=False)
    pair_logits = pair_logits.masked_fill(competing, -1e4)
    # The right pair of each recipe is its own: the first columns are the batch's pairs.
    right_pairs = torch.arange(batch, device=device)
    pair_loss = nn.functional.cross_entropy(pair_logits, right_pairs)
    return result_loss + pair_loss
