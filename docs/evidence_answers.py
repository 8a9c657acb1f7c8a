"""Answers and caveats of the evidence pages that quote stored measurements.

As in evidence_tables.py, a page marks the place: ``<!-- table: NAME -->`` ... ``<!-- end of table -->``,
with a name of ANSWERS. Most figures are quoted from a cell of the page's own table, so an answer
cannot differ from its table.
"""

import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator
from functools import cache
from itertools import combinations
from typing import Any

from evidence_tables import (
    DATA,
    FEW_SPLITS,
    HERE,
    TABLES,
    Row,
    _interval,
    _mean,
    _read,
    _reference,
    _rounded,
    _rows,
    _shown,
    over_splits,
)

from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.studies.claims import signed

LITTLE = "little-alchemy-2"


@cache
def _table(name: str) -> list[list[str]]:
    """Return the cells of a generated table, its heading first; marks of emphasis are left out."""
    lines = [line for line in TABLES[name]() if line.startswith("|")]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [[cell.replace("**", "") for cell in row] for row in (rows[0], *rows[2:])]


def cell(table: str, row: str, column: str) -> str:
    """Return a cell of a generated table: a value with its interval, if it has one.

    Args:
        table: a name of TABLES.
        row: the row's first cell, without emphasis.
        column: the column's heading.
    """
    head, *rows = _table(table)
    (found,) = [cells for cells in rows if cells[0] == row]
    return found[head.index(column)]


def value(table: str, row: str, column: str) -> str:
    """Return the value of a cell, without the interval or the single values behind it."""
    return cell(table, row, column).partition(" ")[0]


def column(table: str, name: str) -> list[str]:
    """Return the values of a column, without intervals."""
    head, *rows = _table(table)
    return [cells[head.index(name)].partition(" ")[0] for cells in rows]


def _of_pack(player: str, distractors: int) -> str:
    """Return a scripted player's success with its interval: Little Alchemy 2, depth 1."""
    (row,) = [
        row
        for row in _reference(LITTLE)
        if (row["player"], row["measure"]) == (player, "success") and row["play"]["depth"] == 1
    ]
    figures = row["figures"][str(distractors)]
    low, high = _shown(figures["low"]), _shown(figures["high"])
    return f"{_shown(figures['value'])} [{low}, {high}]"


def baselines() -> Iterator[str]:
    """Yield what perfect links and counting make without learning."""
    links, edgeless, votes = (
        f"{_of_pack(player, 1)} and {_of_pack(player, 8)}"
        for player in ("full KG, u+v", "full KG, u+v, no self edges", "partial KG, votes")
    )
    yield (
        f"**Answer.** Perfect links without learning make {links} of the goals of Little Alchemy 2, with "
        f"1 and 8 distractors; without self edges, the links of an item with itself, {edgeless}. Counting "
        f"train recipes makes {votes}."
    )


def baselines_caveats() -> Iterator[str]:
    """Yield how good the choice of rare entities is."""
    _, *rows = _table("scripted players")
    chance, rare = rows[:2]
    times = max(float(b) / float(a) for a, b in zip(chance[1:], rare[1:], strict=True))
    yield (
        "- *Fewest uses* is a shortcut of the tables: a task's ingredients are not sampled as distractors, "
        "so rare entities are more often ingredients. On a book of random recipes the shortcut works well; "
        f"here it is at most {times:.1f} times as good as chance."
    )


def small_books() -> Iterator[str]:
    """Yield on how many small books ComplEx is below counting."""
    rows = _read(f"{DATA}/small-books.json")
    below = {}
    for key in ("fixed", "chosen"):
        worse = [row["frequency"] - row[key] for row in rows if row[key] < row["frequency"]]
        below[key] = len(worse), _shown(max(worse))
    yield (
        "**Answer.** Thousands of recipes, or chosen weights: with chosen weights it is below counting on "
        f"{below['chosen'][0]} of {len(rows)} small books, by at most {below['chosen'][1]}; with the "
        f"weight for large books on {below['fixed'][0]}, by up to {below['fixed'][1]}."
    )


def environments() -> Iterator[str]:
    """Yield the speed of batched environments."""
    batched, plain = (
        row["steps_per_cpu_second"]
        for name in ("batched 1024", "plain 1024")
        for row in _rows(f"{DATA}/environments.json", row=name)
    )
    yield (
        f"**Answer.** 1,024 batched environments make {batched / 1e6:.1f} million steps per CPU second, "
        f"{_rounded(batched / plain)} times as many as a loop in plain Python. Measured once, beside other "
        "work, so without an interval."
    )


