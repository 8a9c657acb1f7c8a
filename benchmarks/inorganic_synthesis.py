"""Precursors of inorganic materials: the table of docs/evidence/inorganic-synthesis.md.

    wordcraft-kg books --fetch inorganic-synthesis
    python -m benchmarks.inorganic_synthesis --out synthesis --predictions published.json.gz

Each of the five published folds is built, trained on and evaluated in a folder of OUT; what is there
is used again. The table pools the targets of all folds. A fold takes about 81 CPU seconds.

    python -m benchmarks.inorganic_synthesis --out synthesis --folds 1 --ablation
    python -m benchmarks.inorganic_synthesis --out synthesis --folds 1 --wrong 20
    python -m benchmarks.inorganic_synthesis --out synthesis --folds 1 --furnace
    python -m benchmarks.inorganic_synthesis --out synthesis --folds 1 --game

give the same targets without parts of the model (about 200 CPU seconds a fold), wrong first answers
drawn at random, a discovery game in which each attempt is a set for a target, and the crafting game
by coverage alone.

PREDICTIONS holds the published methods' answers and is made by hand: the files
``results/METHOD/top5_random_cvFOLD.json`` of the data's repository, https://github.com/jschrier/SynthGPT
at the commit of the book, packed into one gzipped JSON file ``{method: {fold: {target: sets}}}``,
with folds "1" to "5" and the sets best first. Without it the table has this toolkit's rows alone.
"""

import argparse
import gzip
import heapq
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg import WordCraftConfig, World, open_graph, open_model
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.statistics import paired_difference, wilson_interval
from wordcraft_kg.envs.draws import EvaluationTables
from wordcraft_kg.evaluation.ranked_sets import RankedSets, rank_sets
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.graph_folder import write_graph_folder
from wordcraft_kg.graphs.library import open_book, published_fold
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import read_published_split
from wordcraft_kg.graphs.triples import COMPONENT_OF
from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.link_training import train_links
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_training import train_recipes
from wordcraft_kg.models.recipes.set_fitting import (
    Candidates,
    candidates_of,
    fit_network,
    fit_order,
)
from wordcraft_kg.models.recipes.set_training import rows_of_sets
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.models.scorers.sets.knowledge import Flags, GoalEvidence, SetKnowledge, Vector
from wordcraft_kg.models.scorers.sets.parts import parse_formula
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

BOOK = "inorganic-synthesis"
PAGE = "inorganic-synthesis"
COLUMNS = {
    "all": "all targets",
    "new parts": "element set not in train",
    "new sets": "precursor set not in train",
}
NAMES = {
    "model": "**sets by parts**, this toolkit",
    "statistics of parts": "coverage and frequent precursors alone",
    "sets of the nearest goal": "precursors of the most similar target",
    "most frequent sets": "most frequent sets",
    "elemwise.json": "ElemwiseRetro (2022)",
    "gpt-3.5_finetune_rescore.json": "GPT-3.5 fine-tuned, rescored (2024)",
    "gpt-4_rescore.json": "GPT-4 zero-shot, rescored (2024)",
    "statistical_baseline.json": "statistics of element and precursor (2024)",
}
SHOWN = (1, 5)
COVERAGE_PLAYER = "coverage alone, no model: all items without foreign elements"
PLAYERS = ("the model", "frequency", "random")
ATTEMPTS = (500, 1_000, 2_000, 4_000)
WHOLE = "the whole model"


def model_of_fold(fold: int, out: Path) -> Path:
    """Return the folder of a fold's model, trained if it is not there."""
    folder = out / f"model-{fold}"
    if not (folder / "README.md").is_file():
        book = open_book(BOOK)
        graph = RecipeGraph.from_book(book)
        path = published_fold(BOOK, f"fold-{fold}")
        assert path is not None
        source = out / f"fold-{fold}"
        write_graph_folder(source, book, read_published_split(path, graph), force=True)
        settings = RecipeScorerConfig(parts="formulas")
        train_recipes(RecipesConfig(str(source), settings), folder, force=True)
    return folder


