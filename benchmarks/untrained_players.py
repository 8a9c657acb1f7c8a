"""How far do players get that learn nothing from play? Scorers alone, words alone, graph alone, on
several splits.

    python benchmarks/untrained_players.py little-alchemy-2 --json untrained-players.json
    python benchmarks/untrained_players.py everyday --splits by-goal --split-seeds 1

For each split kind and split seed: *nearest words* (the two entities nearest to the goal by GloVe),
and the recipe scorer alone by u + v, by w, by w without words (``--features one-hot``), and by w
without the graph (a ranker of word features only). *Random* is exact: two random slots on these
tables. Success on all depth-1 test tasks, five distractor seeds: by any recipe, and by the task's
own recipe. Scorers are trained where missing; existing models and figures in --out are kept.
"""

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from wordcraft_kg.agents.evaluation import play_all
from wordcraft_kg.agents.players import (
    FEWEST_USES,
    NEAREST_WORDS,
    Player,
    fewest_uses,
    knowledge_player,
    nearest_words,
    scorer_players,
)
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, open_graph
from wordcraft_kg.graphs.graph_folder import OpenedGraph, write_graph_folder
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.policies.sources.recipe import BestRecipe
from wordcraft_kg.models.recipes.committee import fit_committee
from wordcraft_kg.models.recipes.fitting import drawn_tables, table_examples
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig
from wordcraft_kg.models.recipes.recipe_training import train_recipes
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.neighbours.pair_features import (
    FEATURES,
)
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.recipes import RecipeScorer

WORDS = ("words_sum", "words_min", "pair_words", "itself")
"""Features that need no recipe."""
SEEDS = 5
"""Distractor seeds."""


def trained(home: Path, features: str, skip: bool) -> Model | None:
    """Return a recipe scorer, trained if missing; None if training is skipped."""
    folder = home / ("recipes" if features == "glove" else f"recipes-{features}")
    if not (folder / "metrics.json").exists():
        if skip:
            return None
        train_recipes(RecipesConfig(str(home / "graph"), features=features), folder, force=True)
    return open_model(folder, str(home / "graph"))


def words_player(model: Model) -> Player:
    """Return the player by w with a ranker that learns from the train recipes, but from word
    features only."""
    scorer, recipes = whole_of(model.scorer), model.opened.split.recipes("train")
    assert isinstance(scorer, RecipeScorer)
    knowledge = scorer.knowledge
    rng = np.random.default_rng(0)
    tables, goals = drawn_tables(recipes, recipes, len(scorer.entities), rng)
    _, queries = table_examples(knowledge.lists(), None, tables, goals, recipes)
    # A constant feature gets the weight 0.
    is_word = torch.tensor([name in WORDS for name in FEATURES])
    examples = queries._replace(features=queries.features * is_word)
    ranker = fit_committee(examples, torch.Generator().manual_seed(0))
    return knowledge_player([BestRecipe(len(scorer.entities), knowledge.with_ranker(ranker))])


def players_of(
    home: Path, opened: OpenedGraph, skip: bool
) -> tuple[dict[str, Player], dict[str, float]]:
    """Return the players, and the leak-free MRR of their scorers."""
    players = {
        FEWEST_USES: fewest_uses(opened.split),
        NEAREST_WORDS: nearest_words(glove_features(opened.graph.entities).unit_vectors),
    }
    mrr: dict[str, float] = {}

    def add(names: Mapping[str, str], model: Model) -> None:
        alone = scorer_players(opened.graph, model.scorer, model.triples)
        queries = opened.split.held_out("test")
        figure = mean_reciprocal_rank(rank_triples(model.scorer, queries, opened.graph.triples))
        for name, player in names.items():
            players[name], mrr[name] = alone[player], figure

    if both := trained(home, "glove", skip):
        by_links, by_recipes = "u+v, self edges dropped", "w, best pair"
        add({"recipe scorer alone, u v": by_links, "recipe scorer alone, w": by_recipes}, both)
        players["words without graph, w"] = words_player(both)
    if graph_only := trained(home, "one-hot", skip):
        add({"graph without words, w": "w, best pair"}, graph_only)
    return players, mrr


