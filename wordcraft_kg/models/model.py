"""A trained model: a scorer with its graph, its settings and its history, whatever made it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from wordcraft_kg.base.errors import GraphMismatchError
from wordcraft_kg.base.records import Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.doses import Dose, dose_words, is_dosed, make_dose
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.models.scorers.folder import WEIGHTS
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.runs.config_file import RunConfig
from wordcraft_kg.runs.record import RunRecord


@dataclass(frozen=True)
class History:
    """How a model came about, as the files of its folder tell.

    Attributes:
        config: its settings; ``kg``, ``share``, ``noise`` and ``seed`` mean the same for all models.
        facts: facts for a report, by name.
        metrics: figures of its training, if it has any.
        trace: a record for each epoch.
        chosen: names of settings that the training chose itself; they may differ between seeds.
        is_trained: whether it was trained here.
    """

    config: RunConfig
    facts: Mapping[str, str] = field(default_factory=dict)
    metrics: Record | None = None
    trace: Sequence[Any] = ()
    chosen: tuple[str, ...] = ()
    is_trained: bool = True


@dataclass(frozen=True)
class Model:
    """A model with everything that its evaluation needs.

    Attributes:
        scorer: the scorer of the folder, cross-fitted if it has folds.
        opened: the graph and split that it was trained on, checked by hash.
        run: its ``run.json``.
        history: how it came about.
    """

    scorer: Scorer
    opened: OpenedGraph
    run: RunRecord
    history: History

    @property
    def metrics(self) -> Record | None:
        """Figures of its training; None if it was not trained here."""
        return self.history.metrics

    @property
    def trace(self) -> Sequence[Any]:
        """A record for each epoch, with ``epoch`` and ``loss``; empty without epochs."""
        return self.history.trace

    @property
    def settings(self) -> dict[str, Any]:
        """The settings by name, without the graph and those that are None."""
        return {name: value for name, value in self.history.config.values().items() if name != "graph"}

    @property
    def kg(self) -> Taught:
        """What it was trained on: ``partial``, ``full``, or ``none`` of the recipes."""
        kg: Taught = self.settings.get("kg", "none")
        return kg

    @property
    def seed(self) -> int | None:
        """The seed of its training; None if it was not trained here."""
        return self.settings.get("seed") if self.history.is_trained else None

    @property
    def asked_for(self) -> dict[str, Any]:
        """The settings that were asked for: without the seed of a training, and without what it chose itself."""
        left_out = {*self.history.chosen, *(("seed",) if self.history.is_trained else ())}
        return {name: value for name, value in self.settings.items() if name not in left_out}

    @property
    def learned_from(self) -> str:
        """The share and the noise of the recipes that it was trained on, in words; empty for all as they are."""
        return dose_words(self.settings.get("share", 1.0), self.settings.get("noise", 0.0))

    @cached_property
    def dose(self) -> Dose:
        """The recipes that it was trained on, as they were taught.

        Raises:
            GraphMismatchError: if they cannot be told: they are drawn again here, and are not those of the training.
        """
        split = self.opened.split
        share, noise = self.settings.get("share", 1.0), self.settings.get("noise", 0.0)
        if (folds := self.scorer.folds) is not None:
            found = folds.dose(split.graph)
        elif is_dosed(share, noise):
            found = make_dose(split, share, noise, self.settings["seed"])
        else:
            found = self.opened.dose(self.kg)
        if self.run.inputs.get("dose", found.hash) != found.hash:
            raise GraphMismatchError(
                f"the model was trained on the recipes {self.run.inputs['dose'][:12]}, but `share` and `noise` give "
                f"{found.hash[:12]}. Train it again with this version of NumPy."
            )
        return found

    @property
    def triples(self) -> Ids:
        """The triples that it was trained on, shape (T, 3), sorted."""
        return self.dose.triples

    @property
    def observed(self) -> Ids:
        """The triples that it holds to be true, shape (T, 3): its scorer's own, or those of its training."""
        observed = self.scorer.observed
        return self.triples if observed is None else observed

    @property
    def provenance(self) -> dict[str, str]:
        """Facts for a report."""
        return {
            **self.history.facts,
            **({"learned from": self.learned_from} if self.learned_from else {}),
            "finished": self.run.ended or "",
            "versions": ", ".join(f"{name} {number}" for name, number in self.run.versions.items()),
            "weights": self.run.outputs[WEIGHTS],
        }


def cross_fitted_words(folds: int, mrr: float | None, in_sample_mrr: float | None) -> str:
    """Return how well the models of the folds do, for a report."""
    if mrr is None or in_sample_mrr is None:
        return f"{folds} folds"
    return (
        f"{folds} folds, MRR {mrr:.3f} on train triples left out of training "
        f"({in_sample_mrr:.3f} where they were in it)"
    )