def _own(column: str, distractors: int = 8, player: str = "recipe scorer alone, w") -> list[float]:
    """Return the recipe scorer's values on each split by recipe of Little Alchemy 2."""
    where = {"book": LITTLE, "split": "by-recipe", "distractors": distractors}
    (row,) = _rows("untrained-players.json", player=player, **where)
    return list(row[column])


def links() -> Iterator[str]:
    """Yield the MRR of the recipe scorer and of others on Little Alchemy 2."""
    own = _own("mrr")
    of_kernel = [row["mrr"] for row in _rows("link-quality.json", book=LITTLE, row="recipe kernel")]
    gain = over_splits([a - b for a, b in zip(own, of_kernel, strict=True)])
    ends = student_interval(own)
    assert ends is not None
    low, high = map(_shown, ends)
    kernel, rule, complex_ = (
        value("links", name, "Little Alchemy 2")
        for name in ("recipe kernel, no training", "neighbour rule, no training", "ComplEx")
    )
    lists = _shown(
        _mean([row["mrr"] for row in _rows(f"{DATA}/lists.json", book=LITTLE, split="by-recipe")])
    )
    yield (
        f"**Answer.** The recipe scorer: MRR {_shown(_mean(own))} [{low}, {high}] on Little Alchemy 2 "
        f"(Student's t over {len(own)} splits), where the recipe kernel, in closed form, has {kernel} "
        f"(difference {gain}), a neighbour rule {rule} and ComplEx {complex_}. That scorer, by tables, is no "
        f"longer trained; [today's, by lists](lists.md), has {lists}."
    )


def links_caveats() -> Iterator[str]:
    """Yield the hits of ComplEx and of the neighbour rule."""

    def hits(book: str, metric: str, name: str = "ComplEx") -> str:
        rows = _rows("link-quality.json", book=book, row=name)
        return _shown(_mean([row[metric] for row in rows]))

    few, many = "hits_at_1", "hits_at_10"
    yield (
        f"- ComplEx has hits@1 and hits@10 of {hits('everyday', few)} and {hits('everyday', many)} on "
        f"`everyday`, {hits(LITTLE, few)} and {hits(LITTLE, many)} on Little Alchemy 2; there the "
        f"neighbour rule has hits@10 of {hits(LITTLE, many, 'neighbour rule')}."
    )


def _lists_against_tables(figure: str, split: str) -> float:
    """Return the figure by lists minus that by tables, of means over splits."""
    ways = []
    for source in (f"{DATA}/lists.json", "outside-knowledge.json"):
        rows = _rows(source, book=LITTLE, split=split, row="and GloVe")
        ways.append(_mean([row[figure] for row in rows]))
    return ways[0] - ways[1]


def _farthest() -> str:
    """Return the largest difference in success between lists and tables."""
    return _shown(
        max(
            abs(_lists_against_tables(figure, split))
            for figure in ("8", "1")
            for split in ("by-recipe", "by-goal")
        )
    )


def lists() -> Iterator[str]:
    """Yield what neighbour lists cost."""
    recipes, goals = (
        _shown(-_lists_against_tables("mrr", split)) for split in ("by-recipe", "by-goal")
    )
    yield (
        f"**Answer.** On one book, with GloVe, success by lists differs from success by tables of all pairs "
        f"by at most {_farthest()}: four differences of means over {FEW_SPLITS} splits, without an interval. "
        f"MRR is lower: by {recipes} by recipe, by {goals} by goal."
    )


def recipe_scorer_caveats() -> Iterator[str]:
    """Yield what neighbour lists change in the figures of the recipe scorer."""
    yield (
        "- These are figures of the scorer by tables. [By neighbour lists](lists.md), as today, success "
        f"with GloVe differs by at most {_farthest()}, and MRR by recipe is "
        f"{_shown(-_lists_against_tables('mrr', 'by-recipe'))} lower."
    )


def large_books() -> Iterator[str]:
    """Yield the success of the best pair and of the planner on Infinite Craft."""
    entities = json.loads((HERE / DATA / "large-book-results.json").read_text(encoding="utf-8"))[
        "entities"
    ]
    texts = []
    for table in ("large book", "large book by goal"):
        for row, where in (
            ("recipe scorer, best pair (w)", "depth 1, 8 distractors"),
            ("recipe scorer, planner", "depth 2, 4 distractors"),
        ):
            texts.append(cell(table, row, where))
    yield (
        f"**Answer.** Infinite Craft, with {entities:,} entities, trains on two cores ([time and "
        f"memory](../limits.md)). The scorer's best pair makes {texts[0]} of the goals with unseen recipes "
        f"and 8 distractors, and its planner {texts[1]} of the goals of depth 2 with 4 distractors; of "
        f"unseen goals {texts[2]}, and {texts[3]} at depth 2, where the goal or the intermediate is unseen."
    )


