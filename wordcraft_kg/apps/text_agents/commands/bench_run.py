"""``wordcraft-kg bench run``."""

import hashlib
import shutil
import time
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import TIMEOUT, LookUps
from wordcraft_kg.base.artefacts import check_output, read_small_file, what_is
from wordcraft_kg.base.errors import ConfigError, OutputExistsError, PlayerError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.options import Force

GROUP = "Text agents"
EXAMPLES = (
    "wordcraft-kg bench run craft-8-lite --player votes --out submission",
    'wordcraft-kg bench run craft-8-lite --player "program:python examples/line_player.py" --out submission',
    "wordcraft-kg bench run depth-2 --player planner:models/recipes --out submission",
)


def bench_run(
    track: str,
    *,
    player: str,
    out: Path,
    name: str | None = None,
    look_ups: LookUps = "none",
    weights: Path | None = None,
    prompts: Path | None = None,
    training_data: str | None = None,
    licence: str | None = None,
    tokens: Annotated[tuple[int, int] | None, Parameter(negative=())] = None,
    price: float | None = None,
    measured: Flag = False,
    timeout: float = TIMEOUT,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Let a player play a track of the benchmark; write a submission with all games.

    The same player writes the same bytes. Repeat the command to continue an interrupted program. An earlier submission
    stays until the new one is complete.

    Args:
        track: name from `bench list`, such as craft-8-lite.
        player: KIND or KIND:ARGUMENT, see `bench list`, such as random or scorer:models/mine.
        out: folder for submission.json, games.jsonl, and a program's prompts and answers (messages).
        name: player's name in tables.
        look_ups: look-up source for players by text: none, or partial (train recipes).
        weights: file with a text player's weights; the submission holds the hash.
        prompts: file with the prompts, if they differ from the standard prompts; the submission holds the hash.
        training_data: data on which the player was trained, in words.
        licence: licence of the player or its weights.
        tokens: numbers of input and output tokens, if the player has counted them; an Inspect log holds them.
        price: price of the evaluation in US dollars.
        measured: add the date and the duration, which differ between runs.
        timeout: seconds for an answer of a program.
    """
    from wordcraft_kg.apps.text_agents.benchmark import open_track, read_manifest
    from wordcraft_kg.apps.text_agents.benchmark_players import RunSettings, enter
    from wordcraft_kg.apps.text_agents.records import GAMES_FILE
    from wordcraft_kg.apps.text_agents.second_reading import read_again
    from wordcraft_kg.apps.text_agents.submission import (
        LONGEST_NAME,
        LONGEST_TEXT,
        MESSAGES,
        MOST_DOLLARS,
        MOST_TOKENS,
        SUBMISSION_FILE,
        acceptable,
        answers_text,
        check_declared,
        figures_text,
        write_submission,
    )
    from wordcraft_kg.base.settings import number_in
    from wordcraft_kg.runs.interruption import sigterm_as_interrupt

    messages = out / MESSAGES
    is_finished = (out / SUBMISSION_FILE).exists()
    is_program = player.startswith("program:")
    is_replacing = force and (is_finished or (messages / GAMES_FILE).is_file())
    if is_finished or not (is_program and (messages / GAMES_FILE).is_file()):
        check_output(out, force=force)
        if out.is_dir() and not is_finished and any(out.iterdir()):
            raise OutputExistsError(
                f"'{out}' {what_is(out)}, not a submission. Choose another `out`."
            )
    for option, text, most in (
        ("name", name, LONGEST_NAME),
        ("training_data", training_data, LONGEST_TEXT),
        ("licence", licence, LONGEST_NAME),
        ("weights", None if weights is None else weights.name, LONGEST_TEXT),
    ):
        if text is not None:
            check_declared(option, text, most)
    counts = None if tokens is None else dict(zip(("input", "output"), tokens, strict=True))
    for each in tokens or ():
        number_in("tokens", each, 0, MOST_TOKENS, f"two numbers of tokens, 0 to {MOST_TOKENS:,}")
    if price is not None:
        number_in("price", price, 0, MOST_DOLLARS, f"US dollars, 0 to {MOST_DOLLARS:,}")
    own_prompts = None if prompts is None else hashlib.sha256(read_small_file(prompts)).hexdigest()
    opened, begin = open_track(track), time.perf_counter()
    with sigterm_as_interrupt():
        try:
            kind, entrant = enter(
                opened, player, RunSettings(messages, look_ups, timeout, weights, is_replacing)
            )
        except (KeyboardInterrupt, PlayerError) as error:
            why = "interrupted." if isinstance(error, KeyboardInterrupt) else error
            has_games = any(messages.rglob(GAMES_FILE)) and is_program
            kept = " Finished games are kept; to continue, repeat the command." if has_games else ""
            raise type(error)(f"{why}{kept}") from None
    if counts and entrant.tokens is not None:
        raise ConfigError(
            f"`tokens`: the log of '{player[:100]}' has its own numbers. Leave the option out."
        )
    seconds = round(time.perf_counter() - begin, 1)
    is_standard = own_prompts is None and entrant.prompt_hash in (
        None,
        *read_manifest()[0].prompts.values(),
    )
    about: dict[str, Any] = {
        "player": name or acceptable(entrant.name, LONGEST_NAME),
        "kind": kind,
        "weights": dict(entrant.weights),
        "prompts": "custom"
        if not is_standard
        else "none"
        if entrant.prompt_hash is None
        else "standard",
        "prompt_hash": own_prompts or entrant.prompt_hash,
        "training_data": training_data or acceptable(entrant.training_data),
        "tokens": counts if entrant.tokens is None else dict(entrant.tokens),
        "price": price,
        "seconds": seconds if measured else None,
        "date": time.strftime("%Y-%m-%d", time.gmtime()) if measured else None,
        "licence": licence or acceptable(entrant.licence, LONGEST_NAME),
    }
    written, lines = write_submission(out, opened, entrant.games, look_ups, about)
    if not is_program:
        shutil.rmtree(messages, ignore_errors=True)
    games = counted(written.figures.games, "game")
    shown = [f"{track}  {written.player}  {figures_text(written.figures)} over {games}"]
    view: dict[str, Any] = {"out": str(out), "submission": written}
    if written.prompts != "none":
        shown.append(
            f"answers    {answers_text(lines)}, {counted(written.lost_attempts, 'attempt')} lost"
        )
    if entrant.answers:
        play = opened.play(look_ups)
        again = read_again(opened, play, entrant.answers)
        shown += [
            f"grammar {play.settings.answer_grammar}  {figures_text(written.figures)}, the score of this track",
            f"grammar {again.grammar}  {again.text}",
        ]
        view["second_reading"] = {"answer_grammar": again.grammar, "figures": again.figures}
    output.result(view, [*shown, f"wrote {out}/   next: wordcraft-kg bench verify {out}"])
