"""Which knowledge helps? Recipe scorers with sources of outside knowledge, alone at the evaluation's own tables.

    wordcraft-kg encode little-alchemy-2 everyday --encoder ENCODER --out vectors/both
    wordcraft-kg elicit little-alchemy-2 --model MODEL --out knowledge/lm          (and the other folders)
    python benchmarks/outside_knowledge.py little-alchemy-2 --words vectors/both \\
        --source "language model=knowledge/lm" --source WordNet=knowledge/wn --source book=everyday

For each split kind and split seed: recipes alone (``one-hot``), recipes and GloVe, recipes and ``--words``, the latter
with each source, and with all sources (``--only`` chooses rows). A source is NAME=SPEC, or NAME=SPEC,SPEC, with
``{split}`` and ``{seed}`` for folders that belong to one split. Fits on all
train recipes of the split; ``--part valid`` plays validation tasks instead of test tasks. Success on all depth-1 tasks:
the pair with the highest score, five distractor seeds; *few* counts tasks with an ingredient or goal in at most two
train recipes. ``--made-by BOOK`` adds to every row the success on goals that this other book makes (*made*) and on
goals that it does not make (*other*), the share of tasks with the former (*share made*), and the share that it has
with one ingredient replaced by a near-synonym (*share reworded*). Finished cells in --out are kept.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from wordcraft_kg.agents.agent_config import AgentConfig, ImpalaConfig
from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.agent_training import train_agent
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.players import scorer_players
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import paired_difference, student_interval
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import SplitConfig, open_book, open_graph
from wordcraft_kg.graphs.graph_folder import OpenedGraph, write_graph_folder
from wordcraft_kg.graphs.train_samples import make_folds
from wordcraft_kg.models.knowledge.books import (
    OtherBook,
    Words,
    open_other_book,
    word_features,
    words_of_books,
)
from wordcraft_kg.models.knowledge.outside import join_books, open_outside
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.recipes.fitting import fit_recipe_scorers
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_training import encoder_of_books, train_recipes
from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.recipes import RecipeScorer

SEEDS = 5
"""Distractor seeds."""
FEW = 2
"""Most train recipes of an entity that counts as rare."""
ZERO_SHOT = "zero-shot"
ENCODERS: dict[tuple[str, ...], PairEncoder] = {}
"""Pair encoders of other books, by graph, words and books."""


def fitted(opened: OpenedGraph, name: str, words: str, specs: Sequence[str]) -> RecipeKnowledge:
    """Fit a scorer on the train recipes; a row that starts with "zero-shot" learns from other books
    only."""
    if not name.startswith(ZERO_SHOT):
        outside = open_outside(specs, opened, words)
        vectors = Words.of(word_features(words, opened.graph.entities))
        folds = make_folds(opened.split, 5)
        ((_, knowledge),) = fit_recipe_scorers(
            folds,
            vectors,
            [()],
            outside=outside.tables._replace(encoder=encoder_of(outside.books, opened, words)),
        )
        return knowledge
    joint, own, folds, outside = join_books(
        specs, opened, words, folds=5, keep_train="unshared" not in name
    )
    vectors = Words.of(word_features(words, joint.graph.entities))
    ((_, knowledge),) = fit_recipe_scorers(folds, vectors, [()], outside=outside.tables)
    return knowledge.of_entities(own)


def encoder_of(books: tuple[OtherBook, ...], opened: OpenedGraph, words: str) -> PairEncoder | None:
    """Return the pair encoder of other books, if they are large; fitted once for all splits, which
    leave out the same shared recipes."""
    if not RecipeScorerConfig().has_encoder_of_others(sum(len(book.recipes) for book in books)):
        return None
    key = (opened.graph.hash, words, *(book.source.sha256 for book in books))
    if key not in ENCODERS:
        ENCODERS[key] = encoder_of_books(books, opened.graph.num_entities, words)
    return ENCODERS[key]


def played(
    opened: OpenedGraph,
    knowledge: RecipeKnowledge,
    distractors: int,
    part: str,
    made: frozenset[str] | None,
) -> dict[str, float]:
    """Play the pair with the highest score.

    Args:
        opened: graph and split.
        knowledge: the scorer.
        distractors: distractors per table.
        part: split part with the tasks.
        made: labels of goals that the other book makes; None for no figures by goal.

    Returns:
        Success by group of tasks: all (the empty name), ``few``, and with ``made`` also ``made``
        and ``other``; NaN for a group without tasks.
    """
    world = World(opened, WordCraftConfig(part=part, num_distractors=distractors))  # type: ignore[arg-type]
    size, tasks = opened.graph.num_entities, np.arange(len(world.tasks))
    recipes = opened.graph.recipes
    makes = {tuple(row) for row in recipes.tolist()}
    train = opened.split.recipes("train")
    used = np.concatenate([train[:, 0], train[train[:, 0] != train[:, 1], 1], train[:, 2]])
    is_rare = np.bincount(used, minlength=size) <= FEW
    is_few = np.array([is_rare[recipes[plans[0][-1]]].any() for plans in world.tasks.plans])
    engine, wins = BatchEngine(world, len(tasks)), []
    for distractor_seed in range(SEEDS):
        state = engine.pose(tasks, distractor_seed, seed=0)
        goal, table = torch.as_tensor(state.goal), torch.as_tensor(state.table)
        slots = table.shape[1]
        best = torch.cat(
            [
                knowledge(goals, tables, torch.zeros_like(goals)).flatten(1).argmax(1)
                for goals, tables in zip(goal.split(1024), table.split(1024), strict=True)
            ]
        )
        one, other = (
            table.gather(1, slot[:, None])[:, 0] for slot in (best // slots, best % slots)
        )
        pairs = torch.stack([torch.minimum(one, other), torch.maximum(one, other), goal], dim=1)
        wins.append([tuple(pair) in makes for pair in pairs.tolist()])
    success = np.mean(wins, axis=0)
    groups = {"": np.ones(len(tasks), dtype=bool), "few ": is_few}
    if made is not None:
        is_made = goals_among(world, made)
        groups |= {"made ": is_made, "other ": ~is_made}
    return {
        name: float(success[group].mean()) if group.any() else float("nan")
        for name, group in groups.items()
    }


def goals_among(world: World, labels: frozenset[str]) -> NDArray[np.bool_]:
    """Mark the tasks whose goal is one of these labels, shape (tasks,)."""
    return np.array([label in labels for label in world.graph.labels(world.tasks.goals)])


def reworded(world: World, book: OtherBook) -> NDArray[np.bool_]:
    """Mark the tasks that another book has with one ingredient replaced by a near-synonym.

    The result and the other ingredient are the same; near-synonyms are those of the reports.
    """
    unit = words_of_books("glove", book.labels).unit_vectors
    one, other, made = book.recipes.T
    marks = []
    for plans in world.tasks.plans:
        a, b, goal = world.graph.recipes[plans[0][-1]].tolist()
        ways = [(one, other), (other, one)]
        x, y = np.concatenate([np.stack(way)[:, made == goal] for way in ways], axis=1)
        near_a = unit[x] @ unit[a] >= NEAR_SYNONYM
        near_b = unit[y] @ unit[b] >= NEAR_SYNONYM
        marks.append(bool(((x == a) & near_b | (y == b) & near_a).any()))
    return np.array(marks)


def scorer_metrics(
    opened: OpenedGraph, part: str, name: str, words: str, specs: Sequence[str], made_by: str | None
) -> dict[str, float]:
    """Return a scorer's MRR and success alone, on all tasks and by groups as in :func:`played`."""
    knowledge = fitted(opened, name, words, specs)
    graph = opened.graph
    scorer = RecipeScorer(knowledge.constants(), graph.entities, graph.hash)
    queries = opened.split.held_out(part)  # type: ignore[arg-type]
    figures = {"mrr": mean_reciprocal_rank(rank_triples(scorer, queries, graph.triples))}
    made = None
    if made_by is not None:
        book = open_other_book(made_by, opened)
        made = frozenset(book.source.makes or ())
        world = World(opened, WordCraftConfig(part=part))  # type: ignore[arg-type]
        figures["share made"] = float(goals_among(world, made).mean())
        figures["share reworded"] = float(reworded(world, book).mean())
    for amount in (8, 1):
        success = played(opened, knowledge, amount, part, made)
        figures |= {f"{group}{amount}": value for group, value in success.items()}
    world = World(opened, WordCraftConfig(part))  # type: ignore[arg-type]
    figures["tasks"] = len(world.tasks)
    return figures


