"""A kind of model of one's own.

It trains, resumes after Ctrl-C, and serves every command that takes a model.

Run it in an empty folder, in a few seconds; repeat it after Ctrl-C. The line at ``MODELS`` is all
that the package has to know. A package of your own has its module imported by an entry point:
[project.entry-points."wordcraft_kg.models"], hubs = "my_package.hubs".
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch

from wordcraft_kg import open_model
from wordcraft_kg.graphs.graph_folder import KG, OpenedGraph
from wordcraft_kg.models.model import History
from wordcraft_kg.models.model_folder import MODELS
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.scorer_folder import write_scorer
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.config_file import RunConfig
from wordcraft_kg.runs.record import RunFiles
from wordcraft_kg.runs.run_folder import Progress, RunFolder, RunKind
from wordcraft_kg.runs.trackers import Log
from wordcraft_kg.runs.training import Training, train


@dataclass(frozen=True)
class HubsConfig(RunConfig):
    """Settings of a model in which each entity has a score as head and as tail of each relation."""

    commands: ClassVar[tuple[str, ...]] = ("train-hubs",)

    kg: KG = "partial"
    epochs: int = 100
    seed: int = 0


class HubsTraining(Training[HubsConfig, int, Path]):
    """Logistic regression on the train triples against random ones.

    A checkpoint's progress is its epoch.
    """

    kind: ClassVar[RunKind[int]] = RunKind(HubsConfig.commands, "hubs", unit="epoch", progress=int)
    config_type = HubsConfig

    def begin(self, run: RunFolder[int], report: Progress | None) -> dict[str, Any]:
        """Record no inputs except the graph and its split."""
        return {}

    def fit(
        self,
        run: RunFolder[int],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[int] | None,
    ) -> Path:
        """Train from the start or from a checkpoint, and write the table of all scores."""
        size, triples = (
            self.opened.graph.num_entities,
            torch.tensor(self.opened.triples(self.config.kg)),
        )
        ends = (
            torch.zeros(2, 2, size) if checkpoint is None else checkpoint.tensors["ends"]
        )  # head or tail, relation
        if checkpoint is not None:
            run.resume(self.config)
        for epoch in range(
            1 if checkpoint is None else checkpoint.number + 1, self.config.epochs + 1
        ):
            generator = torch.Generator().manual_seed(self.config.seed * 1_000_003 + epoch)
            others = torch.randint(size, (len(triples), 2), generator=generator)
            for heads, tails, truth in ((*triples[:, [0, 2]].T, 1.0), (*others.T, 0.0)):
                relations = triples[:, 1]
                wrong = truth - torch.sigmoid(ends[0, relations, heads] + ends[1, relations, tails])
                ends[0].index_put_((relations, heads), 0.1 * wrong, accumulate=True)
                ends[1].index_put_((relations, tails), 0.1 * wrong, accumulate=True)
            run.checkpoints.save(epoch, {"ends": ends}, epoch)
            if report:
                report(epoch, self.config.epochs, {})
            if run.interrupted.is_set() and epoch < self.config.epochs:
                raise KeyboardInterrupt
        write_scorer(
            run.path,
            "table",
            {"scores": ends[0, :, :, None] + ends[1, :, None, :]},
            self.opened.graph,
        )
        run.finish(("model.safetensors", "vocabulary.json"), card="# Hubs\n")
        return run.path

    @classmethod
    def outcome(cls, files: RunFiles) -> Path:
        """Return the folder."""
        return files.folder


def hubs_history(files: RunFiles) -> History:
    """Return how a model was trained."""
    return History(
        HubsConfig.read(files.folder), {"what it is": "how often each entity is head and tail"}
    )


MODELS["train-hubs"] = hubs_history


def unseen_mrr(opened: OpenedGraph, folder: Path) -> float:
    """Return the MRR of the triples that only test recipes have."""
    ranks = rank_triples(
        open_model(folder).scorer, opened.split.held_out("test"), opened.graph.triples
    )
    return mean_reciprocal_rank(ranks)


def main() -> None:
    """Train and evaluate the model with the usual functions."""
    folder = train(HubsTraining, HubsConfig("kitchen"), "models/hubs", keep=True, progress=True)
    model = open_model(folder)
    print(f"{model.kg} graph, MRR of unseen triples {unseen_mrr(model.opened, folder):.3f}")


if __name__ == "__main__":
    main()
