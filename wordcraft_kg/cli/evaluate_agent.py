"""``wordcraft-kg evaluate-agent``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned, lines_of, refuse_given, whole_numbers
from wordcraft_kg.cli.options import Book, MovedGraph, Part, Words
from wordcraft_kg.envs.config import WordCraftConfig

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.players import Baselines

EXAMPLES = (
    "wordcraft-kg evaluate-agent runs/no-kg --part test --distractors 1,8 --distractor-seeds 5",
    "wordcraft-kg evaluate-agent runs/partial --agent kg-only",
    "wordcraft-kg evaluate-agent graphs/everyday --scorer models/everyday",
)


@dataclass(frozen=True)
class RunOptions:
    """Options for the run of an agent.

    Attributes:
        agent: player of the run's tasks: the trained agent, chance, an oracle, or the run's scorer alone, with the
            scores that the agent uses.
    """

    agent: Literal["trained", "random", "oracle", "kg-only"] = "trained"
    graph: MovedGraph = None


@dataclass(frozen=True)
class ScriptedOptions:
    """Options for scripted players.

    Attributes:
        depth: fewest attempts that solve a task, 1 to 5.
        scorer: model folder; players that use its scores play too.
        seed: seed of the draws and of ties.
    """

    depth: int = WordCraftConfig.depth
    scorer: Path | None = None
    seed: int = 0


def evaluate_agent(
    run: Book = "everyday",
    *,
    part: Part = "test",
    distractors: Words = None,
    distractor_seeds: int = 5,
    trained: Annotated[RunOptions, Parameter(name="*", group="Run of an agent")] = RunOptions(),
    scripted: Annotated[ScriptedOptions, Parameter(name="*", group="Scripted players")] = ScriptedOptions(),
    output: Output = Output(),
) -> None:
    """Let an agent, or scripted players, play all tasks of a part with fixed draws of distractors.

    An agent plays greedily. On a graph, its baselines play: chance, votes, symbolic graphs, a scorer, the oracle.

    Args:
        run: run folder, evaluated at its last checkpoint if it is unfinished; or a graph folder, book's file, or known
            book's name, on which scripted players play.
        distractors: comma-separated numbers of distractors. Default: as in training, and 1,2,8 for scripted players.
        distractor_seeds: draws of distractors for each task; all players see the same.
    """
    whole("distractor_seeds", distractor_seeds, 1, MAX_SIZE)
    if Path(run).is_dir() and not (Path(run) / "graph.json").is_file():
        refuse_given(scripted, f"scripted players on a graph, and '{run}' is none")
        from wordcraft_kg.agents.agent_folder import open_agent
        from wordcraft_kg.evaluation.players import view_evaluation

        opened = open_agent(Path(run), trained.graph)
        amounts = whole_numbers("distractors", distractors or [str(opened.config.tasks.distractors)])
        view = view_evaluation(Path(run), opened, trained.agent, part, amounts, distractor_seeds)
        output.result(view, lines_of(view))
    else:
        refuse_given(trained, f"the run of an agent, and '{run}' is none")
        amounts = whole_numbers("distractors", distractors or ["1,2,8"])
        config = WordCraftConfig(part=part, depth=scripted.depth, num_distractors=amounts[0])
        baselines = _play(run, config, amounts, distractor_seeds, scripted, output)
        output.result(baselines, _table(baselines, amounts))


def _play(
    graph: str,
    config: WordCraftConfig,
    amounts: list[int],
    distractor_seeds: int,
    options: ScriptedOptions,
    output: Output,
) -> "Baselines":
    from wordcraft_kg.evaluation.players import view_baselines
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    model: Any = None
    if options.scorer is not None:
        from wordcraft_kg.models.folder import open_model

        model = options.scorer.name, open_model(options.scorer, graph)
    progress = output.progress("baselines", unit="row")
    return view_baselines(
        opened, graph, config, amounts, model, distractor_seeds=distractor_seeds, seed=options.seed, progress=progress
    )


def _table(view: "Baselines", amounts: list[int]) -> list[str]:
    cells = {(row.player, row.distractors): f"{row.success:.3f} [{row.low:.3f}, {row.high:.3f}]" for row in view.rows}
    rows = [("success", *(counted(amount, "distractor") for amount in amounts))]
    rows += [(name, *(cells[name, amount] for amount in amounts)) for name in dict.fromkeys(name for name, _ in cells)]
    distractor_seeds = counted(view.distractor_seeds, "distractor seed")
    tasks = f"{view.tasks:,} {view.part} tasks of depth {view.depth}, each with {distractor_seeds} of distractors"
    return [*aligned(rows, numbers=True), f"{tasks}; intervals: {view.intervals}"]
