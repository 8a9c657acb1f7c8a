"""Figures printed in README and guides have a stored source, and equal it."""

import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
CLOSE = 0.0005 + 0.0001
"""Half a unit of the last printed digit, and the rounding of the stored figures to four digits."""
NUMBER = r"(?<![\d.])[-+]?(?:\d*\.\d+|\d+)"


def stored(name):
    return json.loads((DOCS / name).read_text(encoding="utf-8"))


def tables(name):
    """Return a page's tables: for each its heading and the text cells of its rows."""
    found, rows = [], []
    for line in [*(DOCS / name).read_text(encoding="utf-8").splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif rows:
            found.append((rows[0], rows[2:]))
            rows = []
    return found


def table(name, *heads):
    """Return the rows of the page's only table whose heading has these cells."""
    (rows,) = [rows for head, rows in tables(name) if set(heads) <= {*head}]
    return rows


def number(cell):
    """Return the first number of a cell, such as `.836` of `**.836** [.802, .870]`."""
    return float(re.search(NUMBER, cell)[0])


def test_a_printed_figure_is_read_as_a_number():
    assert number("**.836** [.802, .870]") == 0.836
    assert number("1") == 1.0
    assert number("-.017 [x]") == -0.017
    head, rows = tables("evidence/planning.md")[0]
    assert head == ["by-recipe", "depth 1", "2", "3", "4"]
    assert rows[0][0] == "chance"


PLAYERS = {
    "no graph": "agent, no graph",
    "u, v": "agent, u,v",
    "u, v, w": "agent, u,v,w",
    "w alone": "w, all tasks",
    "u, v, w, p": "agent, u,v,w,p",
    "planner": "planner, all tasks",
}
BOOKS = {"Little Alchemy 2": "little-alchemy-2", "`everyday`": "everyday"}


def test_the_evidence_on_planning_prints_the_stored_agents_and_planners():
    rates = {
        tuple(row[key] for key in ("book", "split", "depth", "distractors", "player")): row[
            "success"
        ]
        for row in stored("planning-agents.json")
        if row["seed"] == 0
    }
    rows = table("evidence/planning-agents.md", "book, depth, split", "distractors")
    assert len(rows) == 24
    where = ""
    for name, distractors, *cells in rows:
        where = name or where
        book, depth, split = where.split(", ")
        for player, cell in zip(PLAYERS.values(), cells, strict=True):
            rate = rates[BOOKS[book], split, int(depth), int(distractors), player]
            assert number(cell) == pytest.approx(rate, abs=CLOSE), (where, distractors, player)


OUTSIDE = {
    "recipes alone, no words": "recipes alone",
    "and GloVe": "and GloVe",
    "and MiniLM": "and words",
    "and a language model": "language model",
    "and WordNet": "WordNet",
    "and the other book": "book",
    "and Infinite Craft, links and pair encoder": "Infinite Craft",
    "the other book, with GloVe instead of MiniLM": "GloVe and book",
    "**all of them**": "all",
    "zero-shot: the other book alone": "zero-shot",
    "zero-shot, without shared recipes": "zero-shot unshared",
    "zero-shot, with language model and WordNet": "zero-shot all",
    "control: language model with random weights": "control random weights",
    "control: language model reads made-up names": "control made-up",
    "control: its tables under shuffled labels": "control shuffled labels",
    "control: shuffled vectors": "control shuffled words",
}
COLUMNS = {
    "8 distractors": "8",
    "1": "1",
    "few": "few 8",
    "8, goals that the other book makes": "made 8",
    "8, other goals": "other 8",
}


KNOWLEDGE = "outside-knowledge.json"
WITH_INFINITE_CRAFT = "evidence/data/outside-infinite-craft.json"


def means_of(book, split, file=KNOWLEDGE):
    """Return the mean over splits of each row and figure of a file; None where a split lacks it."""
    rows = {}
    for row in stored(file):
        if (row["book"], row["split"]) == (book, split):
            rows.setdefault(row["row"], []).append(row)
    return {
        name: {
            figure: float(np.mean([row[figure] for row in of]))
            if all(figure in row for row in of)
            else None
            for figure in ("mrr", *COLUMNS.values(), "share made")
        }
        for name, of in rows.items()
    }


def test_the_evidence_on_outside_knowledge_prints_the_stored_means():
    pages = [(head, rows) for head, rows in tables("evidence/outside.md") if "few" in head]
    books = ["little-alchemy-2"] * 3 + ["everyday"] * 2 + ["my-book"]
    files = [KNOWLEDGE] * len(books) + [WITH_INFINITE_CRAFT] * 4
    books += ["little-alchemy-2"] * 2 + ["everyday"] * 2
    compared = 0
    for book, file, (head, rows) in zip(books, files, pages, strict=True):
        split = head[1].partition(",")[0]
        means = means_of(book, split, file)
        for name, *cells in rows:
            for column, cell in zip(head[1:], cells, strict=True):
                figure = COLUMNS.get(column, "mrr")
                mean = means[OUTSIDE[name]][figure]
                if cell:
                    assert number(cell) == pytest.approx(mean, abs=CLOSE), (
                        book,
                        split,
                        name,
                        column,
                    )
                    compared += 1
                else:
                    assert mean is None
    assert compared > 150


def test_the_gain_by_goal_is_printed_with_its_goals():
    """The gain by goal stands in one sentence with the goals that the other book makes."""
    means = means_of("little-alchemy-2", "by-goal")
    before, after = means["and GloVe"], means["all"]
    expected = [
        *(before["8"], after["8"]),
        *(before["made 8"], after["made 8"]),
        *(before["other 8"], after["other 8"]),
    ]
    guide = " ".join((DOCS / "evidence/outside.md").read_text(encoding="utf-8").split())
    gain = re.search(r"unseen goals (from \.363 .*?); with unseen slots", guide)[1]
    gain = re.sub(r", a gain of .*? over three splits", "", gain).replace("recipes and GloVe", "")
    numbers = [float(value) for value in re.findall(NUMBER, gain)]
    assert numbers == pytest.approx(expected, abs=CLOSE)
    share = re.search(r"makes the goal of (\d+) % of the tasks", guide)
    assert int(share[1]) == round(100 * after["share made"])


def test_the_page_gives_the_scorer_on_five_splits_beside_split_0():
    alone = {}
    for row in stored("agents.json"):
        at = row["book"], row["split"], row["distractors"], row["scorer_cost"]
        if at == ("little-alchemy-2", "by-goal", 8, 0.3) and row["split_seed"] < 5:
            alone[row["split_seed"]] = row["agent"] - row["gain"]
    assert len(alone) == 5
    page = " ".join((DOCS / "partial-graph.md").read_text(encoding="utf-8").split())
    printed = re.search(r"the scorer alone makes (\.\d+) over \[splits 0 to 4\]", page)[1]
    assert float(printed) == pytest.approx(np.mean([*alone.values()]), abs=CLOSE)
    (row,) = [
        cells
        for cells in table("partial-graph.md", "unseen goals, split 0")
        if cells[0].startswith("recipe scorer alone")
    ]
    assert number(row[4]) == pytest.approx(alone[0], abs=CLOSE)
    assert number(row[5]) == pytest.approx(np.mean([alone[seed] for seed in (0, 1, 2)]), abs=CLOSE)


def test_the_guide_says_that_split_0_is_easy_by_goal():
    """The page on partial graphs says that split 0 is an easy split by goal."""
    (rates,) = [
        row["success"]
        for row in stored("untrained-players.json")
        if (row["book"], row["split"], row["player"], row["distractors"])
        == ("little-alchemy-2", "by-goal", "recipe scorer alone, w", 8)
    ]
    assert rates[0] == max(rates)
    guide = " ".join((DOCS / "partial-graph.md").read_text(encoding="utf-8").split())
    printed = re.search(r"scorer alone makes (\.\d+) there, and (\.\d+) on average over", guide)
    expected = [rates[0], np.mean(rates)]
    assert list(map(float, printed.groups())) == pytest.approx(expected, abs=CLOSE)


def test_which_model_prints_figures_of_the_commands_beside_them():
    means = means_of("little-alchemy-2", "by-goal")
    (line,) = [
        cells[1]
        for _, rows in tables("which-model.md")
        for cells in rows
        if cells[0].startswith("goals or slots without any train recipe")
    ]
    assert re.findall(r"`--with everyday` (\.\d+)", line) == [shown(means["GloVe and book"]["8"])]
    expected = {
        r"goals that `everyday` makes (\.\d+)": means["GloVe and book"]["made 8"],
        r"other goals (\.\d+)": means["GloVe and book"]["other 8"],
        r"with MiniLM vectors of both books \(.*?`--features`\) (\.\d+)": means["book"]["8"],
        r"3 minutes\) (\.\d+)": means["language model"]["8"],
        r"all sources with WordNet (\.\d+)": means["all"]["8"],
        r"GloVe alone (\.\d+)": means["and GloVe"]["8"],
        r"all sources, (\.\d+)": means_of("my-book", "by-recipe")["all"]["8"],
    }
    for pattern, mean in expected.items():
        assert float(re.search(pattern, line)[1]) == pytest.approx(mean, abs=CLOSE), pattern


def shown(value):
    return f"{value:.3f}".removeprefix("0")


def test_the_guide_prints_the_stored_degree_shortcut():
    """The evidence on facts prints the stored success of the degree shortcut."""
    stored_rates = {
        (row["book"], row["distractors"]): row["success"][0]
        for row in stored("untrained-players.json")
        if (row["player"], row["split"]) == ("fewest uses", "by-recipe")
    }
    rows = {cells[0]: cells[1:] for cells in table("evidence/baselines.md", "player")}
    printed = rows["fewest uses in train recipes, whatever the goal"]
    expected = [stored_rates[book, n] for book in ("little-alchemy-2", "everyday") for n in (8, 1)]
    assert list(map(float, printed)) == pytest.approx(expected, abs=CLOSE)


LINKS = {
    "**recipe kernel**": "recipe kernel",
    "recipe kernel, no training": "recipe kernel",
    "recipe kernel without word vectors": "recipe kernel without words",
    "neighbour rule": "neighbour rule",
    "neighbour rule, no training": "neighbour rule",
    "neighbour rule, without near-synonyms": "neighbour rule",
    "ComplEx": "ComplEx",
    "ComplEx, without near-synonyms of train recipes": "ComplEx",
    "votes, no training": "votes",
    "frequency in train": "frequency",
    "facts: the train triples (0/1)": "facts",
}
PLAYED = {
    "u and v alone: first by v, then by u + v, self edges dropped": "u and v, self edges dropped",
    "u and v alone, self edges as observed in train": "u and v, self edges observed",
    "votes, best pair": "votes, best pair",
    "full graph as facts, best pair": "full graph as facts, best pair",
}


def test_the_guide_prints_stored_metrics_of_links():
    """The evidence on links prints the stored figures of ComplEx and scorers without training."""
    rows = stored("link-quality.json")
    compared = 0
    for head, lines in tables("evidence/links.md"):
        if head[1:] == ["`everyday`", "Little Alchemy 2"]:
            for name, *cells in lines:
                for book, cell in zip(("everyday", "little-alchemy-2"), cells, strict=True):
                    known = "no_near_synonym" if "near-synonyms" in name else "mrr"
                    row = LINKS.get(name)
                    each = [one[known] for one in rows if (one["book"], one["row"]) == (book, row)]
                    if row is not None:
                        printed = list(map(float, re.findall(NUMBER, cell)))
                        assert printed[0] == pytest.approx(np.mean(each), abs=CLOSE), (name, book)
                        assert printed[1:] in ([], pytest.approx(each, abs=CLOSE)), (name, book)
                        compared += 1
    assert compared == 18


def test_the_guide_prints_stored_success_of_simple_rules():
    """The evidence on whole recipes prints the stored success of simple rules."""
    rows = stored("link-quality.json")
    printed = {
        name: cells
        for name, *cells in table(
            "evidence/recipe-scorer.md", "Little Alchemy 2, splits 0, 1 and 2"
        )
    }
    for name, row in PLAYED.items():
        each = [one for one in rows if (one["book"], one["row"]) == ("little-alchemy-2", row)]
        assert len(each) == 3
        for cell, amount in zip(printed[name][1:], ("8", "1"), strict=True):
            mean = np.mean([one[amount] for one in each])
            assert number(cell) == pytest.approx(mean, abs=CLOSE), (name, amount)


def test_the_evidence_on_the_penalty_prints_the_stored_means():
    """The evidence on the penalty prints the stored success and gain, as means over splits."""
    printed = [rows for head, rows in tables("evidence/penalty.md") if "each split" in head]
    files = {"agents.json": 10, "evidence/data/agents-recommended.json": 5}
    for (file, least), rows in zip(files.items(), printed, strict=True):
        assert len(rows) >= least
        for where, distractors, agent, gain, *_ in rows:
            name, split = where.split(", ")
            by_split = {}
            for row in stored(file):
                at = row["book"], row["split"], row["distractors"], row["scorer_cost"]
                key = BOOKS[name], split.replace(" ", "-"), int(distractors), 0.3
                if at == key and row["split_seed"] < 5:
                    by_split.setdefault(row["split_seed"], []).append((row["agent"], row["gain"]))
            assert len(by_split) in (3, 5), where
            means = np.mean([np.mean(runs, axis=0) for runs in by_split.values()], axis=0)
            assert [number(agent), number(gain)] == pytest.approx(means, abs=CLOSE), where


STUDIED = {
    "no graph": "no graph",
    "the paper's settings, in-sample": "partial, as published, u v",
    "**the paper's settings, cross-fitted**": "as published, cross-fitted, u v",
    "our settings, in-sample": "partial, in-sample, u v",
    "our settings, cross-fitted": "partial, u v",
}


def test_the_explanation_of_cross_fitting_prints_the_figures_of_the_study():
    page = (DOCS / "evidence/knowledge.md").read_text(encoding="utf-8")
    blocks = re.split(r"^<summary>", page, flags=re.MULTILINE)[1:]
    found = [
        {
            cells[0]: cells[3]
            for cells in (line.strip("|").split(" | ") for line in block.splitlines())
            if len(cells) == 7
        }
        for of_book in blocks
        for block in of_book.split(" test tasks:")[1:]
    ]
    assert len(found) == 4
    rows = table("explanation/cross-fitting.md", "success with unseen recipes")
    assert [cells[0] for cells in rows] == [*STUDIED]
    for name, *cells in rows:
        expected = [number(point[f" {STUDIED[name]}"]) for point in found]
        assert list(map(number, cells)) == expected, name


def test_the_evidence_on_words_prints_the_stored_success_and_votes():
    players = (
        "recipe scorer alone, w",
        "graph without words, w",
        "words without graph, w",
    )
    rows = {
        (row["split"], row["player"]): row["success"]
        for row in stored("untrained-players.json")
        if (row["book"], row["distractors"]) == ("little-alchemy-2", 8)
    }
    lines = table("evidence/words.md", "Little Alchemy 2", "votes, MRR of results")
    assert len(lines) == 3
    for name, *cells, best_pair, votes in lines:
        split = name.replace(" ", "-")
        for cell, player in zip(cells, players, strict=True):
            assert number(cell) == pytest.approx(np.mean(rows[split, player]), abs=CLOSE), name
        pairs = [
            row["8"]
            for row in stored("link-quality.json")
            if (row["book"], row["split"], row["row"])
            == ("little-alchemy-2", split, "votes, best pair")
        ]
        assert bool(pairs) == bool(best_pair)
        if pairs:
            assert number(best_pair) == pytest.approx(np.mean(pairs), abs=CLOSE), name
        each = [
            row["mrr"]
            for row in stored("link-quality.json")
            if (row["book"], row["split"], row["row"])
            == ("little-alchemy-2", split, "votes, results")
        ]
        assert number(votes) == pytest.approx(np.mean(each), abs=CLOSE), name


def test_the_evidence_on_lists_prints_the_stored_figures_of_both_scorers():
    rows = table("evidence/lists.md", "with GloVe vectors")
    assert len(rows) == 2
    for name, *cells in rows:
        book, split = name.split(", ")
        for side, file in enumerate(("evidence/data/lists.json", KNOWLEDGE)):
            means = means_of(BOOKS[book], split.replace(" ", "-"), file)["and GloVe"]
            for cell, figure in zip(cells[side::2], ("mrr", "8", "1"), strict=True):
                assert number(cell) == pytest.approx(means[figure], abs=CLOSE), (name, figure)


def archived_means(player):
    """Success of a player's submissions to `depth-2-lite` of the second edition."""
    with zipfile.ZipFile(ROOT / "leaderboard" / "archive" / "everyday-v2.zip") as archive:
        names = [name for name in archive.namelist() if re.match("depth-2-lite/.*sion.json", name)]
        submissions = [json.loads(archive.read(name)) for name in names]
    return [each["figures"]["mean"] for each in submissions if each["player"] == player]


def test_the_evidence_on_language_models_prints_the_leaderboard():
    """Each cell is a row of its track on the leaderboard."""
    names = {
        "recipe scorer with GloVe": "recipe scorer, GloVe",
        "Qwen2.5-Coder-1.5B, by recipes": "Qwen2.5-Coder-1.5B-Instruct, by recipes",
        "Qwen2.5-Coder-0.5B, by recipes": "Qwen2.5-Coder-0.5B-Instruct, by recipes",
        "SmolLM2-135M, by recipes": "SmolLM2-135M-Instruct, untuned, by recipes",
        "nearest words (MiniLM; of made-up words GloVe)": "nearest words (minilm)",
        "SmolLM2-135M, probabilities": "SmolLM2-135M-Instruct, probabilities",
        "SmolLM2-135M, probabilities and a look-up": (
            "SmolLM2-135M-Instruct, probabilities, look-ups"
        ),
        "Qwen2.5-Coder-1.5B, constrained": "Qwen2.5-Coder-1.5B-Instruct, constrained",
        "Qwen2.5-Coder-0.5B, constrained": "Qwen2.5-Coder-0.5B-Instruct, constrained",
    }
    archived = "Qwen2.5-Coder-0.5B, generation (everyday-v2)"
    page = (DOCS / "leaderboard.md").read_text(encoding="utf-8")
    (head, rows), *_ = tables("evidence/language-models.md")
    drawn = "random pair of different items"
    assert {name for name, *_ in rows} == {*names, "chance", drawn, archived}
    for name, *cells in rows:
        if name in (drawn, archived):
            continue
        for track, cell in zip(head[1:], cells, strict=True):
            _, _, of_track = page.partition(f"<summary>{track.strip('`')}: ")
            of_track = of_track.partition("</details>")[0]
            if name == "chance":
                assert number(re.search(r"chance (\S+)", of_track)[1]) == number(cell), track
                continue
            player = names[name]
            if track.strip("`").endswith("made-up"):
                player = player.replace("minilm", "glove")
            printed = re.search(rf"\| {re.escape(player)} \| (.*?) <span", of_track)
            if track == "`depth-2-lite`" and printed is None and cell:
                player = player.removesuffix(", look-ups")
                assert number(cell) in archived_means(player), name  # as the page's method says
                continue
            assert (printed is None) == (cell == ""), (name, track)
            if printed:
                figures = [float(value) for value in re.findall(NUMBER, cell)]
                assert [float(value) for value in re.findall(NUMBER, printed[1])] == figures, name
