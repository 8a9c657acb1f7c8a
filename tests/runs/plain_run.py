"""The least that can be trained in a run folder. As a script: begin to replace a run, and die before a checkpoint."""

import os
import signal
import sys
from pathlib import Path

from wordcraft_kg.runs.config_file import RunConfig
from wordcraft_kg.runs.folder import RunKind, new_run

PLAIN = RunKind(("train-agent",), "agent", unit="step", progress=dict[str, int])


class Settings(RunConfig):
    """The least settings."""

    commands = ("train-agent",)


def train(out: Path, result: str, *, force: bool = False) -> None:
    """A training whose result is a word; it fails without one, before its first checkpoint."""
    with new_run(out, PLAIN, force=force) as run:
        run.begin(Settings("kitchen"), inputs={})
        if not result:
            raise RuntimeError("no more")
        (run.path / "result").write_text(result)
        run.finish(("result",), card="")


if __name__ == "__main__":
    with new_run(Path(sys.argv[1]), PLAIN, force=True) as run:
        run.begin(Settings("kitchen"), inputs={})
        os.kill(os.getpid(), signal.SIGKILL)
