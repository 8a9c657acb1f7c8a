"""Measure ComplEx on unseen links, and the evidence for the default settings.

    python benchmarks/link_quality.py settings little-alchemy-2     # sweep, on validation parts of separate splits
    python benchmarks/link_quality.py neighbours little-alchemy-2   # the same for the neighbour baseline
    python benchmarks/link_quality.py votes little-alchemy-2        # and for the vote count
    python benchmarks/link_quality.py test little-alchemy-2 --json link-quality.json       # ComplEx
    python benchmarks/link_quality.py untrained little-alchemy-2 --json link-quality.json
    python benchmarks/link_quality.py results little-alchemy-2 --json link-quality.json    # of pairs, by votes
    python benchmarks/link_quality.py recipes everyday --features minilm --seeds 10,11    # the recipe scorer

``test`` trains ComplEx with its defaults and ranks unseen triples of the test parts of splits 0, 1 and 2. ``untrained``
ranks the same queries by the scorers without training, and plays the test tasks by votes, by all
triples as facts, and by the links of a recipe scorer. Each split's figures go to --json; other rows stay there.

``recipes`` fits the recipe scorer on the train part of each split and measures it alone: the best pair on test
tables, and unseen links. Choices are made on seeds 10 and 11.

The sweep never ranks test triples (which are only filtered from the candidates), and uses splits 10, 11 and 12, while
the test uses splits 0, 1 and 2.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from wordcraft_kg.agents.evaluation import play_all
from wordcraft_kg.agents.players import BEST_PAIR, fact_recipes, pair_player, scorer_players
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import RecipeBook, RecipeGraph, Split, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.graph_folder import OpenedGraph, write_graph_folder
from wordcraft_kg.graphs.train_samples import make_folds
from wordcraft_kg.models.knowledge.books import Words
from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.link_training import TrainedLinks, train_links
from wordcraft_kg.models.recipes.fitting import fit_recipe_scorers
from wordcraft_kg.models.scorers.baselines import (
    FrequencyScorer,
    KernelScorer,
    NeighbourScorer,
    SymbolicScorer,
    VoteScorer,
)
from wordcraft_kg.models.scorers.features import glove_features, make_features
from wordcraft_kg.models.scorers.near_synonyms import near_synonym_recipes, near_synonym_triples
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import rank_triples, ranking_metrics
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer_folder import load_scorer

WEIGHTS = (0.05, 0.075, 0.1, 0.125, 0.2)
RATES = (0.1, 0.2)
EVERY = 10
SEEDS = (0, 1, 2)


def sweep(graph: RecipeGraph, folder: Path, epochs: int) -> None:
    print(
        "validation MRR, mean of 3 splits, after "
        + " ".join(f"{n:>5}" for n in range(EVERY, epochs + 1, EVERY))
    )
    for rate in RATES:
        for weight in WEIGHTS:
            curves = []
            for seed in (10, 11, 12):
                split = make_split(graph, SplitConfig(seed=seed, valid_ratio=0.1))
                known = np.concatenate([split.partial, split.triples_of("valid")])
                curve = []
                # Equal seeds: a shorter training is the beginning of a longer one.
                for number in range(EVERY, epochs + 1, EVERY):
                    config = ComplExConfig(epochs=number, n3=weight, learning_rate=rate)
                    scorer = load_scorer(train(split, config, folder).folder)
                    ranks = rank_triples(scorer, split.held_out("valid"), known)
                    curve.append(ranking_metrics(ranks).mrr)
                curves.append(curve)
            means = " ".join(f"{value:.3f}" for value in np.mean(curves, axis=0))
            print(f"rate {rate:<4} N3 weight {weight:<6}                    {means}", flush=True)


def sweep_neighbours(graph: RecipeGraph) -> None:
    for power in (0.0, 0.5, 1.0, 1.5):
        found = []
        for seed in (10, 11, 12):
            split = make_split(graph, SplitConfig(seed=seed, valid_ratio=0.1))
            scorer = NeighbourScorer(graph, split.partial, power=power)
            found.append(
                ranking_metrics(rank_triples(scorer, split.held_out("valid"), graph.triples)).mrr
            )
        print(
            f"a neighbour of n entities weighs n ** -{power}: validation MRR {np.mean(found):.4f}, "
            "mean of 3 splits"
        )


def sweep_votes(graph: RecipeGraph) -> None:
    for unseen in (0.0001, 0.001, 0.01, 0.1, 1.0):
        found = []
        for seed in (10, 11, 12):
            split = make_split(graph, SplitConfig(seed=seed, valid_ratio=0.1))
            scorer = VoteScorer(graph, split.recipes("train"), unseen=unseen)
            links = rank_triples(scorer, split.held_out("valid"), graph.triples)
            recipes = split.recipes("valid")
            results = result_ranks(graph, recipes, count_votes(scorer, recipes))
            found.append([ranking_metrics(links).mrr, np.mean(1 / results)])
        of_links, of_results = np.mean(found, axis=0)
        print(
            f"unseen {unseen}: validation MRR {of_links:.4f}, of the results of pairs "
            f"{of_results:.4f}, 3 splits"
        )


def test(graph: RecipeGraph, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the figures of ComplEx with its defaults on the test parts of splits 0, 1 and 2."""
    features = glove_features(graph.entities)
    for seed in SEEDS:
        split = make_split(graph, SplitConfig(seed=seed))
        trained = train(split, ComplExConfig(), folder)
        queries = split.held_out("test")
        ranks = rank_triples(load_scorer(trained.folder), queries, graph.triples)
        repeated = near_synonym_triples(graph, near_synonym_recipes(split, features), queries)
        found = ranking_metrics(ranks)
        yield about(graph, split) | {
            "row": "ComplEx",
            "mrr": found.mrr,
            "no_near_synonym": ranking_metrics(ranks[np.tile(~repeated, 2)]).mrr,
            "hits_at_1": found.hits_at_1,
            "hits_at_10": found.hits_at_10,
        }


