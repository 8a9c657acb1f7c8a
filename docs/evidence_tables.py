"""Answers, tables and caveats of the evidence pages that follow from a JSON file of measurements.

A page marks the place: ``<!-- table: NAME -->`` ... ``<!-- end of table -->``, with a name of TABLES.
"""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from parts_tables import PARTS_TABLES

from wordcraft_kg.base.records import read_record
from wordcraft_kg.base.statistics import holm, split_interval, student_interval
from wordcraft_kg.base.wording import counted
from wordcraft_kg.studies.claims import signed
from wordcraft_kg.studies.results import StudyResults
from wordcraft_kg.studies.variants import VariantMetrics
from wordcraft_kg.studies.view import view_study

HERE = Path(__file__).parent
Row = dict[str, Any]
OUTSIDE = {
    "recipes alone": "recipes alone, no words",
    "and GloVe": "and GloVe",
    "and words": "and MiniLM",
    "language model": "and a language model",
    "WordNet": "and WordNet",
    "book": "and the other book",
    "Infinite Craft": "and Infinite Craft, links and pair encoder",
    "GloVe and book": "the other book, with GloVe instead of MiniLM",
    "all": "**all of them**",
    "zero-shot": "zero-shot: the other book alone",
    "zero-shot unshared": "zero-shot, without shared recipes",
    "zero-shot all": "zero-shot, with language model and WordNet",
    "control random weights": "control: language model with random weights",
    "control made-up": "control: language model reads made-up names",
    "control shuffled labels": "control: its tables under shuffled labels",
    "control shuffled words": "control: shuffled vectors",
}
"""Rows of outside-knowledge.json, and their names on the page."""
BY_GOAL = {
    "made 8": "8, goals that the other book makes",
    "other 8": "8, other goals",
}
PLAYERS = {
    "chance": "chance",
    "w": "w: the best pair for the goal",
    "planner, train recipes": "planner, train recipes only",
    "planner": "**planner**",
}
IN_AGENTS = {
    "agent, no graph": "no graph",
    "agent, u,v": "u, v",
    "agent, u,v,w": "u, v, w",
    "w, all tasks": "w alone",
    "agent, u,v,w,p": "u, v, w, p",
    "planner, all tasks": "planner",
}
BOOKS = {"little-alchemy-2": "Little Alchemy 2", "everyday": "`everyday`"}
SCRIPTED = {
    "random, exact (`benchmarks/untrained_players.py`)": ("untrained", "random"),
    "fewest uses in train recipes, whatever the goal": ("untrained", "fewest uses"),
    "nearest words (GloVe; on `everyday` MiniLM)": ("pack", "nearest words"),
    "partial KG as 0/1 facts, v": ("pack", "partial KG, v"),
    "partial KG as facts, u + v": ("pack", "partial KG, u+v"),
    "votes of the train recipes, best pair": ("pack", "partial KG, votes"),
    "full KG as facts, v": ("pack", "full KG, v"),
    "full KG as facts, u": ("pack", "full KG, u"),
    "full KG as facts, u + v, the paper's": ("pack", "full KG, u+v"),
    "the same without self edges": ("pack", "full KG, u+v, no self edges"),
    "the same, best pair": ("pack", "full KG, best pair"),
    "recipe oracle": ("pack", "recipe oracle"),
}
"""Rows of scripted players: where their figures are, and under which name."""
DISCOVERERS = {
    "random pairs": "random",
    "random, no repeats": "random-no-repeat",
    "greedy, knows the graph": "greedy",
    "empowerment, knows the graph": "empowerment",
}
BASES = {
    "everyday": ("air", "earth", "fire", "time", "water"),
    "little-alchemy-2": ("air", "earth", "fire", "water"),
}
"""Entities known at the start."""
DATA = "evidence/data"
TUNED = "SmolLM2-135M, fine-tuned on recipes, by recipes"
SILENT = "SmolLM2-135M, untuned, by generation"
TUNED_TRACKS = {"craft-8-lite": "unseen recipes", "goal-8-lite": "unseen goals"}
"""Tracks on which the fine-tuned language model is compared, and the heads of the differences."""
PACKS = HERE.parent / "wordcraft_kg" / "evaluation" / "references"
DEFAULT_PENALTY = 0.3
TEST_SPLITS = 5
"""Splits 0 to 4 are for tests; the penalty was chosen on others."""
FEW_SPLITS = 3
"""Splits up to which an interval is at least as wide as the noise of the tasks in one."""


@cache
def _read(name: str) -> list[Row]:
    return list(json.loads((HERE / name).read_text(encoding="utf-8")))


def _shown(value: float) -> str:
    return f"{value:.3f}".removeprefix("0")


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def outside(book: str, split: str, source: str = "outside-knowledge.json") -> Iterator[str]:
    """Yield the table of outside knowledge for a book and a split: means over splits."""
    rows: dict[str, list[Row]] = {}
    for row in _read(source):
        if (row["book"], row["split"]) == (book, split):
            rows.setdefault(row["row"], []).append(row)
    columns = {"mrr": f"{split}, MRR", "8": "8 distractors", "1": "1", "few 8": "few"}
    if any("made 8" in row for of in rows.values() for row in of):
        columns |= BY_GOAL
    yield f"| | {' | '.join(columns.values())} |"
    yield f"|---|{'---|' * len(columns)}"
    for name, title in OUTSIDE.items():
        if name not in rows:
            continue
        cells = []
        for column in columns:
            values = [row[column] for row in rows[name] if column in row]
            is_whole = len(values) == len(rows[name])
            text = _shown(_mean(values)) if is_whole else ""
            if column == "8":
                text += _interval(values, [row.get("tasks", 0) for row in rows[name]])
            cells.append(text)
        yield f"| {title} | {' | '.join(cells)} |"


def _interval(rates: Sequence[float], tasks: Sequence[int]) -> str:
    if len(rates) > FEW_SPLITS:
        found = student_interval(rates)
        assert found is not None
        low, high = found
    else:
        errors = [math.sqrt(rate * (1 - rate) / n) for rate, n in zip(rates, tasks, strict=True)]
        low, high = split_interval(rates, errors)
    return f" [{_shown(low)}, {_shown(high)}]"


def depths(source: str, book: str, split: str, players: Sequence[str]) -> Iterator[str]:
    """Yield the table of planners by depth with 4 distractors; the planner has an interval."""
    rows: dict[tuple[str, int], list[Row]] = {}
    for row in _read(source):
        at = row["book"], row["split"], row["distractors"], row["policy"]
        if at == (book, split, 4, "any") and row["seed"] < FEW_SPLITS:
            rows.setdefault((row["player"], row["depth"]), []).append(row)
    yield f"| {split} | depth 1 | 2 | 3 | 4 |"
    yield "|---|---|---|---|---|"
    for player in players:
        cells = []
        for depth in (1, 2, 3, 4):
            rates = [row["success"] for row in rows[player, depth]]
            text = _shown(_mean(rates))
            if player == "planner":
                ends = student_interval(rates)
                assert ends is not None
                text += f" [{_shown(ends[0])}, {_shown(ends[1])}]"
            cells.append(text)
        yield f"| {PLAYERS[player]} | {' | '.join(cells)} |"