def agent_metrics(
    opened: OpenedGraph, part: str, words: str, specs: Sequence[str], steps: int, home: Path
) -> dict[str, Any]:
    """Return the success of an agent, trained where missing, and of its scorer alone on the same
    tables."""
    graph, model, run = (str(home / name) for name in ("graph", "model", "run"))
    if not Path(graph).exists():
        write_graph_folder(Path(graph), open_book(opened.source), opened.split)
    if not (home / "model/metrics.json").exists():
        train_recipes(
            RecipesConfig(graph, RecipeScorerConfig(features=words, with_=tuple(specs))), model
        )
    if not (home / "run/evaluation.json").exists():
        use, trainer = (
            PolicyConfig(use="combines,component,recipe"),
            ImpalaConfig("paper", steps=steps, eval_every=0),
        )
        train_agent(AgentConfig(graph, model, policy=use, trainer=trainer), run)
    agent, alone = open_agent(run), open_model(model, graph)
    players = {
        "agent": PolicyPlayer(agent.policy),
        "scorer": scorer_players(opened.graph, alone.scorer, alone.triples)["w, best pair"],
    }
    figures: dict[str, Any] = {}
    for amount in (8, 1):
        evaluator = Evaluator(
            World(opened, agent.config.tasks.environment(part, amount)), distractor_seeds=SEEDS
        )  # type: ignore[arg-type]
        played = {name: evaluator(player) for name, player in players.items()}
        success = {name: result.success for name, result in played.items()}
        figures |= {f"{name} {amount}": float(won.mean()) for name, won in success.items()}
        groups = played["agent"].groups
        gain, low, high = paired_difference(success["agent"], success["scorer"], groups)
        figures |= {f"gain {amount}": gain, f"gain {amount} over tasks": [low, high]}
    return figures