def chance(world: World) -> tuple[float, float]:
    """Return the exact success of two random slots on the tables played, by any recipe and by the
    task's own."""
    recipes = world.graph.recipes
    pairs: dict[int, list[tuple[int, int]]] = {}
    for a, b, result in recipes.tolist():
        pairs.setdefault(result, []).append((a, b))
    tasks, engine = np.arange(len(world.tasks)), BatchEngine(world, len(world.tasks))
    shares = []
    for distractor_seed in range(SEEDS):
        state = engine.pose(tasks, distractor_seed, seed=0)
        for task, (goal, table) in enumerate(
            zip(state.goal.tolist(), state.table.tolist(), strict=True)
        ):
            entities = set(table) - {world.graph.num_entities}
            makes = [(a, b) for a, b in pairs[goal] if {a, b} <= entities]
            own = {tuple(recipes[plan[-1], :2].tolist()) for plan in world.tasks.plans[task]}
            # A pair of two entities has two orders.
            shares.append(
                [sum(1 + (a != b) for a, b in ways) / len(entities) ** 2 for ways in (makes, own)]
            )
    any_recipe, own_recipe = np.mean(shares, axis=0).tolist()
    return any_recipe, own_recipe


def play(
    home: Path, book: str, kind: str, seed: int, distractors: list[int], skip: bool
) -> Iterator[dict[str, Any]]:
    """Yield the figures of a split, by player and number of distractors."""
    if not (home / "graph").exists():
        recipes = open_book(book)
        split = make_split(RecipeGraph.from_book(recipes), SplitConfig(kind, seed=seed))
        write_graph_folder(home / "graph", recipes, split)
    opened = open_graph(home / "graph")
    players, mrr = players_of(home, opened, skip)
    world = World(opened, WordCraftConfig(part="test"))
    about = {"book": Path(book).stem, "split": kind, "tasks": len(world.tasks)}
    for amount in distractors:
        success, own = chance(world.variant(num_distractors=amount))
        figures = {"mrr": None, "success": success, "own": own}
        yield {**about, "player": "random", "distractors": amount, **figures}
    for row in play_all(world, players, distractors, distractor_seeds=SEEDS):
        figures = {"mrr": mrr.get(row.player), "success": row.success, "own": row.by_plan}
        yield {**about, "player": row.player, "distractors": row.distractors, **figures}


def played(home: Path, *cell: Any) -> list[dict[str, Any]]:
    """Return the figures of a split, from an earlier call if there was one."""
    figures = home / "untrained.json"
    if not figures.exists():
        write_atomically(figures, json.dumps([*play(home, *cell)]))
    return list(json.loads(figures.read_text()))


def joined(by_split: list[list[dict[str, Any]]]) -> Iterator[dict[str, Any]]:
    """Yield a row for each player and number of distractors, with a list of figures, one for each
    split."""
    of: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for rows in by_split:
        for row in rows:
            of.setdefault((row["player"], row["distractors"]), []).append(row)
    for same in of.values():
        figures = ("mrr", "success", "own")
        yield (
            same[0]
            | {
                name: None if same[0][name] is None else [round(row[name], 4) for row in same]
                for name in figures
            }
            | {"tasks": [row["tasks"] for row in same]}
        )


def lines_of(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a table for a book and a split kind: means over splits."""
    yield f"\n{rows[0]['book']}, {rows[0]['split']}: {len(rows[0]['success'])} splits"
    for row in rows:
        yield f"{row['player']:26}{row['distractors']:>3} " + shown(row)


def shown(row: Mapping[str, Any]) -> str:
    """Return success with the interval over splits, and by the own recipe."""
    mean, own = (float(np.mean(row[name])) for name in ("success", "own"))
    # One split says nothing of others.
    low, high = student_interval(row["success"]) or (0.0, 1.0)
    interval = f"[{low:.3f}, {high:.3f}]"
    return f"{mean:.3f} {interval:16} own {own:.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("book")
    parser.add_argument("--splits", default="by-recipe,by-goal,by-slot")
    parser.add_argument("--split-seeds", type=int, default=3)
    parser.add_argument("--distractors", default="8,1")
    parser.add_argument(
        "--skip-training", action="store_true", help="leave out scorers that are not in --out"
    )
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/runs/partial-graph"))
    options = parser.parse_args()
    distractors = [int(amount) for amount in options.distractors.split(",")]
    found: list[dict[str, Any]] = []
    for kind in options.splits.split(","):
        homes = {
            seed: options.out / f"{Path(options.book).stem}-{kind}-{seed}"
            for seed in range(options.split_seeds)
        }
        cell = (distractors, options.skip_training)
        rows = [
            *joined([played(home, options.book, kind, seed, *cell) for seed, home in homes.items()])
        ]
        print("\n".join(lines_of(rows)), flush=True)
        found += rows
    if options.json:
        keys = ("book", "split", "player", "distractors")
        new = {tuple(row[key] for key in keys): row for row in found}
        # Rows of other players stay, such as those of scorers that this call has not trained.
        old = json.loads(options.json.read_text()) if options.json.exists() else []
        rows = [new.pop(tuple(row[key] for key in keys), row) for row in old]
        write_atomically(options.json, json.dumps([*rows, *new.values()], indent=1) + "\n")


if __name__ == "__main__":
    main()