def agents_by_depth() -> Iterator[str]:
    """Yield the table of agents with and without plans, on split 0."""
    rates = {
        tuple(row[key] for key in ("book", "depth", "split", "distractors", "player")): row[
            "success"
        ]
        for row in _read("planning-agents.json")
        if row["seed"] == 0
    }
    yield f"| book, depth, split | distractors | {' | '.join(IN_AGENTS.values())} |"
    yield f"|---|---|{'---|' * len(IN_AGENTS)}"
    for book, name in BOOKS.items():
        for depth in (1, 2):
            for split in ("by-recipe", "by-goal"):
                for amount in (0, 4, 8):
                    cells = [
                        _shown(rates[book, depth, split, amount, player]) for player in IN_AGENTS
                    ]
                    where = f"{name}, {depth}, {split}"
                    yield f"| {where} | {amount} | {' | '.join(cells)} |"


@cache
def _reference(book: str) -> list[Row]:
    """Return the published results of this package for a book."""
    pack = json.loads((PACKS / f"{book}.json").read_text(encoding="utf-8"))
    return list(pack["rows"])


def scripted() -> Iterator[str]:
    """Yield the table of scripted players, by the published results and untrained-players.json."""
    points = [(book, n) for book in ("little-alchemy-2", "everyday") for n in (8, 1)]
    rates: dict[tuple[str, str, str, int], float] = {}
    for book, number in points:
        for row in _read("untrained-players.json"):
            if (row["book"], row["split"], row["distractors"]) == (book, "by-recipe", number):
                rates["untrained", row["player"], book, number] = row["success"][0]
        for row in _reference(book):
            if row["measure"] == "success" and row["play"].get("depth") == 1:
                value = row["figures"][str(number)]["value"]
                # The name of the vectors stands in brackets.
                player = row["player"].partition(" (")[0]
                rates.setdefault(("pack", player, book, number), value)
    yield "| player | Little Alchemy 2, 8 distractors | Little Alchemy 2, 1 | `everyday`, 8 | `everyday`, 1 |"
    yield "|---|---|---|---|---|"
    for title, source in SCRIPTED.items():
        cells = [rates[*source, *point] for point in points]
        yield f"| {title} | {' | '.join('1' if cell == 1 else _shown(cell) for cell in cells)} |"


def discoverers() -> Iterator[str]:
    """Yield the table of entities that players know who choose at random or know the graph."""
    after = ("10", "50", "100")
    yield "| player | `everyday`: 10 / 50 / 100 | Little Alchemy 2 (base of four): 10 / 50 / 100 |"
    yield "|---|---|---|"
    for title, player in DISCOVERERS.items():
        cells = []
        for book, base in BASES.items():
            (row,) = [
                row
                for row in _reference(book)
                if row["player"] == player and tuple(row["play"].get("base", ())) == base
            ]
            cells.append(" / ".join(f"{row['figures'][n]['value']:.1f}" for n in after))
        yield f"| {title} | {' | '.join(cells)} |"


def penalty() -> Iterator[str]:
    """Yield the table of agents with the default penalty against their scorers."""
    yield from _against_scorers(_read("agents.json"))


def penalty_today() -> Iterator[str]:
    """Yield the same table with the scorer by neighbour lists and the recommended preset."""
    yield from _against_scorers(_read(f"{DATA}/agents-recommended.json"))


def _against_scorers(rows: Sequence[Row]) -> Iterator[str]:
    yield "| book, split | distractors | agent | gain | each split | lowest end | other decisions |"
    yield "|---|---|---|---|---|---|---|"
    for book, title in BOOKS.items():
        for split in ("by-goal", "by-slot", "by-recipe"):
            for number in (8, 1):
                at = book, split, number, DEFAULT_PENALTY
                runs = [
                    row
                    for row in rows
                    if (row["book"], row["split"], row["distractors"], row["scorer_cost"]) == at
                    and row["split_seed"] < TEST_SPLITS
                ]
                if runs:
                    where = f"{title}, {split.replace('-', ' ')} | {number}"
                    yield f"| {where} | {' | '.join(_gain_cells(runs))} |"


def _gain_cells(runs: Sequence[Row]) -> Iterator[str]:
    """Yield success, gain with its interval, and further cells of one row."""
    by_split: dict[int, list[Row]] = {}
    for row in runs:
        by_split.setdefault(row["split_seed"], []).append(row)
    of_splits = [by_split[seed] for seed in sorted(by_split)]
    gains = [_mean([row["gain"] for row in of]) for of in of_splits]
    # The half width of a run's 95 % interval is 1.96 standard errors.
    errors = [
        _mean([(row["interval"][1] - row["interval"][0]) / (2 * 1.96) for row in of])
        for of in of_splits
    ]
    low, high = split_interval(gains, errors, within=(-1, 1))
    gain = _signed(_mean(gains))
    is_certain = low > 0 or high < 0
    yield _shown(_mean([row["agent"] for row in runs]))
    yield f"{f'**{gain}**' if is_certain else gain} [{_plain(low)}, {_plain(high)}]"
    yield " ".join(map(_signed, gains))
    yield _signed(min(row["interval"][0] for row in runs))
    yield f"{_mean([row['differs'] for row in runs]):.2f}".removeprefix("0")


def new_entities() -> Iterator[str]:
    """Yield the table of links with entities that no recipe has: means over all queries."""
    columns = ("rankers", "kernel", "words of others", "frequency", "chance")
    yield "| book | question | queries | rankers | kernel alone | words of others | frequency | chance |"
    yield "|---|---|---|---|---|---|---|---|"
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in _read("evidence/data/new-entities.json"):
        groups.setdefault((row["book"], row["question"]), []).append(row)
    before = ""
    for (book, question), rows in groups.items():
        asked = sum(row["queries"] for row in rows)
        cells = [
            _shown(sum(row["queries"] * row[name] for row in rows) / asked) for name in columns
        ]
        if question in ("of it", "it"):
            each = " ".join(_shown(row["rankers"]) for row in rows)
            cells[0] = f"**{cells[0]}** ({each})"
        where = "" if book == before else BOOKS.get(book, f"`{book}`")
        before = book
        yield f"| {where} | {question} | {asked:,} | {' | '.join(cells)} |"


def _signed(value: float) -> str:
    """Return a difference with its sign; a zero has none."""
    text = signed(value)
    return ".000" if text in ("+.000", "-.000") else text


def _plain(value: float) -> str:
    return _signed(value).removeprefix("+")


def _by_split(name: str) -> tuple[dict[tuple[str, str], list[Row]], list[int]]:
    """Return a file's rows by split and book, and the seeds, which all of them have in this order."""
    rows: dict[tuple[str, str], list[Row]] = {}
    for row in _read(f"evidence/data/{name}"):
        rows.setdefault((row["split"], row["book"]), []).append(row)
    (seeds,) = {tuple(row["seed"] for row in each) for each in rows.values()}
    return rows, list(seeds)


def _with_ends(difference: Sequence[float]) -> str:
    """Return a difference with the ends of its interval."""
    gain, low, high = map(signed, difference)
    return f"{gain} [{low}, {high}]"


PLANNERS = {
    "any_form": "knows no form",
    "again": "searches again",
    "planner": "planner",
    "weights": "weights from play",
}
"""Planners of depth 2 and the keys of their success."""
PLANNER_GAINS = {
    "over_any_form": "planner minus *knows no form*",
    "over_again": "planner minus *searches again*",
    "weights_over_planner": "weights from play minus planner",
}
"""Paired differences of planners and their keys."""