def published_files(path: Path | None, fold: int, out: Path) -> list[Path]:
    """Write a file of predictions for each published method, and return the paths."""
    if path is None:
        return []
    with gzip.open(path, "rt", encoding="utf-8") as file:
        methods = json.load(file)
    folder = out / f"published-{fold}"
    folder.mkdir(exist_ok=True)
    for method, folds in methods.items():
        (folder / f"{method}.json").write_text(json.dumps(folds[str(fold)]), encoding="utf-8")
    return sorted(folder.iterdir())


def table(records: list[RankedSets]) -> list[str]:
    """Return the lines of tables.csv: shares of all folds' targets together, with intervals."""
    right: dict[tuple[str, str, int], float] = defaultdict(float)
    goals: dict[tuple[str, str], int] = defaultdict(int)
    for record in records:
        for method in record.methods:
            for column, top in method.columns.items():
                goals[method.name, column] += top.goals
                for k in SHOWN:
                    right[method.name, column, k] += top.shares[k] * top.goals
    lines = []
    for method, name in NAMES.items():
        for column, heading in COLUMNS.items():
            number = goals[method, column]
            for k in SHOWN if number else ():
                share = right[method, column, k] / number
                low, high = wilson_interval(right[method, column, k], number)
                title = f"{heading}: top-{k}"
                lines.append(f'{PAGE},folds,"{name}","{title}",{share:.3f},{low:.3f},{high:.3f}')
    return lines


def leads(out: Path, folds: list[int]) -> list[str]:
    """Return the model's lead over each published method on all targets, with paired intervals."""
    hits: dict[str, list[list[bool]]] = defaultdict(list)
    for fold in folds:
        path = published_fold(BOOK, f"fold-{fold}")
        assert path is not None
        answers = {"model": out / f"predictions-{fold}.json"}
        answers |= {file.name: file for file in (out / f"published-{fold}").glob("*.json")}
        methods = {name: json.loads(file.read_text("utf-8")) for name, file in answers.items()}
        for target, sets in json.loads(path.read_text("utf-8"))["test"].items():
            right = set(map(frozenset, sets))
            for name, predictions in methods.items():
                ranked = list(dict.fromkeys(map(frozenset, predictions.get(target, ()))))
                hits[name].append([not right.isdisjoint(ranked[:k]) for k in SHOWN])
    tables = {name: np.array(rows) for name, rows in hits.items()}
    lines = []
    for name in sorted(tables.keys() - {"model"}):
        for column, k in enumerate(SHOWN):
            pair = (tables[which][:, [column]] for which in ("model", name))
            lead, low, high = paired_difference(*pair, None)
            lines.append(f"lead over {NAMES[name]}, top-{k}: {lead:+.3f} [{low:+.3f}, {high:+.3f}]")
    return lines


class Uncovered(SetKnowledge):
    """Train recipes of which no rule of coverage is learned: any ingredient may bring any part."""

    def allowed(self, amounts: Vector) -> Flags:
        return np.ones((len(amounts), len(self.counts)), dtype=bool)

    def candidates(self, goal: GoalEvidence, **settings: Any) -> tuple[Ids, Vector]:
        return super().candidates(goal, has_coverage=False)


class Single(SetKnowledge):
    """Train recipes that never need an ingredient more for a part that another one brings."""

    def candidates(self, goal: GoalEvidence, **settings: Any) -> tuple[Ids, Vector]:
        return super().candidates(goal, is_allowed=self.is_single)

    def is_single(self, row: Ids) -> bool:
        """Return whether each ingredient of a set, shape (8,), brings a key part alone."""
        brings = self.lists.has_part[row[row >= 0]][:, self.is_key]
        return bool((brings & (brings.sum(0) == 1)).any(1).all())


ABLATIONS: dict[str, tuple[type[SetKnowledge], tuple[int, ...]]] = {
    WHOLE: (SetKnowledge, ()),
    "no coverage: ingredients may bring any part": (Uncovered, ()),
    "no ingredient more for a part": (Single, ()),
    "no least squares of parts": (SetKnowledge, (25, 26, 27)),
    "no whole sets: no votes, pairs and agreement": (
        SetKnowledge,
        (10, 11, 12, 13, 17, 18, 28, 29),
    ),
    "no network among the features": (SetKnowledge, (6, 7, 9)),
}
"""Knowledge and left-out columns of :meth:`SetKnowledge.features`, by name."""


