"""The least that can be trained in a run folder. As a script: begin a run, and die at a moment."""

import os
import signal
import sys
from pathlib import Path

from wordcraft_kg.runs.config_file import RunConfig
from wordcraft_kg.runs.run_folder import RunKind, new_run

PLAIN = RunKind(("train-agent",), "agent", unit="step", progress=dict[str, int])


class Settings(RunConfig):
    """The least settings."""

    commands = ("train-agent",)


def train(out, result, *, force=False):
    """A training whose result is a word; it fails without one, before its first checkpoint."""
    with new_run(out, PLAIN, force=force) as run:
        run.begin(Settings("kitchen"), inputs={})
        if not result:
            raise RuntimeError("no more")
        (run.path / "result").write_text(result)
        run.finish(("result",), card="")


def die(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    moment, out = sys.argv[1:]
    if moment == "before the first file":
        os.open = die  # the folder is made, and not locked yet
    with new_run(Path(out), PLAIN, force=moment == "before the first checkpoint") as run:
        if moment == "while the first file is written":
            os.replace = die
        run.begin(Settings("kitchen"), inputs={})
        die()
