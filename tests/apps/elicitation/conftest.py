"""A stand-in that answers from the kitchen's recipes."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from stand_in import StandIn, answers_from, standing_in, table_of

import wordcraft_kg.apps.elicitation.model  # noqa: F401 - registers the kind of model
from wordcraft_kg.apps.elicitation.config import OPENAI_KEY
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph


@pytest.fixture(scope="session")
def opened() -> OpenedGraph:
    return open_graph("kitchen")


@pytest.fixture(autouse=True)
def own_home(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the test a cache and a working folder, no key, and retries that do not wait."""
    monkeypatch.chdir(home)
    monkeypatch.delenv(OPENAI_KEY, raising=False)
    monkeypatch.setattr("openai._base_client.INITIAL_RETRY_DELAY", 0.01)
    return home


@pytest.fixture
def stand_in(opened: OpenedGraph) -> Iterator[StandIn]:
    with standing_in(answers_from(table_of(opened.graph))) as server:
        yield server


@pytest.fixture
def ask(stand_in: StandIn, run: Callable) -> Callable:
    """Run ``elicit`` on the kitchen with the stand-in."""
    fixed = ("elicit", "kitchen", "--endpoint", stand_in.address, "--model", "oracle")
    return lambda *options: run(*fixed, *options)