def results(graph: RecipeGraph) -> Iterator[dict[str, Any]]:
    """Yield the MRR of the results of test pairs by votes, for three kinds of splits."""
    for kind in ("by-recipe", "by-slot", "by-goal"):
        for seed in SEEDS:
            split = make_split(graph, SplitConfig(kind, seed=seed))
            recipes = split.recipes("test")
            votes = VoteScorer(graph, split.recipes("train"))
            ranks = result_ranks(graph, recipes, count_votes(votes, recipes))
            yield about(graph, split) | {"row": "votes, results", "mrr": float((1 / ranks).mean())}


def about(graph: RecipeGraph, split: Split) -> dict[str, Any]:
    """Return where a row was measured."""
    return {"book": graph.name, "split": split.config.kind, "seed": split.config.seed}


def untrained(graph: RecipeGraph) -> Iterator[dict[str, Any]]:
    """Yield the figures of scorers without training, and of players by simple rules, on splits 0, 1
    and 2.

    Each row has a name, a split seed, and either the filtered MRR on unseen triples
    (``no_near_synonym``: without triples of recipes that repeat a train recipe with a near-synonym)
    or success with 8 and 1 distractors.
    """
    features = glove_features(graph.entities)
    for seed in SEEDS:
        split = make_split(graph, SplitConfig(seed=seed))
        train_recipes = split.recipes("train")
        queries = split.held_out("test")
        repeated = near_synonym_triples(graph, near_synonym_recipes(split, features), queries)
        votes = VoteScorer(graph, train_recipes)
        scorers: dict[str, TripleScorer] = {
            "recipe kernel": KernelScorer(graph, train_recipes, features.vectors),
            "recipe kernel without words": KernelScorer(graph, train_recipes, None),
            "neighbour rule": NeighbourScorer(graph, split.partial),
            "votes": votes,
            "frequency": FrequencyScorer(graph, split.partial),
            "facts": SymbolicScorer(graph, split.partial),
        }
        for name, scorer in scorers.items():
            ranks = rank_triples(scorer, queries, graph.triples)
            others = ranks[np.tile(~repeated, 2)]
            yield about(graph, split) | {
                "row": name,
                "mrr": ranking_metrics(ranks).mrr,
                "no_near_synonym": ranking_metrics(others).mrr,
                "hits_at_10": ranking_metrics(ranks).hits_at_10,
            }
        links = fitted_links(split)
        of_links = scorer_players(graph, links, split.partial)
        players = {
            "votes, best pair": pair_player(votes.score_recipes),
            "full graph as facts, best pair": pair_player(fact_recipes(graph, graph.triples)),
            "u and v, self edges observed": of_links["u+v, self edges observed"],
            "u and v, self edges dropped": of_links["u+v, self edges dropped"],
        }
        world = World(OpenedGraph(graph, split, graph.name), WordCraftConfig(part="test"))
        played = play_all(world, players, (8, 1), distractor_seeds=5)
        for name in players:
            rates = {str(row.distractors): row.success for row in played if row.player == name}
            yield about(graph, split) | {"row": name} | rates