def plan_weights() -> Iterator[str]:
    """Yield the table of planners at depth 2: means over splits, and each split's differences."""
    rows, seeds = _by_split("plan-weights.json")
    splits = " and ".join(map(str, seeds))
    gains = [f"{text}, splits {splits}" for text in PLANNER_GAINS.values()]
    yield f"| book, split | {' | '.join((*PLANNERS.values(), *gains))} | tasks |"
    yield f"|---|{'---|' * (len(PLANNERS) + len(gains) + 1)}"
    for (split, book), each in rows.items():
        cells = [_shown(_mean([row[key] for row in each])) for key in PLANNERS]
        for key in PLANNER_GAINS:
            cells.append(", ".join(_with_ends(row[key]) for row in each))
        title = f"{BOOKS[book]}, {split.replace('-', ' ')}"
        tasks = sum(row["tasks"] for row in each)
        yield f"| {title} | {' | '.join(cells)} | {tasks:,} |"


def attempts() -> Iterator[str]:
    """Yield the table of players with more attempts than the depth: solved within n of them."""
    rows = _read("evidence/data/attempts.json")
    numbers = list(rows[0]["within"])
    yield f"| player | {' | '.join(numbers)} |"
    yield f"|---|{'---|' * len(numbers)}"
    for row in rows:
        shares = " | ".join(map(_shown, row["within"].values()))
        low, high = map(_shown, row["interval"])
        yield f"| {row['player']} | {shares} [{low}, {high}] |"


def finetuned() -> Iterator[str]:
    """Yield the table of the fine-tuned language model beside other players, in falling order.

    The last two columns are its success minus that of the other player on the same tasks. Players
    that the leaderboard lacks are left out, and the untuned model by generation, which makes nothing.
    """
    _, *rows = _read("evidence/data/finetuned.json")
    tracks = list(dict.fromkeys(row["track"] for row in rows))
    cells: dict[str, Row] = {}
    for row in rows:
        if row["is_on_leaderboard"] and (row["success"] or row["player"] != SILENT):
            cells.setdefault(row["player"], {})[row["track"]] = row
    heads = [f"`{track}`" for track in tracks]
    heads += [f"difference, {name}" for name in TUNED_TRACKS.values()]
    yield f"| player | {' | '.join(heads)} |"
    yield f"|---|{'---|' * len(heads)}"
    missing = {"success": -1.0}
    for player in sorted(cells, key=lambda one: -cells[one].get(tracks[0], missing)["success"]):
        own = cells[player]
        shown = []
        for track in tracks:
            if track in own:
                low_high = ", ".join(map(_shown, own[track]["interval"]))
                shown.append(f"{_shown(own[track]['success'])} [{low_high}]")
            else:
                shown.append("")
        for track in TUNED_TRACKS:
            if track in own and player != TUNED:
                value, low, high = map(signed, own[track]["difference"])
                shown.append(f"{value} [{low}, {high}]")
            else:
                shown.append("")
        title = f"**{player}**" if player == TUNED else player
        yield f"| {title} | {' | '.join(shown)} |"


WORDS = {
    "with words": "recipe scorer alone, w",
    "without words": "graph without words, w",
    "words without graph": "words without graph, w",
}
"""Columns of the table on words, and their players in untrained-players.json."""


def words() -> Iterator[str]:
    """Yield the table of success with and without words, and of votes."""
    yield f"| Little Alchemy 2 | {' | '.join(WORDS)} | votes, best pair | votes, MRR of results |"
    yield f"|---|{'---|' * (len(WORDS) + 2)}"
    pairs = _rows("link-quality.json", book="little-alchemy-2", row="votes, best pair")
    best_pair = {"by-recipe": _shown(_mean([row["8"] for row in pairs]))}
    rows = {
        (row["split"], row["player"]): row
        for row in _read("untrained-players.json")
        if (row["book"], row["distractors"]) == ("little-alchemy-2", 8)
    }
    for split in ("by-recipe", "by-slot", "by-goal"):
        cells = []
        for player in WORDS.values():
            row = rows[split, player]
            cells.append(_shown(_mean(row["success"])) + _interval(row["success"], row["tasks"]))
        votes = [
            row["mrr"]
            for row in _read("link-quality.json")
            if (row["book"], row["split"], row["row"])
            == ("little-alchemy-2", split, "votes, results")
        ]
        assert len(votes) == FEW_SPLITS
        cells.append(best_pair.get(split, ""))
        yield f"| {split.replace('-', ' ')} | {' | '.join(cells)} | {_shown(_mean(votes))} |"


def small_books() -> Iterator[str]:
    """Yield the table of ComplEx and counting on small books: means over books."""
    yield (
        "| recipes, split | books | counting | fixed weight | chosen weights | fixed: below (worst) "
        "| chosen: below (worst) |"
    )
    yield "|---|---|---|---|---|---|---|"
    groups: dict[str, list[Row]] = {}
    stored = _read("evidence/data/small-books.json")
    for row in stored:
        size = row["book"].rpartition(" ")[2]
        groups.setdefault(f"{size}, {row['split'].replace('-', ' ')}", []).append(row)
    by_split = sorted(groups, key=lambda name: (name.endswith("goal"), int(name.split(",")[0])))
    for name, rows in [(name, groups[name]) for name in by_split] + [("all", stored)]:
        means = [
            _shown(_mean([row[key] for row in rows])) for key in ("frequency", "fixed", "chosen")
        ]
        below = []
        for key in ("fixed", "chosen"):
            differences = [row[key] - row["frequency"] for row in rows]
            below.append(f"{sum(d < 0 for d in differences)} ({_signed(min(differences))})")
        yield f"| {name} | {len(rows)} | {' | '.join((*means, *below))} |"


def lists() -> Iterator[str]:
    """Yield the table of the recipe scorer by neighbour lists and by tables of all pairs."""
    figures = {"MRR": "mrr", "8 distractors": "8", "1 distractor": "1"}
    heads = [f"{name}, {way}" for name in figures for way in ("lists", "tables")]
    yield f"| with GloVe vectors | {' | '.join(heads)} |"
    yield f"|---|{'---|' * len(heads)}"
    sources = ("evidence/data/lists.json", "outside-knowledge.json")
    for split in ("by-recipe", "by-goal"):
        cells = []
        for figure in figures.values():
            for source in sources:
                values = [
                    row[figure]
                    for row in _read(source)
                    if (row["book"], row["split"], row["row"])
                    == ("little-alchemy-2", split, "and GloVe")
                ]
                assert len(values) == FEW_SPLITS
                cells.append(_shown(_mean(values)))
        yield f"| Little Alchemy 2, {split.replace('-', ' ')} | {' | '.join(cells)} |"


EXPLORERS = {
    "`recipe-learner`": ("discovery-fits", "recipe-learner everyday"),
    "... with own parts, not the default": ("discovery-fits", "recipe-learner everyday, own parts"),
    "`nearest-words`": ("discovery-plain", "nearest-words"),
    "`random-no-repeat`": ("discovery-plain", "random-no-repeat"),
}
"""Rows of players without a goal: the file and the name of their curves."""
PUBLISHED = ("o1", "DeepSeek-R1", "GPT-4o")


