"""``wordcraft-kg baselines``."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output, whole_numbers
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

EXAMPLES = (
    "wordcraft-kg baselines graphs/everyday --distractors 1,2,8",
    "wordcraft-kg baselines graphs/everyday --scorer models/everyday-partial",
)


def baselines(
    graph: str = "everyday",
    *,
    distractors: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    part: TaskPart = "test",
    depth: int = WordCraftConfig.depth,
    scorer: Path | None = None,
    draws: int = 5,
    seed: int = 0,
    output: Output = Output(),
) -> None:
    """Play all tasks of a part by script: chance, symbolic knowledge graphs, a scorer, the oracle.

    Args:
        graph: graph folder, book's file, or known book's name.
        distractors: numbers of distractors, commas separate. Default: 1,2,8.
        part: tasks to play: train, valid, test or all.
        depth: attempts that a task takes.
        scorer: model folder whose scores play too.
        draws: draws of distractors for each task; all players see the same.
        seed: of the draws and of ties.
    """
    from wordcraft_kg.agents.players import knowledge_players, play_all, scorer_players
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.graphs.folder import open_graph

    amounts = whole_numbers("distractors", distractors or ["1,2,8"])
    config = WordCraftConfig(part=part, depth=depth, num_distractors=amounts[0])
    if draws < 1:
        from wordcraft_kg.errors import ConfigError

        raise ConfigError(f"--draws {draws}: expected 1 or more.")
    opened = open_graph(graph)
    players = knowledge_players(opened.graph, opened.split.partial)
    if scorer is not None:
        from wordcraft_kg.models.links.folder import open_model

        model = open_model(scorer, graph)
        known = opened.triples(model.kg)
        named = scorer_players(opened.graph, model.scorer, known)
        oracle = players.pop("recipe oracle")
        players |= {f"{scorer.name}, {name}": player for name, player in named.items()} | {"recipe oracle": oracle}
    table = play_all(World(opened, config), players, amounts, draws=draws, seed=seed)
    rows: list[dict[str, Any]] = [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]
    values = {"graph": graph, "part": part, "depth": depth, "draws": draws, "seed": seed, "rows": rows}
    output.result(values, _text(rows, amounts, part, depth))


def _text(rows: list[dict[str, Any]], amounts: list[int], part: str, depth: int) -> list[str]:
    names = list(dict.fromkeys(row["player"] for row in rows))
    of = {(row["player"], row["distractors"]): row for row in rows}
    width = max(map(len, names))
    title = f"{'success':<{width}}" + "".join(
        f"  {f'{amount} distractor' + 's' * (amount != 1):>19}" for amount in amounts
    )
    lines = [title.rstrip()]
    for name in names:
        cells = (of[name, amount] for amount in amounts)
        lines.append(
            f"{name:<{width}}"
            + "".join(f"  {cell['success']:.3f} [{cell['low']:.3f}, {cell['high']:.3f}]" for cell in cells)
        )
    episodes = ", ".join(f"{of[names[0], amount]['episodes']:,}" for amount in amounts)
    lines.append(f"{part} tasks of depth {depth}; {episodes} episodes each; 95 % Wilson intervals")
    return lines
