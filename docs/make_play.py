"""Write the tasks of the website's game: tables, an agent's pairs and the recipes that support them;
easy goals first.

    wordcraft-kg explain RUN --episodes 60 --json > explained.json
    python docs/make_play.py explained.json GRAPH site/play/tasks.js

RUN is a run of train-agent at depth 1 with w among its scores, and GRAPH its graph folder. The
output is JavaScript, so that the page also works without a server.
"""

import json
import sys
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs.folder import open_graph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.scorers.features import make_features


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


if __name__ == "__main__":
    explained, folder, out = sys.argv[1:]
    graph = open_graph(folder).graph
    data = json.loads(Path(explained).read_text(encoding="utf-8"))
    vectors = make_features("minilm", graph.entities).vectors
    vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    tasks = [task_of(episode, graph, vectors) for episode in data["episodes"]]
    # Easy goals first: those that most scripted players make. The sort keeps the order of equals.
    tasks.sort(key=lambda task: -task["players"])
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(Path(out), f"const TASKS = {json.dumps(tasks, ensure_ascii=False)};\n")