def explorers() -> Iterator[str]:
    """Yield the table of entities that players of Little Alchemy 2 know after some attempts."""
    after = ("100", "200", "300", "400", "500")
    yield f"| player | {' | '.join(after)} |"
    yield f"|---|{'---|' * len(after)}"
    files = {
        name: json.loads((HERE / f"evidence/data/{name}.json").read_text(encoding="utf-8"))
        for name in ("discovery-fits", "discovery-plain")
    }
    for title, (file, player) in EXPLORERS.items():
        of_player = files[file]["players"][player]
        # A file of many fits keeps the curve beside other results.
        curve = of_player.get("curve", of_player)
        cells = []
        for n in after:
            text = f"{curve[n]['mean']:.1f}"
            if n in ("100", "500"):
                text += f" [{curve[n]['low']:.1f}, {curve[n]['high']:.1f}]"
            cells.append(text)
        yield f"| {title} | {' | '.join(cells)} |"
    people = files["discovery-plain"]["people"]
    cells = [f"{people[n]:.0f}" if n in people else "" for n in after]
    yield f"| people who are still playing | {' | '.join(cells)} |"
    literature = json.loads((PACKS / "literature.json").read_text(encoding="utf-8"))["rows"]
    for player in PUBLISHED:
        (row,) = [
            row
            for row in literature
            if (row["player"], row["measure"]) == (player, "entities known")
        ]
        cells = [f"{row['figures'][n]['value']}" if n in row["figures"] else "" for n in after]
        yield f"| {player} (published) | {' | '.join(cells)} |"


IN_WORLDS = {
    "`random-no-repeat`": ("random-no-repeat",),
    "`nearest-words`": ("nearest-words",),
    "`book-votes`": ("book-votes",),
    "`recipe-learner` without doubt": ("neither", ", no doubt"),
    "**`recipe-learner`**": ("doubt (the default)", "recipe-learner everyday"),
    "... with own parts, not the default": ("doubt and own parts", ", own parts"),
    "... from `everyday` and Little Alchemy 2 as one book": ("recipe-learner both",),
}
"""Rows of players in many worlds, and the ends of their names in discovery_worlds.json.

The second end is that of today's script, for families without the first. A family in which a player
did not play has empty cells.
"""
WORLDS = HERE.parent / "benchmarks" / "discovery_worlds.json"


def worlds() -> Iterator[str]:
    """Yield the table of players in many worlds: relative area, and entities after 500 attempts."""
    stored = json.loads(WORLDS.read_text(encoding="utf-8"))
    heads = []
    for name in stored:
        heads += [f"{name}: area", "known after 500"]
    yield f"| player | {' | '.join(heads)} |"
    yield f"|---|{'---|' * len(heads)}"
    for title, endings in IN_WORLDS.items():
        cells = []
        for of_family in stored.values():
            named = (
                row
                for ending in endings
                for name, row in of_family["players"].items()
                if name.endswith(ending)
            )
            row = next(named, None)
            if row is None:
                cells += ["", ""]
                continue
            area = row["area"]
            cells.append(f"{_shown(area['mean'])} [{_shown(area['low'])}, {_shown(area['high'])}]")
            cells.append(f"{row['known']['500']['mean']:.0f}")
        yield f"| {title} | {' | '.join(cells)} |"


def probabilities() -> Iterator[str]:
    """Yield the table of expected and observed true triples of the recipe scorer."""
    yield (
        "| relation | triples | expected | observed | log loss, base rate | log loss, fitted "
        "| expected calibration error |"
    )
    yield "|---|---|---|---|---|---|---|"
    for row in _read("evidence/data/probabilities.json"):
        name = row["relation"] + (", self pairs" if row["pairs"] == "itself" else "")
        losses = (f"{row[key] * 1000:.2f}" for key in ("base_log_loss", "log_loss"))
        counts = f"{row['triples']:,} | {row['expected']:,.0f} | {row['observed']:,}"
        yield f"| {name} | {counts} | {' | '.join(losses)} | {_shown_finely(row['ece'])} |"


def _shown_finely(value: float) -> str:
    return f"{value:.4f}".removeprefix("0")


def promised() -> Iterator[str]:
    """Yield the table of promised and observed probabilities of different pairs."""
    yield "| relation | triples | promised | observed |"
    yield "|---|---|---|---|"
    for row in _read("evidence/data/probabilities.json"):
        if row["pairs"] == "distinct":
            for bin_ in row["bins"]:
                ends = f"[{_shown_finely(bin_['low'])}, {_shown_finely(bin_['high'])}]"
                observed = f"{_shown_finely(bin_['observed'])} {ends}"
                promise = _shown_finely(bin_["probability"])
                yield f"| {row['relation']} | {bin_['triples']:,} | {promise} | {observed} |"


ENVIRONMENTS = {
    "one": "one environment",
    "plain 1024": "plain Python, 1,024 environments",
    "batched 128": "batched, 128",
    "batched 1024": "**batched, 1,024**",
    "batched 8192": "batched, 8,192",
    "depth 3, batched 1024": "batched, depth 3, 1,024",
}
"""Rows of environments.json, and their names on the page."""
TRAINERS = {
    "plain loop": "plain loop, no graph",
    "no graph": "our trainer, no graph",
    "u,v": "our trainer, scores of links",
    "u,v,w": "our trainer, scores of links and whole recipes",
}
"""Rows of speed.json, and their names on the page."""
STEPS = 3_000_000
"""Steps of an agent in the studies."""


def _rounded(value: float) -> str:
    """Return a speed with two digits that count: more are noise."""
    return f"{float(f'{value:.2g}'):,.0f}"


def environments() -> Iterator[str]:
    """Yield the table of environment speed, and how many times plain Python it is."""
    rows = {row["row"]: row["steps_per_cpu_second"] for row in _read(f"{DATA}/environments.json")}
    yield "| Little Alchemy 2, 8 distractors | steps per CPU second | times plain Python |"
    yield "|---|---|---|"
    for name, title in ENVIRONMENTS.items():
        times = rows[name] / rows["plain 1024"]
        yield f"| {title} | {_rounded(rows[name])} | {_rounded(times) if times >= 10 else f'{times:.1f}'} |"


def speed() -> Iterator[str]:
    """Yield the table of training speed, and CPU seconds for an agent of the studies."""
    rows = {row["row"]: row["steps_per_cpu_second"] for row in _read(f"{DATA}/speed.json")}
    yield "| Little Alchemy 2, 8 distractors | steps per CPU second | CPU seconds for 3,000,000 steps |"
    yield "|---|---|---|"
    for name, title in TRAINERS.items():
        yield f"| {title} | {_rounded(rows[name])} | {_rounded(STEPS / rows[name])} |"


def people_pairs() -> Iterator[str]:
    """Yield the table of people and a recipe scorer that judge pairs, with intervals."""
    yield "| | is it a recipe (AUC) | which of four results |"
    yield "|---|---|---|"
    titles = {"glove": "**recipe scorer**, GloVe", "one person": "one person"}
    for row in _read(f"{DATA}/people-pairs.json"):
        cells = []
        for key in ("auc", "right"):
            value, low, high = (f"{each:.3f}" for each in row[key])
            cells.append(f"{value} [{low}, {high}]".replace("0.", "."))
        yield f"| {titles[row['row']]} | {' | '.join(cells)} |"
    yield "| chance | .500 | .250 |"