def new_entities() -> Iterator[str]:
    """Yield how words rank a new entity among new ones, on two books."""
    texts = []
    for book, title in (("everyday-1", "`everyday-1`"), (LITTLE, "Little Alchemy 2")):
        rows = _rows(f"{DATA}/new-entities.json", book=book, question="it")
        asked = sum(row["queries"] for row in rows)
        mean, chance = (
            _shown(sum(row["queries"] * row[key] for row in rows) / asked)
            for key in ("rankers", "chance")
        )
        each = " and ".join(_shown(row["rankers"]) for row in rows)
        texts.append(f"{mean} on {title} ({each} in two samples; chance {chance})")
    yield (
        "**Answer.** Partly: among 30 entities that no recipe has, the right one is ranked with an MRR of "
        f"{' and '.join(texts)}."
    )


def _alone(player: str, split: str = "by-recipe") -> str:
    """Return the success of a player without an agent on Little Alchemy 2, 8 distractors."""
    (row,) = _rows("untrained-players.json", book=LITTLE, split=split, player=player, distractors=8)
    return _shown(_mean(row["success"])) + _interval(row["success"], row["tasks"])


def whole_recipes() -> Iterator[str]:
    """Yield the best pair's success by whole recipes and by two scores of links."""
    whole, apart = _alone("recipe scorer alone, w"), _alone("recipe scorer alone, u v")
    yield (
        f"**Answer.** Yes: the best pair by whole recipes makes {whole} of the goals with 8 distractors, the "
        f"best composition of two scores of links {apart} (Little Alchemy 2, unseen recipes, "
        f"{FEW_SPLITS} splits)."
    )


def untrained() -> Iterator[str]:
    """Yield how far the recipe scorer alone gets."""
    own = "recipe scorer alone, w"
    yield (
        f"**Answer.** As far as with the best agents of depth 1: the recipe scorer's best pair makes "
        f"{_alone(own)} of the goals with unseen recipes (Little Alchemy 2, 8 distractors), and "
        f"{_alone(own, 'by-goal')} of unseen goals."
    )


def untrained_caveats() -> Iterator[str]:
    """Yield the difference between random items and random pairs, and success at depth 2."""
    where = {"book": LITTLE, "split": "by-recipe", "player": "random", "distractors": 1}
    (row,) = _rows("untrained-players.json", **where)
    at = {"player": "random pairs", "depth": 1, "distractors": 1, "tasks": row["tasks"][0]}
    (pairs,) = _rows("study-players.json", **at)
    yield (
        "- *Random* may choose an item twice, so with 1 distractor it makes "
        f"{_shown(row['success'][0])} on split 0, where random pairs of different items make "
        f"{_shown(pairs['success'])}."
    )
    deep = {"book": LITTLE, "player": "w", "depth": 2, "distractors": 4, "policy": "any"}
    rates = [
        _mean([each["success"] for each in _rows("planning.json", split=split, **deep)])
        for split in ("by-recipe", "by-goal")
    ]
    yield (
        f"- At depth 2 with 4 distractors the best pair makes {_shown(rates[0])} of the goals by recipe and "
        f"{_shown(rates[1])} by goal: with [plans](planning.md) they are made."
    )


def words() -> Iterator[str]:
    """Yield success with and without words."""
    by_split = {
        split: (_alone("recipe scorer alone, w", split), _alone("graph without words, w", split))
        for split in ("by-recipe", "by-goal")
    }
    recipe, goal = by_split["by-recipe"], by_split["by-goal"]
    yield (
        f"**Answer.** By recipe it hardly needs words: a recipe scorer without word vectors makes "
        f"{recipe[1]} of the goals, with them {recipe[0]}; counting alone, by votes, makes "
        f"{value('words', 'by recipe', 'votes, best pair')}. By goal and by slot it needs them: by "
        f"goal it makes {goal[1]} without words, {goal[0]} with them."
    )


def discovery() -> Iterator[str]:
    """Yield how many entities players know after 500 attempts."""
    learner, plain, words = (
        cell("explorers", f"`{name}`", "500")
        for name in ("recipe-learner", "random-no-repeat", "nearest-words")
    )
    people = cell("explorers", "people who are still playing", "500")
    yield (
        f"**Answer.** With the recipes of another book, {learner} entities of Little Alchemy 2 in 500 "
        f"attempts, where random pairs give {plain}, nearest words {words.partition(' ')[0]}, and people who "
        f"are still playing {people}."
    )


