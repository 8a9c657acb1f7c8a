"""Some features of tables by vectorised torch beside the compiled loops: which of both to keep?

    python benchmarks/features_in_torch.py models/la2 --tables 128

Computes the evidence of the goal's supporting recipes (``pair_evidence``, ``pair_best_evidence``) and of known pairs of
neighbours (``makes_anything``): 3 of 16 features of a pair, the most expensive ones. The loops compute all features.
Lists end at different places, which torch pads, and its searches do not stop early. Prints the largest difference, and
the time of a table of ten, best of several batches, one thread.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.neighbours import feature_loops
from wordcraft_kg.models.scorers.neighbours.feature_loops import FLOOR, LEAST
from wordcraft_kg.models.scorers.neighbours.lists import Lists
from wordcraft_kg.models.scorers.neighbours.similar import WORDS_WEIGHT
from wordcraft_kg.models.scorers.recipes import RecipeScorer

SLOTS = 10
BATCHES = 20


class InTorch:
    """Three features of all pairs of slots, from the same lists."""

    def __init__(self, lists: Lists, device: str):
        self.size = len(lists.norms)
        rows = np.repeat(np.arange(self.size), np.diff(lists.near_starts))
        # Ascending keys, so that a look-up is a binary search.
        keys = rows * self.size + lists.near
        # The hash table without its empty places, ascending.
        order = np.argsort(lists.pair_keys)
        order = order[lists.pair_keys[order] >= 0]
        known = lists.pair_keys[order]
        counts = lists.pair_counts[order]
        names = (
            "norms",
            "vectors",
            "near_cosines",
            "first",
            "second",
            "support",
            "support_alike",
            "used",
            "used_alike",
        )
        for name in names:
            setattr(self, name, torch.from_numpy(getattr(lists, name).copy()).to(device))
        self.keys, self.known, self.counts = (
            torch.from_numpy(each).to(device) for each in (keys, known, counts)
        )

    def squares(self, one: Tensor, other: Tensor) -> Tensor:
        """Return k² of entities one (B, A) and other (B, R), shape (B, A, R)."""
        words = self.vectors[one] @ self.vectors[other].transpose(1, 2)
        codes = one[:, :, None] * self.size + other[:, None]
        place = torch.searchsorted(self.keys, codes).clamp(max=len(self.keys) - 1)
        structure = torch.where(self.keys[place] == codes, self.near_cosines[place], 0)
        norms = (self.norms[one][:, :, None] * self.norms[other][:, None]).sqrt()
        alike = ((structure + float(WORDS_WEIGHT) * words.clamp(min=0) ** 2) / norms).clamp(max=1)
        return torch.where(one[:, :, None] == other[:, None], 1, alike) ** 2

    def __call__(self, goals: Tensor, tables: Tensor) -> Tensor:
        """Return the features of goals (B,) and tables (B, A), shape (B, A, A, 3)."""
        recipes = self.support[goals].long()
        weights = torch.where(recipes >= 0, self.support_alike[goals], 0)
        first, second = (
            self.squares(tables, part[recipes.clamp(min=0)].long())
            for part in (self.first, self.second)
        )
        straight = (first * weights[:, None]) @ second.transpose(1, 2)
        evidence = straight + straight.transpose(1, 2)
        crossed = first[:, :, None] * second[:, None]
        best = (torch.maximum(crossed, crossed.transpose(1, 2)) * weights[:, None, None]).amax(-1)
        used = self.used[tables].long()
        alike = torch.where(used >= 0, self.used_alike[tables], 0)
        products = alike[:, :, None, :, None] * alike[:, None, :, None]
        one, other = torch.broadcast_tensors(used[:, :, None, :, None], used[:, None, :, None])
        codes = torch.minimum(one, other) * self.size + torch.maximum(one, other)
        place = torch.searchsorted(self.known, codes).clamp(max=len(self.known) - 1)
        is_known = (self.known[place] == codes) & (products >= float(LEAST))
        results = self.counts[place].clamp(max=feature_loops.MOST_RESULTS)
        anything = torch.where(is_known, products * results, 0).sum((-1, -2))
        return torch.log(float(FLOOR) + torch.stack([evidence, best, anything], dim=-1))


def seconds(call: Callable[[], object]) -> float:
    call()
    best = float("inf")
    for _ in range(BATCHES):
        begun = time.perf_counter()
        call()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        best = min(best, time.perf_counter() - begun)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path, help="folder of a recipe scorer")
    parser.add_argument("--tables", type=int, default=128)
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    torch.set_num_threads(1)
    scorer = whole_of(load_scorer(options.model))
    assert isinstance(scorer, RecipeScorer)
    lists = scorer.knowledge.lists()
    rng = np.random.default_rng(0)
    size = len(scorer.entities)
    shares = (1.0 + lists.num_uses[:size]) / (1.0 + lists.num_uses[:size]).sum()
    goals = rng.integers(0, size, options.tables)
    tables = np.stack(
        [rng.choice(size, SLOTS, replace=False, p=shares) for _ in range(options.tables)]
    )
    one, other = np.triu_indices(SLOTS)
    of_pairs = np.zeros((options.tables, len(one), feature_loops.OF_PAIRS), dtype=np.float32)

    def by_loops() -> None:
        of_slots = np.zeros((options.tables, SLOTS, feature_loops.OF_SLOTS), dtype=np.float32)
        of_pairs[:] = 0
        feature_loops.table_features(lists, goals, tables, one, other, of_slots, of_pairs)

    in_torch = InTorch(lists, options.device)
    on_device = [torch.from_numpy(each).to(options.device) for each in (goals, tables)]
    loops = seconds(by_loops) / options.tables
    vectorised = seconds(lambda: in_torch(*on_device)) / options.tables
    found = in_torch(*on_device)[:, one, other].cpu().numpy()
    row = {
        "model": str(options.model),
        "device": options.device,
        "loops, all features, us": round(1e6 * loops, 1),
        "torch, 3 features, us": round(1e6 * vectorised, 1),
        "times": round(vectorised / loops, 1),
        "largest difference": float(np.abs(found - of_pairs[..., [0, 2, 3]]).max()),
    }
    print(json.dumps(row))


if __name__ == "__main__":
    main()
