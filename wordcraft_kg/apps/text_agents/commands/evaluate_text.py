"""``wordcraft-kg evaluate-text``."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import TIMEOUT, EvaluationSettings
from wordcraft_kg.base.errors import OutputExistsError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.cli.options import Book, Force

if TYPE_CHECKING:
    from wordcraft_kg.apps.text_agents.records import TextResult

GROUP = "Text agents"
EXAMPLES = (
    'wordcraft-kg evaluate-text everyday --player "python examples/line_player.py"',
    'wordcraft-kg evaluate-text everyday --player "python my_player.py" --distractors 8 '
    "--knowledge partial",
    'wordcraft-kg evaluate-text everyday --player "python my_player.py" --open-ended '
    "--attempts 100",
)


def evaluate_text(
    graph: Book = "everyday",
    *,
    player: str,
    settings: Annotated[
        EvaluationSettings, Parameter(name="*", group="Games")
    ] = EvaluationSettings(),
    timeout: float = TIMEOUT,
    name: str | None = None,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Evaluate a program that plays by text, on the tasks and tables for agents.

    For each JSON object on stdin (a line with text, goal, table, attempts_left, game, new), the
    program writes a line with two items to combine, such as: water + earth. A JSON string holds an
    answer of several lines. Repeat the command to continue an interrupted evaluation.

    Args:
        graph: graph folder, recipe book or known book's name.
        player: the program's command line, such as "python my_player.py"; runs without a shell.
        settings: the games.
        timeout: seconds for an answer.
        name: player's name in results. Default: script or program name.
        out: folder for the games. Default: text-agents/<name>.
    """
    from wordcraft_kg.apps.text_agents.conversation import Play
    from wordcraft_kg.apps.text_agents.line_player import LinePlayer
    from wordcraft_kg.apps.text_agents.records import GAMES_FILE
    from wordcraft_kg.apps.text_agents.results import continuable, play_program
    from wordcraft_kg.base.settings import one_line

    if name is not None:
        one_line("name", name, 100)
    # The games first: a wrong setting must not start a program that loads a model.
    play = Play.open(graph, settings)
    with LinePlayer(player, timeout=timeout) as program:
        called = name or program.name
        # A name may hold separators or `..`; the folder is always one below text-agents.
        file_name = re.sub(r"[^\w.+ -]", "-", called).strip(". ") or "player"
        folder = out or Path("text-agents") / file_name
        _check(folder)
        is_replacing = force and (folder / GAMES_FILE).is_file()
        with continuable(folder):
            result = play_program(program, called, play, folder, is_replacing=is_replacing)
    output.result({"result": result, "out": str(folder)}, _text(result, folder))


def _check(folder: Path) -> None:
    """Raise an OutputExistsError for a file, and for a folder with other files than games."""
    from wordcraft_kg.apps.text_agents.records import GAMES_FILE
    from wordcraft_kg.base.artefacts import output_target

    # A link that leads nowhere is refused before the games.
    output_target(folder)
    if folder.exists() and not folder.is_dir():
        raise OutputExistsError(f"'{folder}' is a file; expected a folder. Choose another --out.")
    # Games are continued or replaced there; other files are none of this command's.
    if folder.is_dir() and any(folder.iterdir()) and not (folder / GAMES_FILE).is_file():
        raise OutputExistsError(
            f"'{folder}' exists without {GAMES_FILE}; nothing was changed. Choose another --out."
        )


def _text(result: "TextResult", folder: Path) -> Iterator[str]:
    settings = result.settings
    rows = [("player", result.player), *_metrics(result)]
    invalid = counted(result.invalid_actions, "invalid action")
    rows.append(("answers", f"{invalid}, {counted(result.lost_attempts, 'attempt')} lost"))
    if settings.knowledge != "none":
        rows.append(("look-ups", f"{result.look_ups:,} ({settings.knowledge})"))
    yield from aligned(rows)
    # Such a scorer answers from memory; the result says nothing about new recipes.
    if settings.kg == "full":
        yield "the scorer was trained on all recipes, including the test recipes."
    yield f"wrote {folder}/"


def _metrics(result: "TextResult") -> list[tuple[str, str]]:
    """Return the metrics as rows of a label and a text."""
    settings = result.settings
    success = result.success
    if success is None:
        known = ", ".join(f"{number:g} after {mark}" for mark, number in result.known.items())
        return [("known", f"{known} attempts"), ("over", counted(result.games, "game"))]
    tasks = f"{counted(success.tasks, f'{settings.part} task')} of depth {settings.depth}"
    distractors = counted(settings.distractors or 0, "distractor")
    terminations = (
        f"{termination.replace('_', ' ')} {share:.1%}"
        for termination, share in result.outcomes.items()
    )
    interval = f"[{success.ci_low:.3f}, {success.ci_high:.3f}]"
    seeds = counted(success.distractor_seeds, "distractor seed")
    return [
        ("success", f"{success.mean:.3f} {interval}   by plan {success.by_plan:.3f}"),
        ("over", f"{tasks}, {distractors}, {seeds} each"),
        ("terminations", ", ".join(terminations)),
    ]
