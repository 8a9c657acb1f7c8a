"""``wordcraft-kg evaluate-words``."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.config import ATTEMPTS, LOOK_UPS, REFUSALS, TIMEOUT, KnowledgeKind
from wordcraft_kg.base.errors import ConfigError, OutputExistsError, PlayerError
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, aligned, split_labels
from wordcraft_kg.cli.options import Book, Scorer
from wordcraft_kg.envs.config import MAX_ATTEMPTS, WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.apps.text_agents.records import WordsResult, WordsSettings

GROUP = "Players that use words"
EXAMPLES = (
    'wordcraft-kg evaluate-words everyday --player "python examples/line_player.py"',
    'wordcraft-kg evaluate-words everyday --player "python my_player.py" --distractors 8 --knowledge partial',
    'wordcraft-kg evaluate-words everyday --player "python my_player.py" --open-ended --attempts 100',
)
LONGEST_NAME = 100


def evaluate_words(
    graph: Book = "everyday",
    *,
    player: str,
    part: TaskPart = "test",
    depth: int = WordCraftConfig.depth,
    distractors: int = WordCraftConfig.num_distractors,
    attempts: int | None = None,
    draws: int = 1,
    tasks: int | None = None,
    open_ended: Flag = False,
    base: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    knowledge: KnowledgeKind = "none",
    scorer: Scorer = None,
    look_ups: int = LOOK_UPS,
    refusals: int = REFUSALS,
    timeout: float = TIMEOUT,
    name: str | None = None,
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Let a program that reads a line and writes a line play all tasks of a part, at the tables of the agents.

    It reads a JSON object a line (text, goal, table, attempts_left, game, new) and answers with the two things to
    combine, such as: water + earth. Games are saved one by one; the same command goes on where it stopped.

    Args:
        graph: graph folder, recipe book or known book's name.
        player: command that starts the program, such as "python my_player.py"; no shell is asked.
        part: tasks to play: train, valid, test or all.
        depth: fewest attempts that solve a task, 1 to 5.
        distractors: entities on the table that no plan needs.
        attempts: attempts in a game. Default: depth; 100 in the open-ended world.
        draws: draws of distractors for each task; with --open-ended the number of games.
        tasks: the most tasks to play, evenly spaced over the part. Default: all.
        open_ended: no tasks: discover as many entities as you can from the base.
        base: comma-separated entities known at the start of the open-ended world. Default: the graph's base.
        knowledge: what the program may look up with "look up water": none, partial (the train recipes, but none that
            solves the task) or scorer (the best links of --scorer).
        scorer: model folder, for --knowledge scorer.
        look_ups: how often it may look something up in a game.
        refusals: how often in a row an answer that is not understood costs nothing; the next costs the attempt.
        timeout: seconds for an answer.
        name: what results call the player. Default: the name of its script or program.
        out: folder for the games and the result. Default: words/<name>.
        force: forget the games that are in the folder, and begin anew.
    """
    from wordcraft_kg.apps.text_agents.games import DiscoveryGames, TaskGames
    from wordcraft_kg.apps.text_agents.knowledge import open_knowledge
    from wordcraft_kg.apps.text_agents.line_player import LinePlayer
    from wordcraft_kg.apps.text_agents.playing import play_tasks, play_worlds
    from wordcraft_kg.apps.text_agents.records import WordsSettings
    from wordcraft_kg.apps.text_agents.view import WordsView
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.graphs.folder import open_graph

    if open_ended and (part, depth, distractors, tasks) != ("test", 1, WordCraftConfig.num_distractors, None):
        raise ConfigError("--open-ended has no tasks; of these options, it takes attempts, base and draws.")
    if base and not open_ended:
        raise ConfigError(f"--base {','.join(base)}: tasks have no base; add --open-ended.")
    if attempts is not None:
        whole("attempts", attempts, *((1, MAX_SIZE) if open_ended else (depth, MAX_ATTEMPTS)))
    if name is not None and (not name.strip() or not name.isprintable() or len(name) > LONGEST_NAME):
        raise ConfigError(f"--name {name[:LONGEST_NAME]!r}: expected 1 to {LONGEST_NAME} characters on one line.")
    opened = open_graph(graph)
    known, scorer_hash, kg = open_knowledge(knowledge, opened, scorer)
    rules = {
        "draws": whole("draws", draws, 1, MAX_SIZE),
        "knowledge": knowledge,
        "scorer": scorer_hash,
        "kg": kg,
        "look_ups": whole("look_ups", look_ups, 0, MAX_SIZE),
        "refusals": whole("refusals", refusals, 0, MAX_SIZE),
    }
    with LinePlayer(player, timeout=timeout) as program:
        called = name or program.name
        # A model's name may hold a slash; it names one folder all the same, and none elsewhere.
        folder = out or Path("words") / (re.sub(r"[^\w.+ -]", "-", called).strip(". ") or "player")
        try:
            if open_ended:
                labels = split_labels(base) if base else None
                worlds = DiscoveryGames(opened, attempts=ATTEMPTS if attempts is None else attempts, base=labels)
                settings = WordsSettings.of_world(worlds.env, opened.split, **rules)
                _prepare(folder, force)
                result = play_worlds(called, program.speaker, worlds, settings, folder, known)
            else:
                config = WordCraftConfig(part=part, depth=depth, num_distractors=distractors, max_attempts=attempts)
                games = TaskGames(World(opened, config))
                most = None if tasks is None else whole("tasks", tasks, 1, MAX_SIZE)
                settings = WordsSettings.of_tasks(games.world, tasks=most, **rules)
                _prepare(folder, force)
                result = play_tasks(called, program.speaker, games, settings, folder, known)
        except KeyboardInterrupt:
            kept = f"interrupted; the games so far are in {folder}, the same command goes on"
            raise KeyboardInterrupt(kept) from None
        except PlayerError as error:
            kept = f" The games so far are in {folder}; the same command goes on." if folder.is_dir() else ""
            raise PlayerError(f"{error}{kept}") from None
    output.result(WordsView(result, str(folder)), _text(result, graph, folder))


