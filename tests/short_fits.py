"""Fits of recipe scorers that take a few steps, for tests that do not ask how good they are."""

from contextlib import contextmanager

import numpy as np
import pytest
import torch

from wordcraft_kg.models.knowledge.books import Words
from wordcraft_kg.models.policies.sources.registry import make_sources, source_class
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.recipes import fitting
from wordcraft_kg.models.recipes.committee import TABLES, fit_committee
from wordcraft_kg.models.scorers import probabilities
from wordcraft_kg.models.scorers.features import EntityFeatures


@contextmanager
def short_fits():
    """Train with few examples, few steps and a rough curve of probabilities."""

    def fit(examples, generator, schedule=TABLES):
        return fit_committee(examples, generator, schedule._replace(epochs=1, steps=4))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "fit_committee", fit)
        patch.setattr(fitting, "DRAWS", (1, 1))
        patch.setattr(probabilities, "SAMPLED", 48)
        yield


def words_of(vectors):
    """Knowledge of words whose vectors are drawn."""
    known = np.ones(len(vectors), dtype=bool)
    return Words.of(EntityFeatures("drawn", vectors.astype(np.float32), known, ()))


def assert_sources_are_restored(scorer, tasks):
    """Check that w and p score tables with evidence, and score the same from their constants."""
    nothing = len(scorer.entities)
    goal = torch.tensor([3, 4])
    table = torch.tensor([[0, 1, 2, nothing], [1, 2, 5, nothing]])
    attempts = Attempts(torch.tensor([2, 3]))
    states = States(goal, torch.tensor([nothing, 1]), table, torch.tensor([0, 1]), attempts)
    for source in make_sources(["w", "p"], scorer, tasks=tasks):
        scores = source(states)
        assert scores.isfinite().all()
        restored = source_class(source.name).restored(source.num_entities, source.state_dict())
        restored.load_state_dict(source.state_dict())
        restored.bind(tasks)
        assert torch.equal(restored(states), scores)
        assert len(source.evidence(states.rows(0, 1))) == 4