def people_without_goal() -> Iterator[str]:
    """Yield what people know after 10, 50 and 100 attempts."""
    plain = json.loads((HERE / DATA / "discovery-plain.json").read_text(encoding="utf-8"))
    known = [f"{plain['people'][n]:.3g}" for n in ("10", "50", "100")]
    yield (
        f"People know {' / '.join(known)} in another game: {plain['people_source']}. Figures: [published results](../references.md)."
    )


def worlds() -> Iterator[str]:
    """Yield what knowledge of another book adds in many worlds."""
    area = "everyday, worlds 8 to 17: area"
    plain, learner = (
        cell("worlds", f"`{name}`", area) for name in ("random-no-repeat", "recipe-learner")
    )
    times = float(learner.partition(" ")[0]) / float(plain.partition(" ")[0])
    yield (
        f"**Answer.** Knowledge of another book makes {times:.1f} times as much of what random play "
        f"discovers: {learner} instead of {plain} of the area of a player that knows the world (ten worlds of "
        "`everyday`). Nobody comes near this player."
    )


def worlds_caveats() -> Iterator[str]:
    """Yield what a small language model discovers in some of the worlds."""
    rows = _read(f"{DATA}/worlds-language-model.json")
    model, plain, words = (
        [row[player] for row in rows]
        for player in ("SmolLM2-135M by probabilities", "random-no-repeat", "nearest-words")
    )
    gains = [own - other for own, other in zip(model, words, strict=True)]
    ends = student_interval(gains, within=(-math.inf, math.inf))
    assert ends is not None  # there are several worlds
    gain = f"{_mean(gains):+.1f} [{ends[0]:+.1f}, {ends[1]:+.1f}]"
    yield (
        f"- A language model by text, SmolLM2-135M by probabilities, knows {_mean(model):.1f} items after "
        f"{rows[0]['attempts']} attempts, random play {_mean(plain):.1f}, nearest words {_mean(words):.1f}; that is {gain} "
        f"against nearest words, over {len(rows)} worlds of `everyday` (from world 8), one game of the model in "
        "each."
    )


def penalty() -> Iterator[str]:
    """Yield the gain of agents on their scorer."""
    head, *rows = _table("penalty")
    at = head.index("gain")
    first = rows[0]
    assert first[:2] == ["Little Alchemy 2, by goal", "8"]
    gains = {(row[0], row[1]): row[at] for row in rows}
    others = [text for text in gains.values() if text != first[at]]
    significant = [text for text in others if "-" not in text.partition("[")[2]]
    assert not significant
    values = sorted((text.partition(" ")[0] for text in others), key=float)
    yield (
        f"**Answer.** Yes: with it, agents differ from their scorer by {first[at]} with unseen goals and 8 "
        f"distractors (Little Alchemy 2, five splits), and elsewhere by {values[0]} to {values[-1]}. One of "
        f"{len(rows)} intervals is above 0, and none is corrected for their number."
    )


def people_pairs() -> Iterator[str]:
    """Yield how well a recipe scorer and one person judge pairs."""
    _, scorer, person, _ = _table("people pairs")
    yield (
        "**Answer.** It judges them better than one person who does not know the game. Is it a recipe? Area "
        f"under the curve (AUC) {scorer[1]} against {person[1]}. Which of four results? {scorer[2]} right against "
        f"{person[2]}. Whether it agrees with people is not measured."
    )


def intervals() -> Iterator[str]:
    """Yield the coverage of intervals over three and five seeds."""

    def of(kind: str, seeds: int) -> Row:
        (row,) = _rows("interval-coverage.json", kind=kind, seeds=seeds)
        return row

    three, five = (of("success over seeds and tasks", seeds) for seeds in (3, 5))
    failing = "the same if one training in five fails, .75 in place of .97"
    texts = [
        f"{_shown(row['coverage'])} ({_shown(row['lowest'])} to {_shown(row['highest'])} over scenarios)"
        for row in (three, five)
    ]
    yield (
        "**Answer.** Yes where all trainings succeed: the true success lies in the interval of "
        f"{texts[0]} of simulated studies with three seeds, and {texts[1]} with five. No if single trainings "
        f"fail: {_shown(of(failing, 3)['coverage'])} with three seeds, "
        f"{_shown(of(failing, 5)['coverage'])} with five."
    )


def speed() -> Iterator[str]:
    """Yield the CPU seconds of an agent, and how fast the trainer is."""
    seconds = column("speed", "CPU seconds for 3,000,000 steps")
    rates = {row["row"]: row["steps_per_cpu_second"] for row in _read(f"{DATA}/speed.json")}
    times = rates["no graph"] / rates["plain loop"]
    yield (
        f"**Answer.** Three million steps of an agent take {seconds[1]} CPU seconds without a graph, "
        f"{seconds[2]} with scores of links and {seconds[3]} with scores of whole recipes; without a graph the "
        f"trainer is {times:.1f} times as fast as a plain loop in torch. Measured once, beside other work, so "
        "without an interval."
    )


