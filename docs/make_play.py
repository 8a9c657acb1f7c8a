"""Write what the website shows of an agent's games: the tasks of the page Play, easy goals first, or
the moving picture of README, by the name of the output.

    wordcraft-kg explain RUN --episodes 60 --json > explained.json
    python docs/make_play.py explained.json GRAPH site/play/tasks.js
    wordcraft-kg explain RUN --goal GOAL --json > explained.json
    python docs/make_play.py explained.json GRAPH docs/images/decision.svg

RUN is a run of train-agent at depth 1 with w among its scores, and GRAPH its graph folder. The tasks
are JavaScript, so that the page also works without a server; the picture is the first episode.
"""

import json
import sys
from collections.abc import Iterator
from html import escape
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs.graph_folder import open_graph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.scorers.features import make_features

WIDTH = 900
LINE = 30
"""Pixels of an item's line."""
TOP = 74
BAR = 190
"""Pixels of a bar of probability 1."""
SECONDS = 12
"""Of one round: four for each pick, four for the outcome."""
STYLE = f"""
svg {{ font: 16px system-ui, sans-serif; }}
text {{ fill: #1d2733; }} .soft {{ fill: #52606d; }} .page {{ fill: #fffdf8; }} .bar {{ fill: #b06a1c; }}
.goal {{ font-size: 22px; font-weight: bold; }} .chosen {{ font-weight: bold; fill: #7a3e00; }}
@media (prefers-color-scheme: dark) {{
text {{ fill: #ece7dc; }} .soft {{ fill: #b3ab9b; }} .page {{ fill: #17140f; }} .bar {{ fill: #d98a33; }}
.chosen {{ fill: #f0b35c; }} }}
g {{ opacity: 0; animation: show {SECONDS}s infinite; }}
g.always {{ opacity: 1; animation: none; }}
g.second {{ animation-delay: {SECONDS // 3}s; }} g.third {{ animation-delay: {2 * SECONDS // 3}s; }}
@keyframes show {{ 0%, 31% {{ opacity: 1; }} 33.4%, 98% {{ opacity: 0; }} 100% {{ opacity: 1; }} }}
@media (prefers-reduced-motion: reduce) {{ g {{ animation: none; }} g.third {{ opacity: 1; }} }}
"""


def task_of(
    episode: dict[str, Any], graph: RecipeGraph, vectors: NDArray[np.float32]
) -> dict[str, Any]:
    """Return an episode as the page shows it; items are places on the table.

    Args:
        episode: an episode of ``explain``.
        graph: the book's recipe graph.
        vectors: shape (E, D), unit vectors of the labels, for the two words nearest to the goal.
    """
    first = episode["steps"][0]
    goal = episode["goal"]
    table = [slot["entity"] for slot in first["slots"]]
    made = {}
    for pair in combinations_with_replacement(range(len(table)), 2):
        results = graph.results(*(table[place] for place in pair))
        if labels := graph.labels(results):
            made[",".join(map(str, pair))] = labels
    agent = sorted(table.index(step["action"]) for step in episode["steps"][:2])
    ranked = sorted(first["slots"], key=lambda slot: -slot["sources"]["w"])
    pairs = {}
    for slot in ranked:
        if slot["evidence"]:
            pair = sorted(map(table.index, (slot["entity"], slot["evidence"]["partner"])))
            pairs.setdefault(tuple(pair), slot["evidence"]["because"])
    scorer = list(next(iter(pairs)))
    because = [
        f"{recipe['ingredient_a']} + {recipe['ingredient_b']} → {recipe['result']}"
        for recipe in pairs.get(tuple(agent), ())
    ]
    cosines = vectors[graph.ids_of(table)] @ vectors[graph.id_of(goal)]
    words = sorted(np.argsort(-cosines, kind="stable")[:2].tolist())
    wins = [goal in made.get(f"{a},{b}", ()) for a, b in (agent, scorer, words)]
    return {
        "goal": goal,
        "table": table,
        "made": made,
        "agent": agent,
        "scorer": scorer,
        "because": because,
        "players": sum(wins),
    }


def text(x: float, y: float, words: str, kind: str = "") -> str:
    """Return a line of text; labels stay text."""
    return f'<text x="{x}" y="{y}" class="{kind}">{escape(words)}</text>'


def pick(step: dict[str, Any], number: str) -> Iterator[str]:
    """Yield a pick: the items with their probabilities, and what speaks for the most likely one."""
    yield f'<g class="{number}">'
    for line, slot in enumerate(step["slots"]):
        y = TOP + LINE * line
        kind = "chosen" if slot["entity"] == step["action"] else ""
        yield text(24, y, slot["entity"], kind)
        width = max(2, round(BAR * slot["probability"]))
        yield f'<rect class="bar" x="190" y="{y - 12}" width="{width}" height="12" rx="3"/>'
        yield text(198 + width, y, f"{100 * slot['probability']:.0f} %", "soft")
    chosen = next(slot for slot in step["slots"] if slot["entity"] == step["action"])
    yield text(480, TOP, f"The agent's {number} pick: {step['action']}", "chosen")
    evidence = chosen["evidence"]
    if evidence and evidence["because"]:
        yield text(480, TOP + LINE, f"with {evidence['partner']}, because it knows", "soft")
        for line, recipe in enumerate(evidence["because"][:3], start=2):
            words = f"{recipe['ingredient_a']} + {recipe['ingredient_b']} → {recipe['result']}"
            yield text(480, TOP + LINE * line, words)
    yield "</g>"


def outcome_of(step: dict[str, Any], pair: str, outcome: str) -> Iterator[str]:
    """Yield the last scene: the items, and what the pair makes."""
    picks = pair.split(" + ")
    for line, slot in enumerate(step["slots"]):
        kind = "chosen" if slot["entity"] in picks else "soft"
        yield text(24, TOP + LINE * line, slot["entity"], kind)
    yield text(480, TOP, f"{pair} → {outcome}", "goal")
    yield text(480, TOP + LINE, "A recipe of the test: the agent has", "soft")
    yield text(480, TOP + 2 * LINE, "never seen it made.", "soft")


def picture(episode: dict[str, Any]) -> str:
    """Return an episode of one attempt as an SVG that needs no script."""
    first, second = episode["steps"][:2]
    height = TOP + LINE * len(first["slots"]) + 10
    pair = f"{first['action']} + {second['action']}"
    outcome = ", ".join(second["made"]) or "nothing"
    goal = episode["goal"]
    title = escape(f"An agent makes {goal}: {pair} makes {outcome}")
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" '
        f'aria-label="{title}">',
        f"<style>{STYLE}</style>",
        f'<rect class="page" width="{WIDTH}" height="{height}" rx="12"/>',
        f'<g class="always">{text(24, 36, f"Make: {goal}", "goal")}</g>',
        *pick(first, "first"),
        *pick(second, "second"),
        '<g class="third">',
        *outcome_of(first, pair, outcome),
        "</g>",
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    explained, folder, out = sys.argv[1:]
    episodes = json.loads(Path(explained).read_text(encoding="utf-8"))["episodes"]
    if out.endswith(".svg"):
        content = picture(episodes[0])
    else:
        graph = open_graph(folder).graph
        vectors = make_features("minilm", graph.entities).vectors
        vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        tasks = [task_of(episode, graph, vectors) for episode in episodes]
        # Easy goals first: those that most scripted players make. The sort keeps the order of equals.
        tasks.sort(key=lambda task: -task["players"])
        content = f"const TASKS = {json.dumps(tasks, ensure_ascii=False)};\n"
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(Path(out), content)
