"""``wordcraft-kg evaluate-agent``, ``wordcraft-kg explain`` and ``wordcraft-kg discover``."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.agents.discovery import DISCOVERERS, GUIDED
from wordcraft_kg.base import MAX_SIZE, ConfigError, counted, quoted, whole
from wordcraft_kg.cli.console import (
    Output,
    aligned,
    check_table,
    lines_of,
    refuse_given,
    split_labels,
    text_table,
    whole_numbers,
    write_table,
)
from wordcraft_kg.cli.options import Book, Graph, MovedGraph, OptionalBook, Part, Table, Words
from wordcraft_kg.envs.draws import MOST_TASKS
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.evaluation.discovery import (
    DiscoveryView,
    KnownEntities,
    open_guide,
    view_discovery,
)
from wordcraft_kg.graphs import open_graph
from wordcraft_kg.models.policies.sources import label_of

if TYPE_CHECKING:
    from wordcraft_kg.agents.explanation import ExplainedEpisode, ExplainedStep

EXAMPLES = {
    "evaluate-agent": (
        "wordcraft-kg evaluate-agent runs/no-kg --part test --distractors 1,8 --distractor-seeds 5",
        "wordcraft-kg evaluate-agent graphs/everyday --scorer models/everyday",
        "wordcraft-kg evaluate-agent graphs/everyday --scorer models/everyday --depth 2 "
        "--limit 2000",
        'wordcraft-kg evaluate-agent everyday --player "program:python examples/line_player.py"',
    ),
    "explain": (
        "wordcraft-kg explain runs/partial --goal bread --episodes 3",
        "wordcraft-kg explain runs/no-kg --part train --distractors 1",
        "wordcraft-kg explain runs/deep --task 12",
    ),
    "discover": (
        "wordcraft-kg discover everyday --players random-no-repeat,greedy --runs 20",
        "wordcraft-kg discover everyday --scorer models/everyday-recipes",
        "wordcraft-kg discover little-alchemy-2 --scorer models/everyday-recipes --attempts 500 "
        "--runs 20",
        "wordcraft-kg discover everyday --book little-alchemy-2 --attempts 500 --runs 10",
    ),
}


@dataclass(frozen=True)
class TaskOptions:
    """Options for the played tasks.

    Attributes:
        distractors: comma-separated numbers of distractors. Default: as in training; 1,2,8 for
            scripted players.
        distractor_seeds: distractor seeds for each task; all players get the same tables. Default:
            5, or 1 for a part with more than 6,000 tasks.
        limit: most tasks to play; of more, evenly spaced ones are played.
    """

    distractors: Words = None
    distractor_seeds: int | None = None
    limit: int = MOST_TASKS


@dataclass(frozen=True)
class ScriptedOptions:
    """Options for scripted players.

    Attributes:
        depth: recipes in the shortest plan, 1 to 5.
        scorer: model folder; adds players guided by this scorer.
        seed: seed for distractors and ties.
        player: a further player by text on the same tables, such as "program:python my_player.py"
            (line protocol). Repeat the command to continue its games.
        out: folder for this player's games. Default: text-agents/<name>.
        timeout: seconds for its answer.
    """

    depth: int = WordCraftConfig.depth
    scorer: Path | None = None
    seed: int = 0
    player: str | None = None
    out: Path | None = None
    timeout: float = 60.0


def evaluate_agent(
    run: Book = "everyday",
    *,
    part: Part = "test",
    played: Annotated[TaskOptions, Parameter(name="*", group="Tasks")] = TaskOptions(),
    graph: MovedGraph = None,
    scripted: Annotated[
        ScriptedOptions, Parameter(name="*", group="Scripted players")
    ] = ScriptedOptions(),
    table: Table = None,
    output: Output = Output(),
) -> None:
    """Evaluate an agent or scripted players on the tasks of a part, with fixed distractor seeds.

    Agents act greedily. For a graph, baselines play: chance, votes of similar recipes, graphs, a
    scorer, the oracle.

    Args:
        run: run folder (the last checkpoint is evaluated if training is unfinished); or graph, book
            file or known book's name for scripted players.
    """
    check_table(table)
    if Path(run).is_dir() and not (Path(run) / "graph.json").is_file():
        refuse_given(scripted, f"scripted players on a graph, and '{run}' is not a graph")
        from wordcraft_kg.agents.agent_folder import open_agent
        from wordcraft_kg.evaluation.agents import view_evaluation

        opened = open_agent(Path(run), graph)
        amounts = whole_numbers(
            "distractors", played.distractors or [str(opened.config.tasks.distractors)]
        )
        view = view_evaluation(
            Path(run),
            opened,
            part,
            amounts,
            played.distractor_seeds,
            played.limit,
        )
        rows = [
            {
                "player": "trained",
                "distractors": int(amount),
                "success": success.mean,
                "interval": (success.ci_low, success.ci_high),
                "by plan": success.by_plan,
            }
            for amount, success in view.success.items()
        ]
        output.result(view, [*lines_of(view), *view.notes(), *write_table(table, rows)])
    else:
        if graph is not None:
            raise ConfigError(f"`graph` is for a trained agent, and '{run}' is none; leave it out.")
        amounts = whole_numbers("distractors", played.distractors or ["1,2,8"])
        config = WordCraftConfig(part, scripted.depth, amounts[0])
        from wordcraft_kg.evaluation.agents import ExternalPlayer, view_baselines

        external = None
        if scripted.player is not None:
            if scripted.seed:
                raise ConfigError(f"`seed` {scripted.seed}: `player` has the tables of seed 0.")
            external = ExternalPlayer(scripted.player, scripted.out, scripted.timeout)

        opened_graph = open_graph(run)
        model = None
        if scripted.scorer is not None:
            from wordcraft_kg.models.model_folder import open_model

            model = scripted.scorer.name, open_model(scripted.scorer, run)
        baselines = view_baselines(
            opened_graph,
            run,
            config,
            amounts,
            model,
            played.distractor_seeds,
            scripted.seed,
            played.limit,
            external,
        )
        rows = [
            {
                "player": row.player,
                "goals": row.goals or None,
                "distractors": row.distractors,
                "success": row.success,
                "interval": (row.low, row.high),
                "by plan": row.by_plan,
            }
            for row in baselines.rows
        ]
        seeds = counted(baselines.distractor_seeds, "distractor seed")
        tasks = f"{baselines.tasks:,} {baselines.part} tasks of depth {baselines.depth}"
        text = [
            *text_table(rows),
            f"{tasks}, each with {seeds}; intervals: {baselines.intervals}",
            *(f"{goals}: {share:.0%} of the tasks" for goals, share in baselines.shares.items()),
            "by plan: success by the task's own recipe; the rest by other recipes for the goal, "
            "such as train recipes",
            *write_table(table, rows),
        ]
        output.result(baselines, text)


def explain(
    run: Path,
    *,
    goal: str | None = None,
    task: int | None = None,
    episodes: int = 3,
    part: Part = "test",
    distractors: int | None = None,
    graph: MovedGraph = None,
    output: Output = Output(),
) -> None:
    """Explain an agent's actions.

    Split each logit into contributions by attention and knowledge sources.

    With recipe scores (w), show the best slots' partners, the supporting train recipes, and
    evidence from outside knowledge. With plans (p), show the most probable plan, with the
    probability of each expected result.

    Args:
        run: run folder.
        goal: entity to make. Default: tasks spread evenly over the part.
        task: number of the task, from 0.
        episodes: episodes to play; several of a task have different distractors.
        distractors: number of distractors on the table. Default: as in training.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.agents.explanation import explain_episodes
    from wordcraft_kg.envs.world import World

    if goal is not None and task is not None:
        raise ConfigError("`goal` and `task` both choose tasks; give one of them.")
    whole("episodes", episodes, 1, MAX_SIZE)
    agent = open_agent(run, graph)
    # Without a number, tables are as in training.
    world = World(agent.opened, agent.config.tasks.environment(part, distractors))
    explained = explain_episodes(
        agent.policy, world, goal=goal, episodes=episodes, outside=agent.outside, task=task
    )
    lines: list[str] = []
    for number, episode in enumerate(explained, 1):
        lines += _text(number, episode)
    view = {"run": str(run), "checkpoint": agent.checkpoint, "part": part, "episodes": explained}
    output.result(view, [*_legend(explained[0].steps[0], lines), "", *lines])