def joint_training() -> Iterator[str]:
    """Yield the table of ComplEx without and with WordNet's triples, by split."""
    rows = {
        (row["weight"], row["split"]): row["mrr"] for row in _read(f"{DATA}/joint-training.json")
    }
    splits = ("by-recipe", "by-goal")
    yield f"| WordNet's triples | {' | '.join(split.replace('-', ' ') for split in splits)} |"
    yield "|---|---|---|"
    for weight in sorted({weight for weight, _ in rows}):
        title = f"weight {weight:g}" if weight else "none"
        yield f"| {title} | {' | '.join(_shown(rows[weight, split]) for split in splits)} |"


LINK_ROWS = {
    "recipe kernel, no training": ("recipe kernel", "mrr"),
    "recipe kernel without word vectors": ("recipe kernel without words", "mrr"),
    "ComplEx": ("ComplEx", "mrr"),
    "ComplEx, without near-synonyms of train recipes": ("ComplEx", "no_near_synonym"),
    "neighbour rule, no training": ("neighbour rule", "mrr"),
    "neighbour rule, without near-synonyms": ("neighbour rule", "no_near_synonym"),
    "votes, no training": ("votes", "mrr"),
    "frequency in train": ("frequency", "mrr"),
    "facts: the train triples (0/1)": ("facts", "mrr"),
}
"""Rows of the table of links: row and metric in link-quality.json."""


def links() -> Iterator[str]:
    """Yield the table of scorers on links: means over splits, and each split."""
    yield f"| | {' | '.join(BOOKS[book] for book in ('everyday', 'little-alchemy-2'))} |"
    yield "|---|---|---|"
    for title, (name, metric) in LINK_ROWS.items():
        cells = []
        for book in ("everyday", "little-alchemy-2"):
            each = [
                row[metric]
                for row in _read("link-quality.json")
                if (row["book"], row["row"]) == (book, name)
            ]
            is_best = name == "recipe kernel"
            mean = f"**{_shown(_mean(each))}**" if is_best else _shown(_mean(each))
            cells.append(f"{mean} ({' '.join(map(_shown, each))})")
        yield f"| {title} | {' | '.join(cells)} |"


BY_LINKS = {
    "u and v alone: first by v, then by u + v, self edges dropped": "u and v, self edges dropped",
    "u and v alone, self edges as observed in train": "u and v, self edges observed",
    "recipe kernel": "recipe kernel",
    "ComplEx": "ComplEx",
    "votes, best pair": "votes, best pair",
    "full graph as facts, best pair": "full graph as facts, best pair",
}
"""Rows of the table of whole recipes that link-quality.json has."""


def whole_recipes() -> Iterator[str]:
    """Yield the table of the recipe scorer and of link scores: means over splits, and each split."""
    book = "little-alchemy-2"
    yield "| Little Alchemy 2, splits 0, 1 and 2 | MRR | 8 distractors | 1 distractor |"
    yield "|---|---|---|---|"
    own: dict[int, Row] = {
        row["distractors"]: row
        for row in _read("untrained-players.json")
        if (row["book"], row["split"], row["player"])
        == (book, "by-recipe", "recipe scorer alone, w")
    }
    cells = [
        f"**{_shown(_mean(each))}** ({' '.join(map(_shown, each))})"
        for each in (own[8]["mrr"], own[8]["success"], own[1]["success"])
    ]
    yield f"| **recipe scorer**: links, and the best pair by w | {' | '.join(cells)} |"
    for title, name in BY_LINKS.items():
        rows = [
            row for row in _read("link-quality.json") if (row["book"], row["row"]) == (book, name)
        ]
        cells = [
            _shown(_mean([row[metric] for row in rows])) if metric in rows[0] else ""
            for metric in ("mrr", "8", "1")
        ]
        yield f"| {title} | {' | '.join(cells)} |"


TRAINER_STUDY = "presets.json"
"""Results of benchmarks/presets.toml: agents at depth 2 on the book kitchen, without plans."""
KITCHEN_PLAYERS = "kitchen-players.json"
"""What `evaluate-agent --json` prints for the same tasks and scorer."""


@cache
def _trained() -> tuple[VariantMetrics, ...]:
    results = read_record(HERE / DATA / TRAINER_STUDY, StudyResults)
    return view_study(results).points[0].variants


def presets() -> Iterator[str]:
    """Yield the table of the trainer's settings, with each training."""
    yield "| trainer | success | each training | difference to the paper's |"
    yield "|---|---|---|---|"
    for entry in _trained():
        low, high = map(_shown, entry.interval)
        each = " ".join(_shown(rate) for rate in entry.success)
        difference = ""
        if (compared := entry.comparison) is not None:
            ends = ", ".join(map(signed, compared.interval))
            difference = f"{signed(compared.difference)} [{ends}]"
        title = "**recommended**" if entry.variant == "recommended" else entry.variant
        yield f"| {title} | {_shown(entry.mean)} [{low}, {high}] | {each} | {difference} |"
    rows = _read("evidence/data/maskable-ppo.json")
    titles = {"ours": "recommended, another script", "ppo": "MaskablePPO (sb3-contrib), tuned"}
    for trainer, title in titles.items():
        rates = [row["success"] for row in rows if row["trainer"] == trainer]
        interval = student_interval(rates)
        assert interval is not None
        low, high = map(_shown, interval)
        each = " ".join(map(_shown, rates))
        yield f"| {title} | {_shown(_mean(rates))} [{low}, {high}] | {each} | |"


def without_search() -> Iterator[str]:
    """Yield the table of agents without plans, beside players that learn nothing from play."""
    players = json.loads((HERE / DATA / KITCHEN_PLAYERS).read_text(encoding="utf-8"))["rows"]
    yield "| kitchen, by recipe | success |"
    yield "|---|---|"
    for entry in _trained():
        if entry.variant in ("paper", "recommended"):
            low, high = map(_shown, entry.interval)
            preset = "the paper's" if entry.variant == "paper" else "the recommended"
            success = f"{_shown(entry.mean)} [{low}, {high}]"
            yield f"| agent with u, v, w, {preset} preset | {success} |"
    for row in players:
        name = row["player"].partition(", ")[2]
        if not row["player"].startswith(("partial", "full")) and name in (
            "planner",
            "w, best pair",
        ):
            title = "**planner**" if name == "planner" else "the best pair for the goal"
            interval = f"[{_shown(row['low'])}, {_shown(row['high'])}]"
            yield f"| {title}, nothing learned from play | {_shown(row['success'])} {interval} |"


def deep_agents() -> Iterator[str]:
    """Yield the table of agents without plans on the two large books."""
    yield "| book, split | agent with u, v, w | each training | the best pair for the goal |"
    yield "|---|---|---|---|"
    for path in sorted((HERE / DATA).glob("depth-2-agents-*.json")):
        view = json.loads(path.read_text(encoding="utf-8"))
        book, _, split = path.stem.removeprefix("depth-2-agents-").rpartition("-")
        title = {"everyday": "`everyday`", "little-alchemy-2": "Little Alchemy 2"}[book]
        (agent,) = view["agents"].values()
        success = agent["success"]["4"]
        low, high = map(_shown, success["task_ci"])
        each = " ".join(map(_shown, success["seeds"]))
        (alone,) = (
            row["success"]["4"]
            for row in view["baselines"]
            if row["name"].endswith("alone, recipe (w)")
        )
        cells = f"{_shown(success['mean'])} [{low}, {high}] | {each} | {_shown(alone)}"
        yield f"| {title}, {split} | {cells} |"