def probabilities() -> Iterator[str]:
    """Yield how many true triples the recipe scorer expects, and how many there are."""
    partners, parts = (
        [cell("probabilities", name, key) for key in ("expected", "observed")]
        for name in ("combinesWith", "componentOf")
    )
    _, *bins = _table("promised")
    promise, observed = max((row[2:] for row in bins), key=lambda cells: float(cells[0]))
    yield (
        "**Answer.** Nearly: on the test part of Little Alchemy 2 the recipe scorer expects "
        f"{partners[0]} true triples of combinesWith where {partners[1]} are true, and {parts[0]} of "
        f"componentOf where {parts[1]} are (split 10). The counts have no interval. The most probable triples "
        f"are true more often than promised: {observed} instead of {promise}."
    )


def joint_training() -> Iterator[str]:
    """Yield what WordNet's triples add to ComplEx."""
    _, without, with_triples = _table("joint training")
    yield (
        "**Answer.** Yes: WordNet's triples raise the MRR on unseen triples from "
        f"{without[1]} to {with_triples[1]} by recipe, and from {without[2]} to {with_triples[2]} by goal. One "
        "split and one training each, so without an interval."
    )


ABOUT_HALF = 0.5


def without_search() -> Iterator[str]:
    """Yield how far agents without plans get, beside the planner."""
    names = (
        "agent with u, v, w, the recommended preset",
        "planner, nothing learned from play",
        "agent with u, v, w, the paper's preset",
    )
    agent, planner, paper = (cell("without search", name, "success") for name in names)
    share = float(agent.partition(" ")[0]) / float(planner.partition(" ")[0])
    assert round(share, 1) == ABOUT_HALF
    yield (
        f"**Answer.** About half of it: on the book `kitchen` an agent with scores of links and recipes makes "
        f"{agent} of the goals of depth 2, where the planner makes {planner}; with the paper's preset {paper}."
    )


def presets() -> Iterator[str]:
    """Yield how much the trainer's settings matter."""
    own, paper = (cell("presets", name, "success") for name in ("recommended", "paper"))
    difference = cell("presets", "recommended", "difference to the paper's")
    yield (
        "**Answer.** At depth 2, by more than a factor of two: on the book `kitchen` the recommended preset "
        f"makes {own} of the goals and the paper's {paper}, a difference of {difference}."
    )
    assert float(value("presets", "recommended", "success")) > 2 * float(
        value("presets", "paper", "success")
    )


def plan_weights() -> Iterator[str]:
    """Yield what carrying a plan on adds on the test splits, and what weights from play add."""
    rows = _read(f"{DATA}/plan-weights.json")

    def gains(key: str) -> str:
        """Return the least and the largest difference, and how many intervals are above 0."""
        differences = [row[key] for row in rows]
        ends = [signed(end(mean for mean, *_ in differences)) for end in (min, max)]
        above = sum(low > 0 for _, low, _ in differences)
        return f"{ends[0]} to {ends[1]} ({above} of {len(differences)} intervals above 0)"

    yield (
        "**Answer.** The planner that carries its plan on makes more goals of depth 2 than the one that "
        f"searches again after the first attempt, {gains('over_again')}, and than the planner that does not "
        f"know that plans seldom use an ingredient again, {gains('over_any_form')}. Weights of 14 features, "
        f"learned in play on train tasks, add to it: {gains('weights_over_planner')}."
    )


LEADERBOARD = HERE.parent / "leaderboard" / "everyday-v3"
EARLIER = HERE.parent / "leaderboard" / "archive" / "everyday-v2.zip"
"""Submissions to the second edition whose games are no rows of the third."""
TUNED = "SmolLM2-135M, fine-tuned on recipes, by recipes"
GAMES = "SmolLM2-135M, fine-tuned on recipes and games, by generation"
GAMES_CONSTRAINED = "SmolLM2-135M, fine-tuned on recipes and games, constrained"
REINFORCED = "SmolLM2-135M, fine-tuned on recipes and games, then GRPO, by generation"
REINFORCED_CONSTRAINED = "SmolLM2-135M, fine-tuned on recipes and games, then GRPO, constrained"
UNTUNED = "SmolLM2-135M, untuned, by recipes"
ANY_PAIR = "fine-tuned on recipes, an item with itself allowed"