def ablation(fold: int, out: Path) -> list[str]:
    """Return lines of tables.csv: the model without some of its knowledge, beside the whole model.

    The networks are the same in all rows; committees are fitted to what each row knows.
    """
    model = open_model(model_of_fold(fold, out))
    scorer = model.scorer
    assert isinstance(scorer, SetScorer)
    recipes, amounts, words = (
        getattr(scorer.knowledge, name) for name in ("recipes", "amounts", "words")
    )
    test = rows_of_sets(model.opened.graph, model.opened.split.is_in("test"))
    goals = np.unique(recipes[:, -1])
    fold_of_entity = np.zeros(len(amounts), dtype=np.int64)
    fold_of_entity[goals] = np.random.default_rng(0).permutation(len(goals)) % 5
    fold_of_recipe = fold_of_entity[recipes[:, -1]]
    style = scorer.knowledge.style_parts
    lessons: dict[type[SetKnowledge], list[Candidates]] = defaultdict(list)
    fold_of_lesson: list[int] = []
    for part in range(5):
        others, held_out = (recipes[fold_of_recipe != part], recipes[fold_of_recipe == part])
        network = fit_network(SetKnowledge(others, amounts, words, style), part, members=1)
        for kind in (SetKnowledge, Uncovered, Single):
            knowledge = kind(others, amounts, words, style)
            lessons[kind] += candidates_of(knowledge, network, held_out)
        fold_of_lesson += [part] * (len(lessons[SetKnowledge]) - len(fold_of_lesson))
    tests = {
        kind: candidates_of(kind(recipes, amounts, words), scorer._network, test)
        for kind in (SetKnowledge, Uncovered, Single)
    }
    hits = {}
    for name, (kind, columns) in ABLATIONS.items():
        hits[name] = ranked_hits(lessons[kind], fold_of_lesson, tests[kind], list(columns))
    hits["the order of the search, without a committee"] = first_hits(tests[SetKnowledge])
    hits["ComplEx: train sets by their links to the target"] = link_hits(
        links_of_fold(fold, out), scorer.knowledge, test
    )
    whole = hits[WHOLE]
    lines = []
    for name, table in hits.items():
        for column, k in enumerate(SHOWN):
            low, high = wilson_interval(float(table[:, column].sum()), len(table))
            share = table[:, column].mean()
            lines.append(f'{PAGE},ablation,"{name}",top-{k},{share:.3f},{low:.3f},{high:.3f}')
        for column, k in enumerate(SHOWN if name != WHOLE else ()):
            pair = (each[:, [column]] for each in (table, whole))
            lead, low, high = paired_difference(*pair, None)
            lines.append(
                f'{PAGE},ablation,"{name}",top-{k} less the whole,'
                f"{lead:+.3f},{low:+.3f},{high:+.3f}"
            )
    return lines


def ranked_hits(
    lessons: list[Candidates],
    fold_of_lesson: list[int],
    tests: list[Candidates],
    columns: list[int],
) -> NDArray[np.bool_]:
    """Fit a committee without some features, and return its hits, shape (goals, 2)."""

    def without(candidates: Candidates) -> Candidates:
        features = candidates.features.copy()
        features[:, columns] = 0
        return candidates._replace(features=features)

    order = fit_order(list(map(without, lessons)), np.array(fold_of_lesson), 0)
    ordered = []
    for test in map(without, tests):
        scaled = ((torch.from_numpy(test.features) - order.mean) / order.deviation).clamp(-6, 6)
        scores = order.committee(scaled)[..., 0].mean(0).numpy()
        ordered.append(test._replace(is_right=test.is_right[np.argsort(-scores, kind="stable")]))
    return first_hits(ordered)


def links_of_fold(fold: int, out: Path) -> Scorer:
    """Return ComplEx of a fold, trained with default settings if it is not there."""
    folder = out / f"links-{fold}"
    if not (folder / "README.md").is_file():
        train_links(
            LinksConfig(str(out / f"fold-{fold}"), ComplExConfig(folds=0)), folder, force=True
        )
    return open_model(folder).scorer