def _legend(step: "ExplainedStep", lines: Sequence[str]) -> Iterator[str]:
    from wordcraft_kg.evaluation.scores import BECAUSE

    labels = [label_of(name) for name in step.slots[0].sources]
    lambdas = "mixing weights of these scores; each product, such as λα·α, is a contribution to β"
    rows = [(label.symbol, label.meaning or label.words) for label in labels]
    if step.lambdas:
        rows.append(("λ", lambdas))
    rows += [
        ("β", "the slot's logit"),
        ("π", "the action's probability"),
        ("V", "the value of the state"),
        (">", "the action"),
        ("*", "an ingredient for the goal in a plan"),
    ]
    yield from aligned(rows)
    if any(" because " in line for line in lines):
        yield f"because: {BECAUSE}"


def _text(number: int, episode: "ExplainedEpisode") -> Iterator[str]:
    plans = "; ".join(", then ".join(plan) for plan in episode.plans)
    yield f"Episode {number}: make {episode.goal}   ({plans})"
    for step in episode.steps:
        yield from _step(step)
    yield from ("  made it" if episode.outcome == "goal" else "  did not make it", "")


def _step(step: "ExplainedStep") -> Iterator[str]:
    from wordcraft_kg.evaluation.scores import because

    lambdas = [f"{label_of(name).coefficient} {value:z.2f}" for name, value in step.lambdas.items()]
    holding = f"  holding {step.selection or 'nothing'}   V {step.value:z.2f}"
    yield ""
    yield f"{holding}   {'  '.join(lambdas)}".rstrip()
    symbols = [label_of(name).symbol for name in step.slots[0].sources]
    # Without mixing weights there are no products to show.
    products = [f"λ{symbol}·{symbol}" for symbol in symbols] if step.lambdas else []
    rows = [("  ", *symbols, *products, "β", "π")]
    for slot in sorted(step.slots, key=lambda slot: -slot.logit):
        contributions = slot.contributions.values() if step.lambdas else ()
        figures = (*slot.sources.values(), *contributions, slot.logit)
        cells = [f"{figure:z.2f}" for figure in figures]
        pointer = ">" if slot.entity == step.action else " "
        star = " *" if slot.is_part else ""
        label = f"  {pointer} {slot.entity or 'combine'}{star}"
        rows.append((label, *cells, f"{slot.probability:.1%}"))
    yield from aligned(rows, numbers=True)
    for entity, evidence in step.best_evidence():
        support = f" because {because(evidence.because)}" if evidence.because else ""
        yield f"  {label_of(evidence.source).symbol}: {entity} + {evidence.partner}{support}"
        if evidence.plan:
            yield f"     plan: {', then '.join(map(str, evidence.plan))}"
        yield from (f"     {piece}" for piece in evidence.outside)
    if step.made:
        yield f"  made {', '.join(map(quoted, step.made))}"


