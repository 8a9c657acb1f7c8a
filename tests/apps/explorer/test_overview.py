"""The overview of what there is to look at."""

from pathlib import Path

import pytest

from tests.apps.explorer.shown import client_of, explored_graph
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import HOME
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.training import train_links


@pytest.mark.parametrize(
    ("rows", "furthest", "most_used"),
    [
        ([("a", "b", "c"), ("c", "b", "d"), ("x", "y", "z")], ("d", "c", "z"), ("b", "a", "c", "x", "y")),
        ([("a", "b", "c"), ("b", "c", "a"), ("c", "a", "b")], (), ("a", "b", "c")),
        ([], (), ()),
    ],
)
def test_what_needs_no_craft_or_cannot_be_made_is_not_far_from_the_base(
    rows: list[tuple[str, str, str]], furthest: tuple[str, ...], most_used: tuple[str, ...]
):
    found = HOME.view(explored_graph(rows), HOME.state())
    assert (found.furthest, found.most_used) == (furthest, most_used)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, ""),
        ({"train_fraction": 0.5, "label_noise": 0.25}, "50 % of the train recipes, 25 % of them with a wrong result"),
    ],
)
def test_a_model_that_was_taught_a_dose_says_of_what(settings: dict[str, float], said: str, tmp_path: Path):
    config = LinksConfig("kitchen", ComplExConfig(dim=2, epochs=1, folds=0, **settings))  # type: ignore[arg-type]
    explored = Explored.open("kitchen", [train_links(config, tmp_path / "model").folder])
    (line,) = HOME.view(explored, HOME.state()).models
    assert line.train_sample == said
    page = client_of(explored).get("/home").text
    assert f">{said or 'train recipes'}<" in page