def _file(track: str, row: str, name: str) -> bytes | None:
    """Return a file of a submission on the leaderboard, or else in the archive; None without one."""
    for archive, member in ((LEADERBOARD / f"{track}.zip", row), (EARLIER, f"{track}/{row}")):
        with zipfile.ZipFile(archive) as files:
            if f"{member}/{name}" in files.namelist():
                return files.read(f"{member}/{name}")
    return None


@cache
def _submission(track: str, row: str) -> dict[str, Any]:
    """Return what a submission says of itself; empty if the player has not played the track."""
    data = _file(track, row, "submission.json")
    return {} if data is None else dict(json.loads(data))


def _success_of(track: str, archive: str, digits: int = 3) -> str:
    """Return the success of a submission."""
    mean = _submission(track, archive)["figures"]["mean"]
    return f"{mean:.{digits}f}".removeprefix("0")


def _played(track: str, archive: str, digits: int = 3) -> str:
    """Return the success of a submission with its interval."""
    figures = _submission(track, archive)["figures"]
    ends = (f"{figures[end]:.{digits}f}".removeprefix("0") for end in ("ci_low", "ci_high"))
    return f"{_success_of(track, archive, digits)} [{', '.join(ends)}]"


LITE_TRACKS = "craft-1-lite", "craft-1-lite-made-up", "craft-8-lite", "goal-8-lite", "depth-2-lite"
WAYS = {
    "recipe scorer with GloVe": "scorer-glove",
    "Qwen2.5-Coder-1.5B, by recipes": "qwen15-recipes",
    "Qwen2.5-Coder-0.5B, by recipes": "qwen05-recipes",
    "SmolLM2-135M, by recipes": "smollm2-recipes",
    "nearest words (MiniLM; of made-up words GloVe)": "nearest-words",
    "SmolLM2-135M, probabilities and a look-up": "smollm2-probabilities-look-ups",
    "SmolLM2-135M, probabilities": "smollm2-probabilities",
    "Qwen2.5-Coder-1.5B, constrained": "qwen15-constrained",
    "Qwen2.5-Coder-0.5B, constrained": "qwen05-constrained",
    "Qwen2.5-Coder-0.5B, generation (everyday-v2)": "qwen05-generation",
}
"""Rows of the table of small language models, and their archives on the leaderboard."""


@cache
def _different_items(track: str) -> str:
    """Return the success of a random pair of different items, in a track of one attempt."""
    of = open_track(track)
    # The ingredients of a recipe are in the order of their ids, as are those of a pair below.
    makes = set(map(tuple, of.opened.graph.recipes.tolist()))
    rates = []
    for task in of.frozen.tasks:
        _, _, goal = of.opened.graph.recipes[task.plans[0][-1]].tolist()
        pairs = list(combinations(sorted(task.table), 2))
        rates.append(sum((*pair, goal) in makes for pair in pairs) / len(pairs))
    return _shown(sum(rates) / len(rates))


def language_models() -> Iterator[str]:
    """Yield the table of small language models on the frozen tracks; an empty cell was not played."""
    yield f"| player | {' | '.join(f'`{track}`' for track in LITE_TRACKS)} |"
    yield f"|---|{'---|' * len(LITE_TRACKS)}"
    for title, archive in WAYS.items():
        cells = [
            _played(track, archive) if _submission(track, archive) else "" for track in LITE_TRACKS
        ]
        yield f"| {title} | {' | '.join(cells)} |"
    chance = (_success_of(track, "random") for track in LITE_TRACKS)
    yield f"| chance | {' | '.join(chance)} |"
    # In two attempts, what the first makes counts, so a rate of pairs says little.
    drawn = (_different_items(track) if "depth-2" not in track else "" for track in LITE_TRACKS)
    yield f"| random pair of different items | {' | '.join(drawn)} |"


def language_models_answer() -> Iterator[str]:
    """Yield what small language models make by a recipe's text, and by the rules."""

    def made(archive: str) -> str:
        """Return the success on three tracks, as a text."""
        tracks = ("craft-1-lite", "craft-8-lite", "goal-8-lite")
        return _listed([_success_of(track, archive) for track in tracks])

    made_up = "craft-1-lite-made-up"
    yield (
        "**Answer.** It knows words rather than the game. Asked for a recipe, without rules, Qwen2.5-Coder-1.5B "
        f"makes {made('qwen15-recipes')} of the goals of `craft-1-lite`, `craft-8-lite` and `goal-8-lite`; "
        f"chance makes {made('random')}, nearest MiniLM words {made('nearest-words')}, a recipe scorer "
        f"{made('scorer-glove')}. After the rules, constrained to the table, it makes "
        f"{made('qwen15-constrained')}. With made-up words it makes {_played(made_up, 'qwen15-recipes')} of "
        f"`craft-1-lite`, no more than a random pair of different items ({_different_items(made_up)})."
    )