def cell(
    options: argparse.Namespace, kind: str, seed: int, name: str, words: str, specs: Sequence[str]
) -> Any:
    """Return the figures of a row on one split, from an earlier call if there was one."""
    home = options.out / f"{Path(options.book).stem}-{kind}-{seed}-{options.part}-{name}"
    file = Path(f"{home}-agent.json" if options.agents else f"{home}.json")
    if not file.exists():
        specs = [spec.format(split=kind, seed=seed) for spec in specs]
        ratios = {"train_ratio": 0.7, "valid_ratio": 0.2} if options.part == "valid" else {}
        opened = open_graph(options.book, SplitConfig(kind, seed=seed, **ratios))  # type: ignore[arg-type]
        if options.agents:
            figures = agent_metrics(opened, options.part, words, specs, options.agents, home)
        else:
            figures = scorer_metrics(opened, options.part, name, words, specs, options.made_by)
        row = {
            "book": opened.graph.name,
            "split": kind,
            "seed": seed,
            "part": options.part,
            "row": name,
        }
        write_atomically(file, json.dumps(row | figures))
    return json.loads(file.read_text())


def rows_of(options: argparse.Namespace) -> Iterator[tuple[str, str, list[str]]]:
    """Yield each row's name, word vectors and sources."""
    sources = {
        name: spec.split(",") for name, _, spec in (each.partition("=") for each in options.source)
    }
    yield "recipes alone", "one-hot", []
    yield "and GloVe", "glove", []
    yield "and words", options.words, []
    for name, specs in sources.items():
        yield name, options.words, specs
    plain = [name for name in sources if not name.startswith((ZERO_SHOT, "control"))]
    if len(plain) > 1:
        yield "all", options.words, [spec for name in plain for spec in sources[name]]


def lines_of(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a line for each row: means over splits with their interval, and each
    split's success."""
    names = dict.fromkeys(row["row"] for row in rows)
    for name in names:
        same = [row for row in rows if row["row"] == name]
        yield f"{name:24}" + "  ".join(
            f"{figure} {np.mean([row[figure] for row in same]):.3f} "
            + shown(
                [row[figure] for row in same],
                -1.0 if figure.startswith("gain") else 0.0,
            )
            for figure in same[0]
            if isinstance(same[0][figure], float)
        )


def shown(values: list[float], lowest: float) -> str:
    """Return the interval over splits, and the value of each."""
    bounds = student_interval(values, within=(lowest, 1.0))
    interval = "[{:.3f}, {:.3f}] ".format(*bounds) if bounds else ""
    return interval + "(" + " ".join(f"{value:.3f}" for value in values) + ")"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("book")
    parser.add_argument("--words", default="minilm", help="word vectors of all rows after GloVe")
    parser.add_argument(
        "--source",
        action="append",
        default=[],
        help="NAME=SPEC,SPEC; NAME may start with zero-shot",
    )
    parser.add_argument(
        "--made-by", metavar="BOOK", help="also success by whether BOOK makes the goal"
    )
    parser.add_argument("--only", help="names of rows, comma-separated")
    parser.add_argument("--splits", default="by-recipe,by-goal,by-slot")
    parser.add_argument("--split-seeds", default="0,1,2")
    parser.add_argument("--part", choices=("test", "valid"), default="test")
    parser.add_argument(
        "--agents",
        type=int,
        metavar="STEPS",
        help="train agents with the scorers, for so many steps",
    )
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/runs/outside-knowledge"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    found: list[dict[str, Any]] = []
    with threadpool_limits(1):
        for kind in options.splits.split(","):
            rows: list[dict[str, Any]] = []
            for name, words, specs in rows_of(options):
                if options.only and name not in options.only.split(","):
                    continue
                for seed in map(int, options.split_seeds.split(",")):
                    rows.append(cell(options, kind, seed, name, words, specs))
                print(*lines_of(rows[-len(options.split_seeds.split(",")) :]), flush=True)
            print(
                f"^ {options.book}, {kind}: {options.part} tasks, splits {options.split_seeds}\n",
                flush=True,
            )
            found += rows
    if options.json:
        write_atomically(options.json, json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
