"""Write the tasks of the website's game: tables, an agent's decisions, its scorer's numbers and the
supporting recipes.

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

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs.folder import open_graph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph


def task_of(episode: dict[str, Any], graph: RecipeGraph) -> dict[str, Any]:
    """Return an episode as the page shows it; items are places on the table."""
    first = episode["steps"][0]
    table = [slot["entity"] for slot in first["slots"]]
    made = {}
    for one, other in combinations_with_replacement(range(len(table)), 2):
        if labels := graph.labels(graph.results(table[one], table[other])):
            made[f"{one},{other}"] = labels
    ranked = sorted(first["slots"], key=lambda slot: -slot["sources"]["w"])
    pairs: dict[tuple[int, ...], dict[str, Any]] = {}
    for slot in ranked:
        if evidence := slot["evidence"]:
            pair = tuple(sorted(map(table.index, (slot["entity"], evidence["partner"]))))
            because = [
                f"{one['ingredient_a']} + {one['ingredient_b']} → {one['result']}"
                for one in evidence["because"]
            ]
            pairs.setdefault(
                pair, {"pair": pair, "w": round(slot["sources"]["w"], 2), "because": because}
            )
    return {
        "goal": episode["goal"],
        "table": table,
        "made": made,
        "agent": [table.index(step["action"]) for step in episode["steps"][:2]],
        "probability": [round(slot["probability"], 4) for slot in first["slots"]],
        "scorer": [*pairs.values()][:3],
    }


if __name__ == "__main__":
    explained, folder, out = sys.argv[1:]
    graph = open_graph(folder).graph
    data = json.loads(Path(explained).read_text(encoding="utf-8"))
    tasks = [task_of(episode, graph) for episode in data["episodes"]]
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(Path(out), f"const TASKS = {json.dumps(tasks, ensure_ascii=False)};\n")