def discover(  # noqa: PLR0913 - parameters are the command's options
    graph: Graph = "everyday",
    *,
    attempts: int = 100,
    runs: int = 100,
    players: Words = None,
    scorer: Path | None = None,
    book: OptionalBook = None,
    base: Words = None,
    seed: int = 0,
    output: Output = Output(),
) -> None:
    """Evaluate scripted players in open-ended mode: count discoveries, and compare with people.

    Args:
        attempts: combinations for each run.
        runs: runs for each player.
        players: comma-separated: random-no-repeat, nearest-words (similar labels, by the vectors of
            --scorer), greedy (knows the graph), recipe-learner (guided by --scorer), book-votes
            (guided by --book). Default: all that --scorer and --book allow, without nearest-words.
        scorer: model folder of train-recipes, on this book or another one.
        book: another book whose recipes guide book-votes.
        base: comma-separated entities known at the start. Default: the graph's base. People begin
            with air, earth, fire and water.
        seed: root seed.
    """
    played = open_graph(graph).graph
    guide = None if scorer is None else open_guide(scorer, played)
    # Nearest words load word vectors, so they play on request alone.
    playable = [name for name in DISCOVERERS if name not in (*GUIDED, "nearest-words")]
    if guide is not None:
        playable.append("recipe-learner")
    votes = None if book is None else open_graph(book).graph
    if votes is not None:
        playable.append("book-votes")
    selection = list(dict.fromkeys(split_labels(players))) if players else playable
    if not selection:
        raise ConfigError(f"`players`: expected at least one of {', '.join(DISCOVERERS)}.")
    labels = split_labels(base) if base else None
    view = view_discovery(
        played,
        selection,
        attempts=attempts,
        runs=runs,
        seed=seed,
        base=labels,
        scorer=guide,
        book=votes,
    )
    output.result(view, _text_of_discovery(view))


def _cell(known: KnownEntities) -> str:
    """Return a mean with its interval, if there is one."""
    # A player without chance does the same in each run: there is nothing between the ends.
    if known.low is None or known.high is None or known.low >= known.high:
        return f"{known.mean:.1f}"
    return f"{known.mean:.1f} [{known.low:.1f}, {known.high:.1f}]"


def _text_of_discovery(view: DiscoveryView) -> Iterator[str]:
    reachable = f"{view.reachable:,} of {view.entities:,} entities reachable"
    yield f"{view.graph}: {reachable} from {', '.join(map(quoted, view.base))}"
    yield f"{view.runs:,} runs of {view.attempts:,} attempts: mean [95% interval]"
    yield ""
    title = "entities known after"
    rows = []
    for name, figures in view.players.items():
        rows.append({title: name, **{mark: _cell(known) for mark, known in figures.items()}})
    # People played with other entities, so their row is a rough guide and says so.
    people = {mark: f"{view.people[mark]:g}" for mark in figures if mark in view.people}
    yield from text_table([*rows, {title: "people, another game", **people}])
    yield ""
    yield f"people: {view.people_source}"
    if view.shared_recipes:
        seen = "it has seen these combinations"
        yield f"note: {view.scorer} was trained on recipes of {view.graph}: {seen}"
        shared = counted(view.shared_recipes, "recipe")
        yield f"      {shared} of {view.graph} in its training"
