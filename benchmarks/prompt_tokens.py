"""Count the prompts and tokens of a language model that plays each track of the benchmark and
always answers in a line.

    python benchmarks/prompt_tokens.py SmolLM2-135M-Instruct.Q4_1.gguf

Every answer is a random pair by name, after a look-up of the goal (else of the first item) in the
second row of each track. Each prompt sends the whole conversation of the game. The last column has
the rules and the last message alone, which is enough to play.
"""

import argparse
from pathlib import Path

import numpy as np
from transformers import AutoTokenizer

from wordcraft_kg.apps.elicitation.foreign_code import check_model_files
from wordcraft_kg.apps.text_agents.benchmark import open_track, read_manifest
from wordcraft_kg.cli.console import aligned

AROUND = 5
"""Tokens around a message in the chat template."""


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path, help="model folder or .gguf file")
    path = parser.parse_args().model
    check_model_files(path)
    where, options = (path.parent, {"gguf_file": path.name}) if path.is_file() else (path, {})
    tokenizer = AutoTokenizer.from_pretrained(where, trust_remote_code=False, **options)
    rows = [("track", "look-ups", "prompts", "input", "output", "input, last message alone")]
    for name in (track + lite for track in read_manifest()[0].tracks for lite in ("", "-lite")):
        for look_ups in ("none", "partial"):
            rows.append(
                (name, look_ups, *(f"{count:,}" for count in counted(name, look_ups, tokenizer)))
            )
    print("\n".join(aligned(rows)))


def counted(name: str, look_ups: str, tokenizer) -> np.ndarray:
    """Return the numbers of prompts, input tokens, output tokens, and input tokens without earlier
    messages."""

    def tokens(text: str) -> int:
        return len(tokenizer(text, add_special_tokens=False).input_ids)

    track = open_track(name)
    play, rng, counts = track.play(look_ups), np.random.default_rng(0), np.zeros(4, dtype=np.int64)
    for number in range(len(track)):
        talk = play.begin(0, number) if track.is_open_ended else play.begin(number)
        rules = whole = tokens(talk.rules) + AROUND
        prompt, answer = talk.game.state, f"look up {talk.game.goal or talk.game.labels[0]}"
        is_asked = look_ups == "none"
        while not talk.is_over:
            if is_asked:
                answer = " + ".join(rng.choice(talk.game.labels, 2))
            is_asked, last, said = True, tokens(prompt) + AROUND, tokens(answer)
            whole += last
            counts += 1, whole, said, rules + last
            whole += said + AROUND
            prompt = talk.hear(answer)
    return counts


if __name__ == "__main__":
    main()
