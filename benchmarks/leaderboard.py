"""Train the players of the leaderboard, let them play, and pack all rows into one archive.

    python benchmarks/leaderboard.py FOLDER [--out leaderboard/everyday-v3]

Models and runs that FOLDER has already are used as they are, and so are its submissions, in
``rows/TRACK/NAME``: put submissions of others there. Rows of the archive that FOLDER lacks stay.
About 10 minutes of CPU time.
"""

import argparse
import subprocess
import zipfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path

from wordcraft_kg.apps.text_agents.commands.bench import bench_run
from wordcraft_kg.apps.text_agents.results import GAMES_FILE
from wordcraft_kg.apps.text_agents.submission import (
    ARCHIVE,
    SUBMISSION_FILE,
    read_submission_file,
    submissions_at,
)

STEPS = 350_000
AGENT = f"--steps {STEPS} --eval-every 0"
DEEP = f"{AGENT} --depth 2 --distractors 4"
MODELS = {
    "by-recipe": "build-graph everyday",
    "by-goal": "build-graph everyday --split by-goal",
    "made-up": "build-graph made-up:everyday",
    "no-words": "train-recipes {made-up} --features one-hot",
    "pairs-1": f"train-agent {{by-recipe}} --distractors 1 {AGENT}",
    "none-deep": f"train-agent {{by-recipe}} {DEEP}",
}
"""Commands by the folder that they write; names in braces are folders, too."""
for split in ("by-recipe", "by-goal"):
    MODELS |= {
        f"glove-{split}": f"train-recipes {{{split}}} --features glove",
        f"minilm-{split}": f"train-recipes {{{split}}} --features minilm",
        f"complex-{split}": f"train-complex {{{split}}}",
        f"pairs-{split}": f"train-agent {{{split}}} {AGENT}",
        f"uv-{split}": f"train-agent {{{split}}} --scorer {{complex-{split}}} --use u,v {AGENT}",
        f"uvw-{split}": f"train-agent {{{split}}} --scorer {{minilm-{split}}} --use u,v,w {AGENT}",
    }
MODELS |= {
    "uv-deep": f"train-agent {{by-recipe}} --scorer {{complex-by-recipe}} --use u,v {DEEP}",
    "uvw-deep": f"train-agent {{by-recipe}} --scorer {{minilm-by-recipe}} --use u,v,w {DEEP}",
}
TASKS = ("craft-8", "craft-1", "goal-8", "depth-2")
DISCOVERY = "discover-500"
EACH = ("", "-lite", "-lite-made-up")

MINILM = "recipe scorer, MiniLM"
GLOVE = "recipe scorer, GloVe"
COMPLEX = "ComplEx, u+v"
AGENTS = (
    ("craft-8", "pairs", "pairs-by-recipe", "pair learner, no graph"),
    ("craft-8", "agent-uv", "uv-by-recipe", "agent, u v by ComplEx"),
    ("craft-8", "agent-uvw", "uvw-by-recipe", "agent, u v w"),
    ("craft-1", "pairs", "pairs-1", "pair learner, no graph"),
    ("craft-1", "agent-uvw", "uvw-by-recipe", "agent, u v w"),
    ("goal-8", "pairs", "pairs-by-goal", "pair learner, no graph"),
    ("goal-8", "agent-uv", "uv-by-goal", "agent, u v by ComplEx"),
    ("goal-8", "agent-uvw", "uvw-by-goal", "agent, u v w"),
    ("depth-2", "pairs", "none-deep", "pair learner, no graph"),
    ("depth-2", "agent-uv", "uv-deep", "agent, u v by ComplEx"),
    ("depth-2", "agent-uvw", "uvw-deep", "agent, u v w"),
)
"""Track, name of the row, run folder and title of each agent."""


def rows() -> Iterator[tuple[str, str, str, str | None]]:
    """Yield track, name, player and title of each row; None for the player's own title."""
    scripted = [(name, ("random", "nearest-words", "oracle", "votes", "graph")) for name in TASKS]
    scripted.append((DISCOVERY, ("random", "nearest-words", "oracle")))
    for track, players in scripted:
        for player, ending in product(players, EACH):
            yield track + ending, player, player, None
    for track in TASKS:
        split = "by-goal" if track == "goal-8" else "by-recipe"
        for name in (track, f"{track}-lite"):
            yield name, "words-glove", "words:glove", None
            yield name, "scorer-minilm", f"scorer:{{minilm-{split}}}", MINILM
            yield name, "planner-minilm", f"planner:{{minilm-{split}}}", f"planner, {MINILM}"
        name = f"{track}-lite"
        yield name, "scorer-glove", f"scorer:{{glove-{split}}}", GLOVE
        yield name, "planner-glove", f"planner:{{glove-{split}}}", f"planner, {GLOVE}"
        yield name, "complex", f"scorer:{{complex-{split}}}", COMPLEX
    yield "craft-8-lite-made-up", "scorer-no-words", "scorer:{no-words}", "recipe scorer, no words"
    yield DISCOVERY, "scorer-minilm", "scorer:{minilm-by-recipe}", MINILM
    name = f"{DISCOVERY}-lite"
    yield name, "scorer-minilm", "scorer:{minilm-by-recipe}", MINILM
    yield name, "scorer-glove", "scorer:{glove-by-recipe}", GLOVE
    for track, row, run, title in AGENTS:
        for name in (track, f"{track}-lite"):
            yield name, row, f"agent:{{{run}}}", f"{title}, {STEPS:,} steps"


def pack(folders: Path, archive: Path) -> None:
    """Write ``TRACK/NAME`` below a folder, with those that the archive has already, into the archive."""
    names = (SUBMISSION_FILE, GAMES_FILE)
    members: dict[str, bytes] = {}
    for source in (archive, folders):
        for submission in submissions_at(source) if source.exists() else ():
            for name in names:
                data = read_submission_file(submission, name)
                members[f"{submission.parent.name}/{submission.name}/{name}"] = data
    archive.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(archive, "w") as packed:
        for name in sorted(members):
            # Without the time, so that equal rows are equal bytes.
            packed.writestr(zipfile.ZipInfo(name), members[name], zipfile.ZIP_DEFLATED, 9)


def main() -> None:
    """Train, play and pack."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("leaderboard/everyday-v3"))
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    paths = {name: str(folder / name) for name in MODELS}
    for name, command in MODELS.items():
        if not (folder / name).exists():
            words = [word.format_map(paths) for word in command.split()]
            subprocess.run(["wordcraft-kg", *words, "--out", paths[name], "-q"], check=True)
    for track, row, player, title in rows():
        out = folder / "rows" / track / row
        if not out.exists():
            licence = "Apache-2.0"
            bench_run(track, player=player.format_map(paths), out=out, name=title, licence=licence)
    pack(folder / "rows", arguments.out / f"submissions{ARCHIVE}")


if __name__ == "__main__":
    main()