def _legal_at_once(track: str, archive: str) -> str:
    """Return in how many games of a submission no answer was invalid, as a text."""
    lines = (_file(track, archive, "games.jsonl") or b"").splitlines()
    games = [json.loads(line) for line in lines]
    legal = sum(not game.get("invalid_actions") for game in games)
    return f"{legal} of {len(games)}"


def language_models_caveats() -> Iterator[str]:
    """Yield legal answers by generation, open-ended play, and the tracks with made-up words."""
    legal = _legal_at_once("craft-1-lite", "qwen05-generation")
    yield (
        f"- By generation Qwen2.5-Coder-0.5B answers legally at once in {legal} games of `craft-1-lite`. In the others it "
        "copies the prompt's example, names the goal as an ingredient, or lists three items, and repeats "
        "that answer when it is refused."
    )
    read = json.loads((HERE / DATA / "qwen15-generation.json").read_text(encoding="utf-8"))
    now, before = read["with a 1 that counts"], read["without a 1 that counts"]
    success = now["success"]
    ends = f"[{_shown(success['ci_low'])}, {_shown(success['ci_high'])}]"
    yield (
        f"- By generation Qwen2.5-Coder-1.5B makes {_shown(success['mean'])} {ends} of {now['games']} test tasks with one "
        "distractor (no frozen track). Many of its answers were like `1 noise + 1 clock`: "
        f"{before['invalid_actions']} answers were invalid and success was {_shown(before['success']['mean'])} "
        f"until the answer grammar read this 1 as a count; of the same answers, read again, {now['invalid_actions']} are."
    )
    track = "discover-500-lite"
    plain, look_ups = (
        _played(track, archive, 1)
        for archive in ("smollm2-probabilities", "smollm2-probabilities-look-ups")
    )
    chance, nearest = (
        f"{_submission(track, archive)['figures']['known']['100']:.1f}"
        for archive in ("random", "nearest-words")
    )
    yield (
        f"- In `{track}` SmolLM2-135M knows {plain} items after 100 attempts (random {chance}, nearest words "
        f"{nearest}), and {look_ups} with a look-up in each game."
    )
    real, made_up = "craft-8-lite", "craft-8-lite-made-up"
    texts = {
        name: [
            _success_of(where, archive)
            for where, archive in zip((real, made_up), archives, strict=True)
        ]
        for name, archives in {
            "nearest words": ("nearest-words", "nearest-words"),
            "votes": ("votes", "votes"),
            "scorer": ("scorer-minilm", "scorer-no-words"),
        }.items()
    }
    yield (
        "- Contamination: made-up words show how much is knowledge of words. On "
        f"`{real}` nearest words fall from {' to '.join(texts['nearest words'])}, a recipe scorer from "
        f"{' to '.join(texts['scorer'])}; votes of the train recipes make {' and '.join(texts['votes'])}."
    )


def _tuned(player: str, track: str) -> Row:
    (row,) = [
        row
        for row in _read(f"{DATA}/finetuned.json")[1:]
        if (row["player"], row["track"]) == (player, track)
    ]
    return row


def finetuned() -> Iterator[str]:
    """Yield what a language model makes that has read the recipes, beside two scorers."""
    (training, *_) = _read(f"{DATA}/finetuned.json")
    recipes, goals = (
        cell("finetuned", TUNED, f"`{track}`") for track in ("craft-8-lite", "goal-8-lite")
    )
    against = {
        name: " and ".join(
            cell("finetuned", name, f"difference, {kind}")
            for kind in ("unseen recipes", "unseen goals")
        )
        for name in ("ComplEx, u+v", "recipe scorer, MiniLM")
    }
    any_pair, complex_makes = (
        " and ".join(
            _shown(_tuned(player, track)["success"]) for track in ("craft-8-lite", "goal-8-lite")
        )
        for player in (ANY_PAIR, "ComplEx, u+v")
    )
    yield (
        f"**Answer.** More about unseen goals than ComplEx, not more than the recipe scorer: after "
        f"{training['cpu_seconds'] / 60:.0f} minutes of recipes as text, SmolLM2-135M makes {recipes} of the "
        f"goals with unseen recipes and {goals} with unseen goals; that is {against['ComplEx, u+v']} against "
        f"ComplEx, and {against['recipe scorer, MiniLM']} against the recipe scorer with MiniLM. Its pairs are of "
        f"different items; with an item and itself allowed, as ComplEx plays, it makes {any_pair}, and ComplEx "
        f"{complex_makes}."
    )


