"""``wordcraft-kg baselines``."""

from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.cli.completion import Book, Scorer
from wordcraft_kg.cli.console import Output, whole_numbers
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.players import Baselines

EXAMPLES = (
    "wordcraft-kg baselines graphs/everyday --distractors 1,2,8",
    "wordcraft-kg baselines graphs/everyday --scorer models/everyday",
)


def baselines(
    graph: Book = "everyday",
    *,
    distractors: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    part: TaskPart = "test",
    depth: int = WordCraftConfig.depth,
    scorer: Scorer = None,
    draws: int = 5,
    seed: int = 0,
    output: Output = Output(),
) -> None:
    """Let scripted players play all tasks of a part: chance, votes, symbolic graphs, a scorer, the oracle.

    Args:
        graph: graph folder, book's file, or known book's name.
        distractors: comma-separated numbers of distractors. Default: 1,2,8.
        part: tasks to play: train, valid, test or all.
        depth: fewest attempts that solve a task, 1 to 5.
        scorer: model folder; players that use its scores play too.
        draws: draws of distractors for each task; all players see the same.
        seed: seed of the draws and of ties.
    """
    from wordcraft_kg.evaluation.players import view_baselines
    from wordcraft_kg.graphs.folder import open_graph

    amounts = whole_numbers("distractors", distractors or ["1,2,8"])
    config = WordCraftConfig(part=part, depth=depth, num_distractors=amounts[0])
    whole("draws", draws, 1, MAX_SIZE)
    opened = open_graph(graph)
    model = None
    if scorer is not None:
        from wordcraft_kg.models.links.folder import open_model

        model = scorer.name, open_model(scorer, graph)
    progress = output.progress("baselines", unit="row")
    view = view_baselines(opened, graph, config, amounts, model, draws=draws, seed=seed, progress=progress)
    output.result(view, _text(view))


def _text(view: "Baselines") -> list[str]:
    names = list(dict.fromkeys(row.player for row in view.rows))
    amounts = list(dict.fromkeys(row.distractors for row in view.rows))
    of = {(row.player, row.distractors): row for row in view.rows}
    width = max(map(len, names))
    titles = (f"{amount} distractor" + "s" * (amount != 1) for amount in amounts)
    lines = [f"{'success':<{width}}" + "".join(f"  {title:>19}" for title in titles)]
    for name in names:
        cells = (of[name, amount] for amount in amounts)
        lines.append(
            f"{name:<{width}}" + "".join(f"  {cell.success:.3f} [{cell.low:.3f}, {cell.high:.3f}]" for cell in cells)
        )
    episodes = f"{view.tasks:,} {view.part} tasks of depth {view.depth}, {_draws(view.draws)}"
    lines.append(f"{episodes}; intervals: {view.intervals}")
    return lines


def _draws(number: int) -> str:
    return f"each with {number:,} draws of distractors" if number != 1 else "each with one draw of distractors"