def recipe_scorers(
    graph: RecipeGraph,
    features: str,
    seeds: list[int],
) -> Iterator[dict[str, Any]]:
    """Yield success by the best pair, the MRR of links, and CPU seconds of the recipe scorer."""
    for kind in ("by-recipe", "by-goal"):
        for seed in seeds:
            split = make_split(graph, SplitConfig(kind, seed=seed))
            begun = time.process_time()
            scorer = fitted_links(split, features)
            seconds = time.process_time() - begun
            links = rank_triples(scorer, split.held_out("test"), graph.triples)
            world = World(OpenedGraph(graph, split, graph.name), WordCraftConfig(part="test"))
            player = {BEST_PAIR: pair_player(scorer.score_recipes)}
            played = play_all(world, player, (8, 1), distractor_seeds=5)
            rates = {str(row.distractors): row.success for row in played}
            figures = {"mrr": ranking_metrics(links).mrr, "cpu_seconds": seconds}
            yield about(graph, split) | {"row": f"recipe scorer, {features}"} | rates | figures


def fitted_links(split: Split, features: str = "glove") -> RecipeScorer:
    """Return a recipe scorer that is fitted on the train recipes of a split."""
    graph = split.graph
    words = Words.of(make_features(features, graph.entities))
    ((_, knowledge),) = fit_recipe_scorers(make_folds(split, 5), words, [()])
    return RecipeScorer(knowledge.constants(), graph.entities, graph.hash)


def train(split: Split, settings: ComplExConfig, folder: Path) -> TrainedLinks:
    graph = split.graph
    write_graph_folder(
        folder / "graph",
        RecipeBook(graph.name, tuple(graph.recipe_labels()), graph.base),
        split,
        force=True,
    )
    settings = replace(settings, folds=0)  # nobody learns from these models
    return train_links(LinksConfig(str(folder / "graph"), settings), folder / "model", force=True)


def count_votes(scorer: VoteScorer, recipes: np.ndarray) -> np.ndarray:
    """Return scores for all entities as result of each recipe, shape (n, E)."""
    a, b, _ = torch.tensor(recipes).T
    everything = torch.arange(len(scorer.entities))
    return scorer.score_recipes(a[:, None], b[:, None], everything).numpy()


def result_ranks(graph: RecipeGraph, recipes: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Return the rank of each recipe's result among the entities, ties counting half."""
    ranks = np.empty(len(recipes))
    for i, (a, b, result) in enumerate(recipes.tolist()):
        true = scores[i, result]
        others = np.setdiff1d(np.arange(graph.num_entities), [a, b, *graph.results(a, b)])
        ranks[i] = 1 + np.sum(scores[i, others] > true) + np.sum(scores[i, others] == true) / 2
    return ranks


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["settings", "neighbours", "votes", "recipes", *MEASURED])
    parser.add_argument("book", nargs="?", default="little-alchemy-2")
    parser.add_argument("--epochs", type=int, default=100, help="of the sweep")
    parser.add_argument("--features", default="minilm", help="word vectors of the recipe scorer")
    parser.add_argument("--seeds", default="10,11", help="split seeds of the recipe scorer")
    parser.add_argument("--json", type=Path, help="file to write the figures of a test to")
    arguments = parser.parse_args()
    graph = RecipeGraph.from_book(open_book(arguments.book))
    with tempfile.TemporaryDirectory() as folder:
        if arguments.what == "settings":
            sweep(graph, Path(folder), arguments.epochs)
        elif arguments.what == "neighbours":
            sweep_neighbours(graph)
        elif arguments.what == "votes":
            sweep_votes(graph)
        else:
            rows = []
            measured = MEASURED.get(arguments.what)
            seeds = [int(seed) for seed in arguments.seeds.split(",")]
            found = (
                measured(graph, Path(folder))
                if measured
                else recipe_scorers(graph, arguments.features, seeds)
            )
            for row in found:
                print(row, flush=True)
                rows.append({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()})
            if arguments.json:
                store(rows, arguments.json)


MEASURED: dict[str, Callable[[RecipeGraph, Path], Iterator[dict[str, Any]]]] = {
    "test": test,
    "untrained": lambda graph, _: untrained(graph),
    "results": lambda graph, _: results(graph),
}
"""What can be stored."""


def store(rows: list[dict[str, Any]], path: Path) -> None:
    """Write rows to a file in place of its rows of the same name and book."""
    old = json.loads(path.read_text()) if path.exists() else []
    new = {(row["book"], row["row"]) for row in rows}
    kept = [row for row in old if (row["book"], row["row"]) not in new]
    lines = ",\n".join(map(json.dumps, kept + rows))
    write_atomically(path, f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
