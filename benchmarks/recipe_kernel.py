"""What the recipe kernel and the recipe-to-recipe kernel predict, how long they take and how much memory.

    python benchmarks/recipe_kernel.py little-alchemy-2 everyday                # validation parts of splits 10 and 11
    python benchmarks/recipe_kernel.py little-alchemy-2 everyday --part test    # test parts of splits 0, 1, 2
    python benchmarks/recipe_kernel.py --entities 20000 --recipes 250000        # a synthetic book, low rank

Links: filtered MRR on unseen triples. Pairs: of each held-out recipe the result is ranked among all entities, without
the pair's other results. Play: of all held-out tasks of depth 1 with one attempt, how many are solved by the pair of
different entities on the table that scores highest for the goal. Nothing is trained. Seconds are of the CPU.
"""

import argparse
import resource
import time
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from synthetic_book import synthetic_rows
from torch import Tensor

from wordcraft_kg.agents.players import RecipeScores, pair_player, play_all
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import RecipeGraph, Split, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.scorers.facts import FrequencyScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.kernel_scorer import RANK, KernelScorer, LowRankKernelScorer
from wordcraft_kg.models.scorers.neighbours import NeighbourScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import rank_triples, ranking_metrics, sampled
from wordcraft_kg.models.scorers.recipe_kernel import RecipeKernel
from wordcraft_kg.models.scorers.votes import VoteScorer

ScoreResults = Callable[[int, int], Tensor]
"""Scores of all entities as the result of a pair, shape (E,)."""


class Clock:
    """CPU seconds since it was last asked, which other programs hardly change."""

    def __init__(self) -> None:
        self.last = time.process_time()

    def lap(self) -> float:
        before, self.last = self.last, time.process_time()
        return self.last - before


def peak() -> str:
    return f"peak memory of this program so far {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB"


def link_mrr(scorer: TripleScorer, graph: RecipeGraph, queries: Ids) -> float:
    return ranking_metrics(rank_triples(scorer, queries, graph.triples)).mrr or 0.0


def pair_ranks(score: ScoreResults, graph: RecipeGraph, recipes: Ids) -> NDArray[np.float64]:
    ranks = []
    for a, b, result in recipes.tolist():
        scores = score(a, b).double()
        true = scores[result].item()
        scores[graph.results(a, b).tolist()] = -torch.inf
        ranks.append(1 + int((scores > true).sum()) + int((scores == true).sum()) / 2)
    return np.array(ranks)


def of_different(kernel: RecipeKernel) -> RecipeScores:
    """Return the scores of recipes, in which pairs of one entity with itself come last."""
    return lambda a, b, c: kernel.score_recipes(a, b, c).masked_fill(a == b, -1)


def judge(split: Split, part: str) -> dict[str, float]:
    graph, train = split.graph, split.recipes("train")
    vectors = glove_features(graph.entities).vectors
    queries = split.held_out(part)
    clock, seconds = Clock(), {}
    kernel = KernelScorer(graph, train, vectors)
    seconds["seconds: recipe kernel"] = clock.lap()
    low_rank = LowRankKernelScorer(graph, train, vectors)
    seconds[f"seconds: of rank {RANK}"] = clock.lap()
    of_recipes = RecipeKernel(graph, train, vectors)
    seconds["seconds: recipe-to-recipe kernel"] = clock.lap()
    scorers = {
        "recipe kernel": kernel,
        "without word vectors": KernelScorer(graph, train),
        f"of rank {RANK}": low_rank,
        "neighbours": NeighbourScorer(graph, split.partial),
        "frequency": FrequencyScorer(graph, split.partial),
    }
    found = {f"links: {name}": link_mrr(scorer, graph, queries) for name, scorer in scorers.items()}
    everything, counts = torch.arange(graph.num_entities), VoteScorer(graph, train)
    of_pairs: dict[str, ScoreResults] = {
        "recipe-to-recipe kernel": lambda a, b: of_recipes.score_recipes(a, b, everything),
        "votes": lambda a, b: counts.score_recipes(a, b, everything),
    }
    for name, score in of_pairs.items():
        ranks = pair_ranks(score, graph, split.recipes(part))
        found |= {f"pairs: {name}": float(np.mean(1 / ranks)), f"pairs: {name}, hits@1": float(np.mean(ranks <= 1))}
    world = World(OpenedGraph(graph, split, graph.name), WordCraftConfig(part=part))
    for row in play_all(world, {"best pair": pair_player(of_different(of_recipes))}, (1, 8)):
        found[f"play: {row.distractors} distractor{'s' * (row.distractors != 1)}"] = row.success
    return found | seconds


