"""Compare a fine-tuned language model with other players of the leaderboard, game by game.

    python benchmarks/finetuned.py tuned/training.json --json FILE [--also "NAME=SUBMISSION" ...]

All submissions are verified by replay. A difference is the tuned model's success minus the other
player's on the same tasks; its interval resamples the recipes or goals that the split holds out
together.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.apps.text_agents.results import GAMES_FILE
from wordcraft_kg.apps.text_agents.submission import (
    GameLine,
    Submission,
    read_submission_file,
    submissions_at,
    verify,
)
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.records import parse_lines
from wordcraft_kg.base.statistics import paired_difference

LEADERBOARD = Path(__file__).parents[1] / "leaderboard" / "everyday-v3"
TRACKS = ("craft-8-lite", "goal-8-lite", "craft-1-lite")
TUNED = "smollm2-tuned-recipes"
BEFORE = {
    "smollm2-reinforced-constrained": "smollm2-tuned-chats-constrained",
}
"""Rows of a model after GRPO, and of the same model before it."""
PLAYERS = {
    TUNED: "SmolLM2-135M, fine-tuned on recipes, by recipes",
    "smollm2-recipes": "SmolLM2-135M, untuned, by recipes",
    "smollm2-tuned-chats-constrained": "SmolLM2-135M, fine-tuned on recipes and games, constrained",
    "smollm2-reinforced-constrained": "SmolLM2-135M, fine-tuned on recipes and games, then GRPO, constrained",
    "scorer-minilm": "recipe scorer, MiniLM",
    "scorer-glove": "recipe scorer, GloVe",
    "complex": "ComplEx, u+v",
    "nearest-words": "nearest words",
    "votes": "votes of the train recipes",
    "random": "chance",
}
"""Rows of the leaderboard, and the players' names on the page."""


def verified(path: Path) -> tuple[Submission, list[GameLine]]:
    """Return a verified submission with its games."""
    submission = verify(path)
    return submission, parse_lines(read_submission_file(path, GAMES_FILE), GameLine, path)


def row(
    name: str,
    submission: Submission,
    games: list[GameLine],
    tuned: list[GameLine],
    *,
    is_on_leaderboard: bool = True,
) -> dict[str, Any]:
    """Return a player's figures on a track, and the difference of the tuned model to it."""
    success, other = (np.array([[line.success] for line in of], float) for of in (tuned, games))
    groups = open_track(submission.track).world.groups
    difference = paired_difference(success, other, groups)
    return {
        "track": submission.track,
        "player": name,
        "is_on_leaderboard": is_on_leaderboard,
        "success": submission.figures.mean,
        "interval": [submission.figures.ci_low, submission.figures.ci_high],
        "difference": [round(float(value), 4) for value in difference],
        "games": submission.figures.games,
        "invalid": submission.invalid_actions,
        "weights": submission.weights,
        "prompts": submission.prompt_hash,
        "tokens": submission.tokens,
        "seconds": submission.seconds,
    }


def main() -> None:
    """Write the rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("training", type=Path, help="training.json of the tuned model")
    parser.add_argument("--json", type=Path, required=True, help="file to write")
    parser.add_argument(
        "--also", action="append", default=[], metavar="NAME=SUBMISSION", help="another submission"
    )
    options = parser.parse_args()
    training = json.loads(options.training.read_text(encoding="utf-8"))
    of_track: dict[str, list[GameLine]] = {}
    # A language model has the same weights on all tracks, and constrained as by generation.
    weights_of = {TUNED: training["weights"]}
    rows = []
    for track in TRACKS:
        archive = LEADERBOARD / f"{track}.zip"
        on_track = {path.name: path for path in submissions_at(archive)}
        for player, name in PLAYERS.items():
            path = on_track.get(player)
            if path is None:
                continue
            submission, games = verified(path)
            model = player.removesuffix("-constrained")
            # A recipe scorer is trained anew for each split.
            is_one = model.startswith("smollm2")
            if is_one and submission.weights != weights_of.setdefault(model, submission.weights):
                parser.error(f"{path} was played with other weights than {weights_of[model]}")
            if player == TUNED:
                of_track[track] = games
            made = row(name, submission, games, of_track[track])
            if player in BEFORE:
                _, before = verified(on_track[BEFORE[player]])
                # The games of the last argument minus those before it: after minus before.
                gain = row(name, submission, before, games)["difference"]
                made["gain_by_reinforcement"] = gain
            rows.append(made)
    for name, _, folder in (also.partition("=") for also in options.also):
        submission, games = verified(Path(folder))
        tuned = of_track[submission.track]
        rows.append(row(name, submission, games, tuned, is_on_leaderboard=False))
    text = ",\n".join(json.dumps(one) for one in [training, *rows])
    write_atomically(options.json, f"[\n{text}\n]\n")
    for one in rows:
        print(one["track"], one["player"], one["success"], one["interval"], one["difference"])


if __name__ == "__main__":
    main()