def _prepare(folder: Path, force: bool) -> None:
    """Refuse a folder of something else, and forget the games of one if that is wanted."""
    from wordcraft_kg.apps.text_agents.records import GAMES_FILE, RESULT_FILE
    from wordcraft_kg.runs.folder import locked

    if folder.exists() and not folder.is_dir():
        raise OutputExistsError(f"'{folder}' is a file, but the output is a folder. Choose another --out.")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / GAMES_FILE).is_file():
        raise OutputExistsError(f"'{folder}' exists and holds no {GAMES_FILE}; it is left alone. Choose another --out.")
    if force and folder.is_dir():
        with locked(folder, "written"):
            for name in (RESULT_FILE, GAMES_FILE):
                (folder / name).unlink(missing_ok=True)


def _text(result: "WordsResult", graph: str, folder: Path) -> Iterator[str]:
    settings = result.settings
    rows = [("player", result.player)]
    if result.success is not None:
        found = result.success
        tasks = f"{counted(found.tasks, f'{settings.part} task')} of depth {settings.depth}"
        distractors = counted(settings.distractors or 0, "distractor")
        endings = (f"{ending.replace('_', ' ')} {share:.1%}" for ending, share in result.outcomes.items())
        rows += [
            ("success", f"{found.mean:.3f} [{found.ci_low:.3f}, {found.ci_high:.3f}]   by plan {found.by_plan:.3f}"),
            ("over", f"{tasks}, {distractors}, {counted(found.draws, 'draw')} each"),
            ("endings", ", ".join(endings)),
        ]
    else:
        known = ", ".join(f"{number:g} after {mark}" for mark, number in result.known.items())
        rows += [("known", f"{known} attempts"), ("over", counted(result.games, "game"))]
    said = f"{result.refused:,} not understood, {counted(result.lost, 'attempt')} lost by them"
    rows.append(("answers", said))
    if settings.knowledge != "none":
        rows.append(("looked up", f"{counted(result.look_ups, 'thing')} ({settings.knowledge})"))
    yield from aligned(rows)
    if settings.kg == "full":
        yield "the scorer was trained on all recipes: it remembers the answers."
    yield f"wrote {folder}/   next: wordcraft-kg reference {graph} {_beside(settings)} --beside {folder}"


def _beside(settings: "WordsSettings") -> str:
    """Return the options of `reference` that show what was played."""
    if settings.is_open_ended:
        return f"--open-ended --base {shlex.quote(','.join(settings.base))}"
    options = f"--part {settings.part} --depth {settings.depth} --distractors {settings.distractors}"
    return options + (f" --attempts {settings.attempts}" if settings.attempts != settings.depth else "")
