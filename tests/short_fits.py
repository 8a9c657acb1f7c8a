"""Fits of recipe scorers that take a few steps, for tests that do not ask how good they are."""

from contextlib import contextmanager

import pytest

from wordcraft_kg.models.recipes import fitting
from wordcraft_kg.models.recipes.committee import TABLES, fit_committee
from wordcraft_kg.models.scorers import probabilities


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
