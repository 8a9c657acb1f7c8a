"""``wordcraft-kg chats``."""

from itertools import product
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from wordcraft_kg.base import MAX_SIZE, check_output_file, counted, number_in, whole
from wordcraft_kg.cli.console import Output, whole_numbers
from wordcraft_kg.cli.options import Book, Force, Words
from wordcraft_kg.graphs.tasks import MAX_DEPTH

GROUP = "Text agents"
EXAMPLES = (
    "wordcraft-kg chats everyday --player oracle --out sft.jsonl",
    "wordcraft-kg chats everyday --depth 1,2,3,4 --player planner --keep shortest --out sft.jsonl",
    "wordcraft-kg chats kitchen --player scorer:models/kitchen --style text --out sft.jsonl",
)


def chats(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    out: Annotated[Path, Parameter(name=["--out"])],
    player: str = "oracle",
    depth: Words = None,
    distractors: Words = None,
    attempts: int | None = None,
    tables: int = 1,
    tasks: int | None = None,
    difficulty: str | None = None,
    keep: Literal["made", "shortest", "all"] = "made",
    style: Literal["tools", "text"] = "tools",
    mistakes: float = 0.0,
    reasons: Path | None = None,
    seed: int = 0,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Write a player's games as conversations to fine-tune language models on.

    Games are of train tasks alone, so that test tasks measure what was learned. A line is a
    conversation, in the messages format of TRL's SFTTrainer. The same command writes the same
    bytes.

    Args:
        graph: graph folder, recipe book or known book's name.
        out: file to write (JSON lines).
        player: oracle, planner (by the train recipes), votes, graph, nearest-words, random,
            planner:MODEL, scorer:MODEL or agent:RUN.
        depth: comma-separated depths of tasks, 1 to 5. Default: 1.
        distractors: comma-separated numbers of distractors on a table. Default: 8.
        attempts: attempts in a game. Default: the task's depth.
        tables: tables for each task, each with distractors of its own.
        tasks: most tasks for each depth and number of distractors, evenly spaced. Default: all.
        difficulty: least and largest difficulty of tasks, such as .2:.8: the share of games that
            nearest words, a learner and a planner lose; measured for everyday. Default: all.
        keep: games that made the goal (made), those of them in the fewest possible attempts
            (shortest), or all.
        style: calls of the tool combine (tools), or lines such as water + earth (text).
        mistakes: probability of a mistake before each attempt: an item that is not on the table, or
            a pair that makes nothing. Their places are in each line, so that a learner can skip
            them. With more attempts than the depth, games recover; else they are lost.
        reasons: model folder of train-recipes: an answer begins with the train recipes that make
            the model expect it, without its own recipe.
        seed: seed of the player, the tables, the wordings and the orders.
    """
    depths = whole_numbers("depth", depth or ["1"])
    for task_depth in depths:
        whole("depth", task_depth, 1, MAX_DEPTH)
    numbers = whole_numbers("distractors", distractors or ["8"])
    whole("seed", seed, 0, MAX_SIZE - 1)
    whole("tables", tables, 1, MAX_SIZE)
    number_in("mistakes", mistakes, 0, 0.9, "a probability from 0 to 0.9")
    if tasks is not None:
        whole("tasks", tasks, 1, MAX_SIZE)
    from wordcraft_kg.apps.text_agents.benchmark_players import named_player
    from wordcraft_kg.apps.text_agents.chats import (
        ChatCounts,
        ChatSettings,
        chat_rows,
        recipe_scorer,
        write_chats,
    )
    from wordcraft_kg.apps.text_agents.difficulty import read_range
    from wordcraft_kg.apps.text_agents.hosted_games import open_play
    from wordcraft_kg.graphs.graph_folder import open_graph

    check_output_file(out, force=force)
    source = open_graph(graph)
    plays = []
    for task_depth, number in product(depths, numbers):
        plays.append(open_play(graph, "train", task_depth, number, attempts))
    title, played_by = named_player(player, source, plays[0].world.tasks)
    settings = ChatSettings(style, keep, tables, tasks, mistakes, seed, read_range(difficulty))
    counts = ChatCounts()
    scorer = None if reasons is None else recipe_scorer(reasons, source)
    rows = chat_rows(plays, played_by, settings, counts, scorer)
    digest = write_chats(out, rows, force=force)
    view = {
        "out": str(out),
        "graph": source.graph.hash,
        "split": source.split.hash,
        "prompts": plays[0].settings.prompt_hash,
        "player": title,
        "sha256": digest,
        "counts": vars(counts),
    }
    output.result(
        view,
        [
            f"{counted(counts.written, 'conversation')} of {counted(counts.played, 'game')} by "
            f"{title}; left out: {counts.left_out:,} not to be kept, {counts.repeated:,} repeated",
            f"wrote {out}",
        ],
    )