HALF_WIDTH = 1.96
"""Standard errors from the middle to an end of a 95 % interval."""


def outside_agents() -> Iterator[str]:
    """Yield the table of agents with outside knowledge beside their scorers, means over splits."""
    columns = "agent, 8 distractors | scorer | difference | other | agent, 1 | scorer | difference | other"
    yield f"| scorer | split | {columns} |"
    yield f"|---|---|{'---|' * 8}"
    groups: dict[tuple[str, str], dict[int, list[Row]]] = {}
    for row in _read("outside-knowledge-agents.json"):
        group = groups.setdefault((row["scorer"], row["split"]), {})
        group.setdefault(row["distractors"], []).append(row)
    for (scorer, split), by_distractors in groups.items():
        cells = []
        for rows in by_distractors.values():
            errors = [(row["gain_ci"][1] - row["gain_ci"][0]) / 2 / HALF_WIDTH for row in rows]
            low, high = split_interval([row["gain"] for row in rows], errors, within=(-1, 1))
            agent, alone, gain, other = (
                _mean([row[name] for row in rows])
                for name in ("agent", "scorer_alone", "gain", "differs")
            )
            cells += [
                *(_shown(agent), _shown(alone), f"{signed(gain)} [{signed(low)}, {signed(high)}]"),
                f"{other:.2f}".removeprefix("0"),
            ]
        title = "**all of them**" if scorer == "all of them" else scorer
        yield f"| {title} | {split} | {' | '.join(cells)} |"


LARGE = {
    "recipe oracle": "knows all recipes",
    "planner": "**recipe scorer, planner**",
    "w, best pair": "recipe scorer, best pair (w)",
    "u+v, self edges dropped": "recipe scorer, links alone (u, v)",
    "partial KG, votes": "votes of the train recipes",
    "partial KG, planner": "planner, train recipes only",
    "nearest words": "nearest words",
    "random": "chance",
}
"""Players of the tables on Infinite Craft, by their names in the output of `evaluate-agent`, without
the name of the scorer's folder."""


def large_book(files: str, depths: Sequence[int]) -> Iterator[str]:
    """Yield a table of players on Infinite Craft, by depth and distractors.

    Args:
        files: beginning of the names of the files with the results of each depth.
        depths: the depths.
    """
    columns: dict[str, dict[str, Row]] = {}
    for depth in depths:
        path = HERE / DATA / f"{files}-depth-{depth}.json"
        view = json.loads(path.read_text(encoding="utf-8"))
        for row in view["rows"]:
            title = f"depth {depth}, {counted(row['distractors'], 'distractor')}"
            # The folder of the model by goal is ic-goals.
            name = row["player"].removeprefix("ic, ").removeprefix("ic-goals, ")
            columns.setdefault(title, {})[name] = row
    yield f"| player | {' | '.join(columns)} |"
    yield f"|---|{'---|' * len(columns)}"
    for name, title in LARGE.items():
        cells = []
        for of_players in columns.values():
            row = of_players[name]
            low, high = _shown(row["low"]), _shown(row["high"])
            cells.append(f"{_shown(row['success'])} [{low}, {high}]")
        yield f"| {title} | {' | '.join(cells)} |"


def large_book_results() -> Iterator[str]:
    """Yield the caveat about results of unseen pairs of Infinite Craft."""
    recipes, goals = (
        json.loads((HERE / DATA / f"{files}-results.json").read_text(encoding="utf-8"))
        for files in ("large-book", "large-book-goals")
    )
    times = [recipes[f"milliseconds {how}"] for how in ("in a batch", "alone")]
    yield (
        f"- The true result of an unseen pair among all entities has MRR {_shown(recipes['mrr'])}; it "
        f"is the first of {_shown(recipes['first 1'])} of {recipes['pairs']:,} pairs, and among the "
        f"first 32 of {_shown(recipes['first 32'])}. That takes {times[0]:.0f} CPU milliseconds a "
        f"pair in a batch and {times[1]:.0f} alone, on a busy machine. With unseen goals, which no "
        f"neighbouring pair makes, it is hardly ever proposed: MRR {_shown(goals['mrr'])}."
    )


def _rows(name: str, **values: object) -> list[Row]:
    """Return the rows of a file that have these values."""
    return [row for row in _read(name) if all(row[key] == value for key, value in values.items())]


def _success(row: Row, name: str = "success") -> float:
    """Return a share of tasks as it was before it was rounded to four digits."""
    return float(round(row[name] * row["tasks"]) / row["tasks"])


def _planner(**values: object) -> list[Row]:
    """Return the rows of the planner on Little Alchemy 2, by split seed."""
    where = {"book": "little-alchemy-2", "player": "planner", "policy": "any"} | values
    return sorted(_rows("planning.json", **where), key=lambda row: int(row["seed"]))


def _by_unseen(split: str, unseen: int) -> tuple[float, int]:
    """Return the planner's success on depth-2 tasks by unseen recipes of the best plan."""
    each = [row["unseen"][str(unseen)] for row in _planner(split=split, depth=2, distractors=4)]
    tasks = sum(number for _, number in each)
    return sum(rate * number for rate, number in each) / tasks, tasks


def planning_answer() -> Iterator[str]:
    """Yield the planner's success at depth 2 beside that of the best pair for the goal."""
    planned, pairs = [], []
    for split in ("by-recipe", "by-goal"):
        values = {"split": split, "depth": 2, "distractors": 4}
        rates = [row["success"] for row in _planner(**values)]
        interval = student_interval(rates)
        assert interval is not None
        low, high = map(_shown, interval)
        planned.append(f"{_shown(_mean(rates))} [{low}, {high}]")
        pairs.append(_shown(_mean([row["success"] for row in _planner(player="w", **values)])))
    yield (
        f"**Answer.** At depth 2, most goals with unseen recipes and fewer with unseen goals: the planner "
        f"makes {planned[0]} and {planned[1]}, where the best pair for the goal makes {pairs[0]} and {pairs[1]} "
        "(Little Alchemy 2, 4 distractors, knowledge from outside)."
    )


def _least_and_most_tasks(source: str, book: str) -> str:
    """Return the least and the greatest number of tasks of a split in a table by depth."""
    tasks = [
        row["tasks"]
        for row in _rows(source, book=book, player="planner", distractors=4, policy="any")
        if row["seed"] < FEW_SPLITS and row["split"] in ("by-recipe", "by-goal")
    ]
    return f"{min(tasks)} to {max(tasks)}"


def planning_everyday() -> Iterator[str]:
    """Yield the heading of the tables of `everyday`."""
    tasks = _least_and_most_tasks("planning-agents.json", "everyday")
    yield f"`everyday` with GloVe, {tasks} test tasks in each split (0, 1 and 2):"


