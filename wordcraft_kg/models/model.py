"""Trained models: scorer with training graph, settings and history.

The page docs/architecture.md places it: rule 4, a single type of trained model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from wordcraft_kg.base import GraphMismatchError, Record
from wordcraft_kg.graphs import (
    Ids,
    OpenedGraph,
    TrainedOn,
    TrainSample,
    describe_train_sample,
    draw_train_sample,
    is_subsample,
)
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.models.scorers.scorer_folder import WEIGHTS
from wordcraft_kg.runs.config_file import RunConfig
from wordcraft_kg.runs.record import RunRecord


@dataclass(frozen=True)
class History:
    """Training history: settings and metrics from a model folder.

    Attributes:
        config: settings; ``kg``, ``train_fraction``, ``label_noise`` and ``seed`` have the same
            meaning for all models.
        facts: facts for a report, by name.
        metrics: training metrics; None for a scorer saved by ``save_scorer``.
        trace: a record per epoch; empty for models without epochs.
        chosen: names of settings chosen by the training, which may differ between seeds.
        is_trained: whether this package trained the model; False for a scorer saved by
            ``save_scorer``.
        made_by_other_books: labels of the graph's entities that a recipe of another book in the
            training makes; None without another book.
    """

    config: RunConfig
    facts: Mapping[str, str] = field(default_factory=dict)
    metrics: Record | None = None
    trace: Sequence[Any] = ()
    chosen: tuple[str, ...] = ()
    is_trained: bool = True
    made_by_other_books: frozenset[str] | None = None


@dataclass(frozen=True)
class Model:
    """A trained model with all data for an evaluation.

    Attributes:
        scorer: scorer from the model folder; if the folder holds models for folds, a cross-fitted
            scorer.
        opened: training graph and split, checked by hash.
        run: run record, the content of ``run.json``.
        history: training settings and metrics.
    """

    scorer: Scorer
    opened: OpenedGraph
    run: RunRecord
    history: History

    @property
    def metrics(self) -> Record | None:
        """Training metrics; None for a model that this package did not train."""
        return self.history.metrics

    @property
    def settings(self) -> dict[str, Any]:
        """All training settings by name, without the graph and None values."""
        values = self.history.config.values()
        return {name: value for name, value in values.items() if name != "graph"}

    @property
    def kg(self) -> TrainedOn:
        """Training recipes: ``partial`` (train recipes), ``full`` (all recipes) or ``none``."""
        kg: TrainedOn = self.settings.get("kg", "none")
        return kg

    @property
    def seed(self) -> int | None:
        """Training seed; None for a model that this package did not train."""
        return self.settings.get("seed") if self.history.is_trained else None

    @property
    def comparable_settings(self) -> dict[str, Any]:
        """Settings that models with different seeds share.

        These are all settings but the seed and those chosen by the training.
        """
        left_out = set(self.history.chosen)
        if self.history.is_trained:
            left_out.add("seed")
        return {name: value for name, value in self.settings.items() if name not in left_out}

    @property
    def learned_from(self) -> str:
        """Training fraction and label noise in words; empty for all recipes without noise."""
        return describe_train_sample(
            self.settings.get("train_fraction", 1.0), self.settings.get("label_noise", 0.0)
        )

    @cached_property
    def train_sample(self) -> TrainSample:
        """The training recipes, with label noise if any.

        Raises GraphMismatchError if they have another hash than the training recorded.
        """
        split = self.opened.split
        train_fraction = self.settings.get("train_fraction", 1.0)
        label_noise = self.settings.get("label_noise", 0.0)
        # Folds keep their recipes in the folder; other models draw them again from the seed.
        folds = folds_of(self.scorer)
        if folds is not None:
            train_sample = folds.train_sample(split.graph)
        elif is_subsample(train_fraction, label_noise):
            train_sample = draw_train_sample(
                split, train_fraction, label_noise, self.settings["seed"]
            )
        else:
            train_sample = self.opened.train_sample(self.kg)
        # NumPy does not promise that a generator draws the same numbers in every version.
        recorded = self.run.inputs.get("train_sample", train_sample.hash)
        if recorded != train_sample.hash:
            raise GraphMismatchError(
                f"the model was trained on recipes {recorded[:12]}, but `train_fraction` and "
                f"`label_noise` give {train_sample.hash[:12]}. Train the model again with this "
                "NumPy version."
            )
        return train_sample

    @property
    def triples(self) -> Ids:
        """The training recipes' triples, ids of shape (T, 3): head, relation, tail; sorted.

        Raises:
            GraphMismatchError: as for :attr:`train_sample`.
        """
        return self.train_sample.triples

    @property
    def provenance(self) -> dict[str, str]:
        """Facts for a report about training, versions and weights."""
        facts = dict(self.history.facts)
        if self.learned_from:
            facts["learned from"] = self.learned_from
        versions = [f"{name} {number}" for name, number in self.run.versions.items()]
        facts["finished"] = self.run.ended or ""
        facts["versions"] = ", ".join(versions)
        facts["weights"] = self.run.outputs[WEIGHTS]
        return facts


def cross_fitted_words(folds: int, mrr: float | None, in_sample_mrr: float | None) -> str:
    """Return number of folds, out-of-sample MRR and in-sample MRR in words.

    Args:
        folds: number of folds.
        mrr: MRR on train triples by models trained without the triple's fold; None without queries.
        in_sample_mrr: MRR on the same triples by the model trained on all folds; None without
            queries.
    """
    if mrr is None or in_sample_mrr is None:
        return f"{folds} folds"
    return (
        f"{folds} folds, MRR {mrr:.3f} on train triples out-of-sample "
        f"({in_sample_mrr:.3f} in-sample)"
    )