def judge_large(entities: int, recipes: int, dimensions: int, rank: int, queries: int) -> None:
    clock = Clock()
    rows = synthetic_rows(entities, recipes, base=10, seed=0, kinds=50)
    graph = RecipeGraph.from_recipes([tuple(f"entity {i}" for i in row) for row in rows.tolist()], name="synthetic")
    split = make_split(graph, SplitConfig())
    train = split.recipes("train")
    print(f"{graph.num_entities:,} entities, {len(train):,} train recipes: {clock.lap():.1f} s; {peak()}", flush=True)
    vectors = np.random.default_rng(0).standard_normal((graph.num_entities, dimensions)) if dimensions else None
    scorer = LowRankKernelScorer(graph, train, vectors, rank=rank)
    print(f"recipe kernel of rank {rank}: {clock.lap():.1f} s; {peak()}", flush=True)
    of_recipes = RecipeKernel(graph, train, vectors)
    print(f"recipe-to-recipe kernel: {clock.lap():.1f} s; {peak()}", flush=True)
    some = sampled(split.held_out("test"), queries)
    for name, judged in (("recipe kernel", scorer), ("frequency", FrequencyScorer(graph, split.partial))):
        print(
            f"links, {len(some):,} triples: {name} {link_mrr(judged, graph, some):.4f}; {clock.lap():.1f} s", flush=True
        )
    held_out, everything = split.recipes("test"), torch.arange(graph.num_entities)
    held_out = held_out[np.random.default_rng(0).permutation(len(held_out))[: queries // 20]]
    ranks = pair_ranks(lambda a, b: of_recipes.score_recipes(a, b, everything), graph, held_out)
    print(f"pairs, {len(ranks)} recipes: MRR {np.mean(1 / ranks):.4f}; {clock.lap():.1f} s; {peak()}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("books", nargs="*")
    parser.add_argument("--part", choices=("valid", "test"), default="valid")
    parser.add_argument("--entities", type=int, help="judge a synthetic book instead")
    parser.add_argument("--recipes", type=int, default=250_000, help="of the synthetic book; four fifths are train")
    parser.add_argument("--dimensions", type=int, default=0, help="of random word vectors for it")
    parser.add_argument("--rank", type=int, default=RANK, help="for it")
    parser.add_argument("--queries", type=int, default=2_000, help="unseen triples of it that are ranked")
    options = parser.parse_args()
    if options.entities:
        judge_large(options.entities, options.recipes, options.dimensions, options.rank, options.queries)
    seeds, valid = ((10, 11), 0.1) if options.part == "valid" else ((0, 1, 2), 0.0)
    for name in options.books:
        graph = RecipeGraph.from_book(open_book(name))
        rows = [judge(make_split(graph, SplitConfig(seed=seed, valid_ratio=valid)), options.part) for seed in seeds]
        print(f"{name}, {options.part} parts of splits {', '.join(map(str, seeds))}: mean (each)")
        for what in rows[0]:
            values = [row[what] for row in rows]
            print(f"  {what:40} {np.mean(values):.3f} ({' '.join(f'{value:.3f}' for value in values)})")
        print(f"  {peak()}", flush=True)


if __name__ == "__main__":
    main()
