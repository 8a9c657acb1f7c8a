"""A tracker of one's own: the metrics of two trainings in one CSV file while they run.

Run it in an empty folder: it writes metrics.csv, models/tracked and runs/tracked, in about ten
seconds.
"""

import csv
from collections.abc import Mapping
from pathlib import Path

from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    train_agent,
    train_links,
)


class Table:
    """Appends a row for each metric: run, step, name, value."""

    def __init__(self, path: Path, run: str):
        """Take the file, and what to call the run in it."""
        self.path, self.run = path, run

    def log(self, step: int, values: Mapping[str, float]) -> None:
        """Append the metrics of an epoch or a line of metrics."""
        with self.path.open("a", newline="") as file:
            csv.writer(file).writerows(
                (self.run, step, name, value) for name, value in values.items()
            )

    def close(self, status: str) -> None:
        """Say how the run ended."""
        print(f"{self.run} is {status}")


def main() -> None:
    """Train a link predictor and an agent."""
    path = Path("metrics.csv")
    links = LinksConfig("kitchen", ComplExConfig(dim=16, epochs=10))
    train_links(links, "models/tracked", trackers=[Table(path, "links")], progress=True)
    agent = AgentConfig("kitchen", trainer=ImpalaConfig(steps=40_000, eval_every=20_000))
    train_agent(agent, "runs/tracked", trackers=[Table(path, "agent")], progress=True)
    print(path.read_text().splitlines()[-1])


if __name__ == "__main__":
    main()