def link_hits(scorer: Scorer, knowledge: SetKnowledge, test: Ids) -> NDArray[np.bool_]:
    """Rank all train sets by the mean score of componentOf, and return hits, shape (goals, 2)."""
    goals = np.unique(test[:, -1])
    links = scorer.score(
        torch.from_numpy(knowledge.ingredient_ids[:, None]), COMPONENT_OF, torch.from_numpy(goals)
    )
    sets = knowledge.lists.sets
    is_in = sets >= 0
    hits = []
    for goal, column in zip(goals, links.numpy().T, strict=True):
        means = np.where(is_in, column[sets], 0).sum(1) / is_in.sum(1)
        best = sets[np.argsort(-means, kind="stable")[: max(SHOWN)]]
        members = test[test[:, -1] == goal, :-1]
        is_known = ((members < 0) | (knowledge.number_of[members] >= 0)).all(1)
        right = knowledge.numbers(members[is_known])
        is_right = (best[:, None] == right[None]).all(2).any(1)
        hits.append([is_right[:k].any() for k in SHOWN])
    return np.array(hits)


def first_hits(tests: list[Candidates]) -> NDArray[np.bool_]:
    """Return whether the first one, and five, candidates have a right set, shape (goals, 2)."""
    return np.array([[test.is_right[:k].any() for k in SHOWN] for test in tests])


def coverage_game(fold: int, out: Path) -> list[str]:
    """Play the crafting game by a rule without a model: take each item that brings no foreign part.

    The trivial twin of the model's best set. Carbon, hydrogen, nitrogen and oxygen may be lost.
    """
    opened = open_graph(out / f"fold-{fold}")
    graph = opened.graph
    parts = [set(parse_formula(label)) for label in graph.entities]
    empty = {graph.num_entities}
    recipes = {(*sorted(set(row[:-1]) - empty), row[-1]) for row in graph.sets.tolist()}
    lines = []
    for distractors in (1, 8):
        world = World.open(opened, WordCraftConfig(num_distractors=distractors, part="test"))
        tables = EvaluationTables(world)
        tasks = np.linspace(0, len(world.tasks) - 1, 300).astype(int).tolist()
        made = 0
        for task in tasks:
            goal = graph.entities.index(world.tasks[task].goal)
            items = [item for item in tables.table(task) if item < graph.num_entities]
            foreign = [parts[item] - parts[goal] - {"C", "H", "N", "O"} for item in items]
            chosen = sorted(item for item, extra in zip(items, foreign, strict=True) if not extra)
            made += (*chosen, goal) in recipes
        low, high = wilson_interval(float(made), len(tasks))
        count = f"{distractors} distractor{'s' * (distractors > 1)}"
        share = made / len(tasks)
        lines.append(f'{PAGE},players,"{COVERAGE_PLAYER}",{count},{share:.3f},{low:.3f},{high:.3f}')
    return lines


def wrong_answers(fold: int, out: Path, number: int) -> list[str]:
    """Return targets with a wrong first set, drawn at random, with it and the right sets."""
    path = published_fold(BOOK, f"fold-{fold}")
    assert path is not None
    predictions = json.loads((out / f"predictions-{fold}.json").read_text("utf-8"))
    lines = []
    for target, sets in json.loads(path.read_text("utf-8"))["test"].items():
        right = list(dict.fromkeys(" + ".join(sorted(set(each))) for each in sets))
        answers = [" + ".join(each) for each in predictions[target]]
        if not answers or answers[0] not in right:
            places = [answers.index(each) + 1 for each in right if each in answers]
            place = min(places, default="none of ten")
            first = answers[0] if answers else "no answer"
            lines.append(f"{target}: {first}; right, at {place}: {', or '.join(right)}")
    rows = np.random.default_rng(fold).choice(len(lines), min(number, len(lines)), replace=False)
    return [f"{len(lines)} wrong first sets", *(lines[row] for row in sorted(rows))]