TRACKS = "craft-8-lite", "goal-8-lite", "craft-1-lite"


def _listed(parts: list[str]) -> str:
    """Return some parts as "one, two and three"."""
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def _on_tracks(player: str) -> str:
    return _listed([_shown(_tuned(player, track)["success"]) for track in TRACKS])


def _invalid_share(track: str, archive: str) -> str:
    """Return the share of a submission's answers that are invalid, for games of one attempt."""
    of = _submission(track, archive)
    valid = of["figures"]["games"] - of["lost_attempts"]
    return f"{100 * of['invalid_actions'] / (of['invalid_actions'] + valid):.0f} %"


def _gain(player: str, track: str) -> str:
    """Return what reinforcement adds to a model's success, with its interval."""
    gain, low, high = map(signed, _tuned(player, track)["gain_by_reinforcement"])
    return f"{gain} [{low}, {high}]"


def finetuned_caveats() -> Iterator[str]:
    """Yield the share of the question, the answers of games, and the first games."""
    rules = _success_of("craft-8-lite", "smollm2-probabilities")
    yield (
        f"- Much of the way is the question and the rule on pairs: the untuned model makes {_on_tracks(UNTUNED)} "
        f"by the same text, in the order of the table; by probabilities after the rules {rules} of `craft-8-lite`."
    )
    games_read = _submission(TRACKS[0], "smollm2-tuned-chats")["training_data"]
    (games,) = re.findall(r"(\d+) games", games_read)
    invalid = _listed([_invalid_share(track, "smollm2-tuned-chats") for track in TRACKS])
    before = _tuned("SmolLM2-135M, untuned, by generation", TRACKS[0])
    yield (
        f"- By generation it needs games, too: after {games} of them it makes {_on_tracks(GAMES)}, up from "
        f"{_shown(before['success'])}. Of its answers, {invalid} are invalid; "
        f"most of them name an item that is not on the table. Constrained to the table, the same weights make {_on_tracks(GAMES_CONSTRAINED)}."
    )
    reinforced, earlier = _read(f"{DATA}/reinforced.json")
    settings = reinforced["settings"]
    gains = [
        _listed([_gain(player, track) for track in TRACKS])
        for player in (REINFORCED, REINFORCED_CONSTRAINED)
    ]
    yield (
        f"- {settings['steps']} steps of GRPO on its own answers ({settings['answers']} to each of "
        f"{settings['groups']} games a step, {reinforced['cpu_seconds'] / 60:.0f} CPU minutes, one setting "
        f"tried) change success by {gains[0]} by generation; constrained, by {gains[1]}. Of "
        f"{reinforced['left_out']} games with left-out train recipes the first answer is right in "
        f"{_shown(reinforced['success_after'])}, {_shown(reinforced['success_before'])} before."
    )
    before_after = " and ".join(
        f"{_shown(rates['before'])} and {_shown(rates['after'])} of `{track}`"
        for track, rates in earlier["success"].items()
    )
    yield (
        "- An earlier fit on games, with another wording of the rules, made by generation, before and after GRPO, "
        f"{before_after}. It was replaced when the wording changed."
    )
    first = _on_tracks(ANY_PAIR)
    yield (
        "- The tracks were played twice. First all pairs were allowed, and most wrong answers combined an item "
        f"with itself: {first} in the order of the table. Left-out train recipes then chose the rule."
    )


ANSWERS: dict[str, Callable[[], Iterator[str]]] = {
    "baselines answer": baselines,
    "baselines caveats": baselines_caveats,
    "complex answer": small_books,
    "environments answer": environments,
    "links answer": links,
    "links caveats": links_caveats,
    "lists answer": lists,
    "recipe scorer answer": whole_recipes,
    "recipe scorer caveats": recipe_scorer_caveats,
    "large books answer": large_books,
    "new entities answer": new_entities,
    "untrained answer": untrained,
    "untrained caveats": untrained_caveats,
    "words answer": words,
    "discovery answer": discovery,
    "people without goal": people_without_goal,
    "worlds answer": worlds,
    "worlds caveats": worlds_caveats,
    "penalty answer": penalty,
    "people pairs answer": people_pairs,
    "intervals answer": intervals,
    "speed answer": speed,
    "probabilities answer": probabilities,
    "joint training answer": joint_training,
    "planning agents answer": without_search,
    "presets answer": presets,
    "plan weights answer": plan_weights,
    "language models": language_models,
    "language models answer": language_models_answer,
    "language models caveats": language_models_caveats,
    "finetuned answer": finetuned,
    "finetuned caveats": finetuned_caveats,
}
"""Answers, caveats and further tables by name."""