def planning_today() -> Iterator[str]:
    """Yield the caveat about today's planner, by lists."""
    texts = []
    for book, name in BOOKS.items():
        recipes, goals = (
            _shown(
                _mean(
                    [
                        row["planner"]
                        for row in _rows("evidence/data/plan-weights.json", book=book, split=split)
                    ]
                )
            )
            for split in ("by-recipe", "by-goal")
        )
        texts.append(f"{recipes} and {goals} on {name}")
    yield (
        "- Scorer and planner by tables, with outside knowledge. Today's, by lists and without it, make "
        f"{' and '.join(texts)} at depth 2, by recipe and by goal ([plan weights](plan-weights.md))."
    )


def planning_caveats() -> Iterator[str]:
    """Yield the planner's caveats, with depth 1, unseen recipes, shortcuts and distractors."""
    yield from planning_today()
    yield (
        f"- Each split has {_least_and_most_tasks('planning.json', 'little-alchemy-2')} tasks of each "
        "depth."
    )
    below = {}
    for split in ("by-recipe", "by-goal"):
        values = {"split": split, "depth": 1, "distractors": 4}
        planner, pair = (
            _mean([row["success"] for row in _planner(player=player, **values)])
            for player in ("planner", "w")
        )
        below[split] = _signed(planner - pair)
    yield (
        f"- At depth 1 the planner's difference to the best pair is {below['by-recipe']} by recipe and "
        f"{below['by-goal']} by goal: its probabilities assume that known goals have no unseen recipes."
    )
    (one, of_one), (two, of_two) = (_by_unseen("by-recipe", number) for number in (1, 2))
    goal, of_goal = _by_unseen("by-goal", 2)
    yield (
        f"- By recipe {_shown(one)} and {_shown(two)} of the depth-2 goals are made whose best plan has "
        f"one and two unseen recipes ({of_one:,} and {of_two:,} tasks); by goal, two unseen recipes "
        f"are hardly ever found ({_shown(goal)} of {of_goal:,})."
    )
    first = {"split": "by-recipe", "depth": 2, "distractors": 4, "seed": 0}
    (row,) = _planner(**first)
    (guarded,) = _planner(**first | {"policy": "no_train_shortcut"})
    yield (
        f"- Shortcuts explain little: {_shown(_success(row, 'by_plan'))} of {_shown(_success(row))} on "
        "split 0 are by the task's own plan; where no distractor opens a way by train recipes, the "
        f"planner makes {_shown(_success(guarded))}."
    )
    means = []
    for split in ("by-recipe", "by-goal"):
        none, many = (
            _shown(_mean([_success(row) for row in _planner(split=split, depth=2, distractors=n)]))
            for n in (0, 8)
        )
        means.append(f"{none} and {many} {split.replace('-', ' ')}")
    yield f"- With 0 and 8 distractors: {', '.join(means)}."
    times = []
    for depth in (2, 3):
        values = {"book": "little-alchemy-2", "split": "by-recipe", "distractors": 4}
        rows = _rows("planning-agents.json", player="planner", depth=depth, **values)
        times.append(f"{_mean([row['ms'] for row in rows]):.1f}")
    yield (
        f"- By tables, with GloVe, a decision takes {times[0].removeprefix('0')} ms of CPU time at "
        f"depth 2, and {times[1]} ms at depth 3."
    )


def planning_splits() -> Iterator[str]:
    """Yield the planner's success on single splits, and with fewer or more candidates."""
    values = {"player": "planner", "distractors": 4}
    of_everyday = _rows("planning.json", book="everyday", split="by-recipe", seed=0, **values)
    rates = [_shown(row["success"]) for row in sorted(of_everyday, key=lambda row: row["depth"])]
    depths = f"{', '.join(rates[:-1])} and {rates[-1]} at depth 1 to 4"
    of_splits = []
    for split in ("by-recipe", "by-goal", "by-slot"):
        by_depth = []
        for depth in (2, 3):
            rows = _rows(
                "planning-agents.json", book="little-alchemy-2", split=split, depth=depth, **values
            )
            each = ", ".join(_shown(row["success"]) for row in sorted(rows, key=_seed))
            by_depth.append(f"{each} at depth {depth}" if split == "by-recipe" else each)
        of_splits.append(f"{' and '.join(by_depth)} {split.replace('-', ' ')}")
    yield (
        f"`everyday`, split 0 by recipe, all sources: {depths}. Little Alchemy 2 with GloVe, splits 0, 1 "
        f"and 2: {'; '.join(of_splits)}."
    )
    widths = (8, 16, 32, 64, 128)
    found = []
    for width in widths:
        (row,) = _planner(
            player=f"planner, {width} candidates", split="by-recipe", depth=2, distractors=4, seed=0
        )
        found.append(_shown(_success(row)))
    yield ""
    yield (
        f"With earlier candidates, {', '.join(map(str, widths[:-1]))} and {widths[-1]} of them gave "
        f"{', '.join(found[:-1])} and {found[-1]} at depth 2."
    )


def _seed(row: Row) -> int:
    return int(row["seed"])


def agents_with_plans() -> Iterator[str]:
    """Yield the differences of agents with plans to the planner, at depth 2 on split 0."""
    rates = {
        (row["book"], row["split"], row["distractors"], row["player"]): row["success"]
        for row in _rows("planning-agents.json", depth=2, seed=0)
    }
    differences = [
        rate - rates[(*at, "planner, all tasks")]
        for (*at, player), rate in rates.items()
        if player == "agent, u,v,w,p"
    ]
    far = sum(difference < -0.01 for difference in differences)
    yield (
        f"At depth 2, agents with p differ from the planner by {signed(min(differences))} to "
        f"{signed(max(differences))}; in {far} of {len(differences)} cells they are more than .01 below."
    )


ALPHA = 0.05
"""Level of significance."""


def acting_answer() -> Iterator[str]:
    """Yield whether agents with default settings differ from their own scorers or planners."""
    rows = _read("agents-against-scorers.json")
    corrected = holm([row["p"] for row in rows])
    by_depth: dict[int, list[tuple[Row, bool]]] = {1: [], 2: []}
    for row, p_value in zip(rows, corrected, strict=True):
        if not row["variant"].endswith("no penalty"):
            by_depth[row["depth"]].append((row, p_value < ALPHA))

    def ends(depth: int) -> str:
        values = [row["difference"] for row, _ in by_depth[depth]]
        return f"{signed(min(values))} to {signed(max(values))}"

    def significant(depth: int) -> str:
        texts = []
        for row, is_significant in by_depth[depth]:
            if is_significant:
                low, high = signed(row["low"]), signed(row["high"])
                texts.append(f"{signed(row['difference'])} [{low}, {high}]")
        return ", ".join([f"{len(texts) or 'none'} of {len(by_depth[depth])}", *texts])

    yield (
        f"**Answer.** Hardly, so far: with the default penalty an agent's difference to its own scorer is "
        f"{ends(1)} at depth 1 (significant at {100 * ALPHA:.0f} % after correction: {significant(1)}). At "
        f"depth 2 it is {ends(2)} against the planner (significant: {significant(2)}). These agents have "
        "the paper's preset."
    )