def furnace(fold: int, out: Path) -> list[str]:
    """Return lines of tables.csv: unseen targets made by several players after some attempts.

    An attempt is a set for a target, and succeeds if a recipe of the literature has it. The player
    tries the likeliest set of all targets not made yet; a set that failed leaves its probability to
    the target's other sets. Frequency tries each target's first set of frequent precursors, then
    each second one, targets of frequent precursors first. Random tries any of a target's candidates.
    """
    model = open_model(model_of_fold(fold, out))
    scorer = model.scorer
    assert isinstance(scorer, SetScorer)
    knowledge = scorer.knowledge
    right = defaultdict(set)
    for row in rows_of_sets(model.opened.graph, model.opened.split.is_in("test")).tolist():
        right[row[-1]].add(tuple(each for each in row[:-1] if each >= 0))
    rng = np.random.default_rng(fold)
    queues: dict[str, list[list[tuple[float, bool]]]] = {name: [] for name in PLAYERS}
    for goal, sets in right.items():
        try:
            ranked = scorer.recipes(goal, 30)
        except ConfigError:
            continue
        is_right = [each.ingredients in sets for each in ranked]
        chances = np.array([each.probability for each in ranked])
        left = 1 - np.append(0, np.cumsum(chances)[:-1])
        queues["the model"].append(
            list(zip(chances / np.maximum(left, 1e-9), is_right, strict=True))
        )
        order = rng.permutation(len(ranked))
        draws = rng.random(len(ranked))
        queues["random"].append([(draws[row], is_right[row]) for row in order])
        frequent = knowledge.sets_by_frequency(scorer.evidence(goal))[:30]
        rounds = []
        for place, row in enumerate(frequent):
            members = row[row >= 0]
            names = tuple(sorted(knowledge.ingredient_ids[members].tolist()))
            rarest = knowledge.counts[members].min()
            rounds.append((rarest / len(knowledge.recipes) - place, names in sets))
        queues["frequency"].append(rounds)
    lines = []
    for player in PLAYERS:
        curve = made_by_attempt(queues[player])
        for attempts in ATTEMPTS:
            share = curve[min(attempts, len(curve)) - 1] / len(right)
            lines.append(f'{PAGE},furnace,{player},"{attempts:,} attempts",{share:.3f},,')
    return lines


def made_by_attempt(queues: list[list[tuple[float, bool]]]) -> list[int]:
    """Return the number of targets made after each attempt, the most urgent attempt first.

    Args:
        queues: for each target, urgency and success of its attempts in order.
    """
    heap = [(-queue[0][0], target, 0) for target, queue in enumerate(queues) if queue]
    heapq.heapify(heap)
    curve = [0]
    while heap:
        _, target, place = heapq.heappop(heap)
        is_made = queues[target][place][1]
        curve.append(curve[-1] + is_made)
        if not is_made and place + 1 < len(queues[target]):
            heapq.heappush(heap, (-queues[target][place + 1][0], target, place + 1))
    return curve[1:]


def main() -> None:
    """Train, evaluate, and print the lines of the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--predictions", type=Path)
    parser.add_argument("--folds", default="1,2,3,4,5")
    parser.add_argument("--ablation", action="store_true")
    parser.add_argument("--wrong", type=int, default=0, metavar="NUMBER")
    parser.add_argument("--furnace", action="store_true")
    parser.add_argument("--game", action="store_true")
    given = parser.parse_args()
    given.out.mkdir(exist_ok=True)
    records = []
    folds = list(map(int, given.folds.split(",")))
    if given.ablation or given.wrong or given.furnace or given.game:
        for fold in folds:
            lines = ablation(fold, given.out) if given.ablation else []
            lines += wrong_answers(fold, given.out, given.wrong) if given.wrong else []
            lines += furnace(fold, given.out) if given.furnace else []
            lines += coverage_game(fold, given.out) if given.game else []
            print("\n".join(lines), flush=True)
        return
    for fold in folds:
        path = given.out / f"ranked-{fold}.json"
        if not path.is_file():
            model = open_model(model_of_fold(fold, given.out))
            files = published_files(given.predictions, fold, given.out)
            ranked, predictions = rank_sets(model, "model", files)
            (given.out / f"predictions-{fold}.json").write_text(json.dumps(predictions))
            path.write_text(json.dumps(as_values(ranked)))
        record = msgspec.json.decode(path.read_bytes(), type=RankedSets)
        records.append(record)
        print(f"fold {fold}: calibration error {record.calibration_error:.3f}", flush=True)
    print("\n".join(table(records)))
    print("\n".join(leads(given.out, folds)))


if __name__ == "__main__":
    main()