def acting_caveats() -> Iterator[str]:
    """Yield the caveats of agents against scorers: no penalty, and scores of links alone."""
    differences = [
        row["difference"]
        for row in _read("agents-against-scorers.json")
        if row["variant"].endswith("no penalty")
    ]
    below = [-difference for difference in differences if difference < 0]
    yield (
        f"- Without the penalty agents fall below their scorers in {len(below)} of {len(differences)} "
        f"rows, by {_shown(min(below))} to {_shown(max(below))} ([the penalty](penalty.md))."
    )
    where = {"split": "by-recipe", "distractors": 8}
    (alone,) = _rows(
        "untrained-players.json",
        book="little-alchemy-2",
        player="recipe scorer alone, u v",
        **where,
    )
    (agent,) = _rows(
        "partial-graph.json", book="alchemy2", variant="recipes, u v", steps=1_000_000, **where
    )
    yield (
        f"- Learning adds to scores of links: u and v of the recipe scorer make "
        f"{_shown(_mean(alone['success']))} alone, and {_shown(agent['success'])} with an agent (Little "
        "Alchemy 2, 8 distractors, a million steps; [partial graphs](../partial-graph.md))."
    )


def over_splits(differences: Sequence[float]) -> str:
    """Return the mean of paired differences, with Student's interval over splits."""
    interval = student_interval(differences, within=(-1, 1))
    assert interval is not None
    low, high = map(_plain, interval)
    return f"{_plain(_mean(differences))} [{low}, {high}]"


def _gain(book: str, split: str) -> str:
    """Return what all sources add to recipes and GloVe, with Student's interval over splits."""
    by_row = [
        sorted(_rows("outside-knowledge.json", book=book, split=split, row=name), key=_seed)
        for name in ("all", "and GloVe")
    ]
    return over_splits([after["8"] - alone["8"] for after, alone in zip(*by_row, strict=True)])


def outside_answer() -> Iterator[str]:
    """Yield what all sources add to recipes and GloVe, on three kinds of splits."""
    book = "little-alchemy-2"

    def from_to(split: str, column: str = "8", of_before: str = "") -> str:
        before, after = (
            _shown(
                _mean(
                    [
                        row[column]
                        for row in _rows("outside-knowledge.json", book=book, split=split, row=name)
                    ]
                )
            )
            for name in ("and GloVe", "all")
        )
        return f"from {before}{of_before} to {after}"

    yield (
        "**Answer.** Most of it, but not GloVe next to MiniLM, and above all where no train recipe makes the "
        "goal: all sources raise success "
        f"with unseen goals {from_to('by-goal', of_before=' (recipes and GloVe)')}, a gain of "
        f"{_gain(book, 'by-goal')} over three splits: {from_to('by-goal', 'made 8')} on goals that "
        f"`everyday` makes, and {from_to('by-goal', 'other 8')} on all other goals; with unseen slots "
        f"{from_to('by-slot')}, and with unseen recipes {from_to('by-recipe')}, a gain of "
        f"{_gain(book, 'by-recipe')} (Little Alchemy 2, 8 distractors)."
    )


def _share_made(book: str) -> str:
    """Return the share of by-goal tasks whose goal the other book makes, as a mean over splits."""
    shares = {
        row["seed"]: row["share made"]
        for row in _rows("outside-knowledge.json", book=book, split="by-goal")
        if "share made" in row
    }
    return f"{100 * _mean([*shares.values()]):.0f} %"


def outside_made() -> Iterator[str]:
    """Yield the shares of tasks whose goals the other books make."""
    yield (
        f"- `everyday` makes the goal of {_share_made('little-alchemy-2')} of the tasks of Little Alchemy 2 "
        f"by goal, and Little Alchemy 2 of {_share_made('everyday')} of those of `everyday`."
    )


def outside_small() -> Iterator[str]:
    """Yield the heading of the table of a small book, with its gain."""
    splits = {row["seed"] for row in _rows("outside-knowledge.json", book="my-book")}
    yield (
        f"`examples/my-book.csv`, {len(splits)} splits [Student's t over splits]; the gain with unseen "
        f"recipes is {_gain('my-book', 'by-recipe')}:"
    )


def outside_caveats() -> Iterator[str]:
    """Yield which source adds most on goals that the other book makes, and what agents make."""
    of_goals = {"book": "little-alchemy-2", "split": "by-goal"}

    def added(source: str, column: str) -> str:
        with_source, without = (
            _mean([row[column] for row in _rows("outside-knowledge.json", row=name, **of_goals)])
            for name in (source, "and words")
        )
        return _shown(with_source - without)

    yield (
        f"- Next to MiniLM, another book adds {added('book', 'made 8')} on the goals that it makes and "
        f"{added('book', 'other 8')} on others, where the language model "
        f"({added('language model', 'other 8')}) and WordNet ({added('WordNet', 'other 8')}) add more. "
        "Single tasks of these rows are not stored, so these differences have no interval."
    )
    with_all, without = (
        _mean(
            [
                row["agent"]
                for row in _rows(
                    "outside-knowledge-agents.json", scorer=scorer, split="by-goal", distractors=8
                )
            ]
        )
        for scorer in ("all of them", "recipes and GloVe")
    )
    yield (
        f"- Agents get it all: {_shown(with_all)} instead of {_shown(without)} with unseen goals, "
        "without significant difference to their scorers (last folded table)."
    )


TABLES: dict[str, Callable[[], Iterator[str]]] = {
    **{
        f"outside {book} {split}": partial(outside, book, split)
        for book, splits in {
            "little-alchemy-2": ("by-recipe", "by-goal", "by-slot"),
            "everyday": ("by-recipe", "by-goal"),
            "my-book": ("by-recipe",),
        }.items()
        for split in splits
    },
    **{
        f"outside infinite-craft {book} {split}": partial(
            outside, book, split, "evidence/data/outside-infinite-craft.json"
        )
        for book in BOOKS
        for split in ("by-recipe", "by-goal")
    },
    "finetuned": finetuned,
    "plan weights": plan_weights,
    "attempts": attempts,
    **{
        f"planning {split}": partial(
            depths, "planning.json", "little-alchemy-2", split, tuple(PLAYERS)
        )
        for split in ("by-recipe", "by-goal")
    },
    **{
        f"planning everyday {split}": partial(
            depths, "planning-agents.json", "everyday", split, tuple(PLAYERS)[1:]
        )
        for split in ("by-recipe", "by-goal")
    },
    "planning answer": planning_answer,
    "planning caveats": planning_caveats,
    "planning everyday": planning_everyday,
    "planning splits": planning_splits,
    "planning agents": agents_by_depth,
    "agents with plans": agents_with_plans,
    "acting answer": acting_answer,
    "acting caveats": acting_caveats,
    "outside answer": outside_answer,
    "outside made": outside_made,
    "outside small": outside_small,
    "outside caveats": outside_caveats,
    "scripted players": scripted,
    "discoverers": discoverers,
    "penalty": penalty,
    "penalty today": penalty_today,
    "new entities": new_entities,
    "words": words,
    "small books": small_books,
    "lists": lists,
    "explorers": explorers,
    "worlds": worlds,
    "probabilities": probabilities,
    "promised": promised,
    "large book": partial(large_book, "large-book", (1, 2)),
    "large book results": large_book_results,
    "large book by goal": partial(large_book, "large-book-goals", (1, 2)),
    "links": links,
    "outside agents": outside_agents,
    "presets": presets,
    "without search": without_search,
    "deep agents": deep_agents,
    "whole recipes": whole_recipes,
    "environments": environments,
    "speed": speed,
    "people pairs": people_pairs,
    "joint training": joint_training,
    **PARTS_TABLES,
}
"""The tables by name."""
