"""Choosing settings: what the search may look at, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest
from link_helpers import global_states, random_graph

from wordcraft_kg.errors import ConfigError, SplitError
from wordcraft_kg.graphs import SplitConfig, make_split
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.links import tuning as link_tuning
from wordcraft_kg.models.links.tuning import _validation_split, tune


def rows(triples: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(triple) for triple in triples.tolist()}


def test_validation_triples_come_from_the_train_recipes_and_not_from_the_rest(opened_kitchen: OpenedGraph):
    train, valid = (rows(part) for part in _validation_split(opened_kitchen, 0.2, seed=0))
    split = opened_kitchen.split
    assert not train & valid
    assert train | valid == rows(split.partial)
    assert not (train | valid) & rows(split.held_out("test"))


def test_validation_holds_out_about_the_share_asked_for(opened_kitchen: OpenedGraph):
    sizes = [len(_validation_split(opened_kitchen, ratio, seed=0)[1]) for ratio in (0.1, 0.3, 0.6)]
    assert sizes == sorted(sizes)
    assert sizes[2] > 2 * sizes[0]


def test_validation_holds_out_pairs_whole(opened_kitchen: OpenedGraph):
    train, valid = (rows(part) for part in _validation_split(opened_kitchen, 0.3, seed=0))
    symmetric = {triple for triple in valid if triple[1] == 0}
    assert symmetric
    assert all((tail, relation, head) in symmetric for head, relation, tail in symmetric)
    assert not any((tail, relation, head) in train for head, relation, tail in symmetric)


def test_a_validation_part_of_the_graph_is_kept(validated_kitchen: OpenedGraph):
    train, valid = _validation_split(validated_kitchen, 0.5, seed=3)
    assert rows(train) == rows(validated_kitchen.split.partial)
    assert rows(valid) == rows(validated_kitchen.split.held_out("valid"))


def test_the_drawing_is_determined_by_its_seed(opened_kitchen: OpenedGraph):
    draws = [rows(_validation_split(opened_kitchen, 0.2, seed=seed)[1]) for seed in (0, 0, 1)]
    assert draws[0] == draws[1] != draws[2]


def test_too_few_validation_triples_are_refused_with_advice(opened_kitchen: OpenedGraph, tmp_path: Path):
    with pytest.raises(SplitError, match="`valid_ratio`"):
        tune(opened_kitchen, "complex", tmp_path / "tuned.toml", trials=1, valid_ratio=0.01)
    graph = random_graph(num_entities=6, num_recipes=8)
    tiny = OpenedGraph(graph, make_split(graph, SplitConfig()), "tiny")
    with pytest.raises(SplitError, match="`valid_ratio`"):
        tune(tiny, "complex", tmp_path / "tuned.toml", trials=1, valid_ratio=0.2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("trials", 0),
        ("trials", -1),
        ("valid_ratio", 0.0),
        ("valid_ratio", 1.0),
        ("valid_ratio", float("nan")),
        ("seed", -1),
    ],
)
def test_a_setting_of_the_search_out_of_range_is_refused(opened_kitchen: OpenedGraph, tmp_path: Path, setting, value):
    with pytest.raises(ConfigError, match=f"`{setting}` {value}"):
        tune(opened_kitchen, "complex", tmp_path / "tuned.toml", **{setting: value})


def test_an_unknown_model_is_refused_with_the_nearest_one(opened_kitchen: OpenedGraph, tmp_path: Path):
    with pytest.raises(ConfigError, match=r"'rotat'.*'rotate'"):
        tune(opened_kitchen, "rotat", tmp_path / "tuned.toml", trials=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("device", ["nonsense", "meta"])
def test_an_unknown_device_is_refused(opened_kitchen: OpenedGraph, tmp_path: Path, device: str):
    with pytest.raises(ConfigError, match=f"`device` {device!r}"):
        tune(opened_kitchen, "complex", tmp_path / "tuned.toml", trials=1, device=device)


@pytest.mark.parametrize("timeout", [0, -1])
def test_a_search_without_time_is_refused(opened_kitchen: OpenedGraph, tmp_path: Path, timeout: int):
    with pytest.raises(ConfigError, match="`timeout`"):
        tune(opened_kitchen, "complex", tmp_path / "tuned.toml", trials=1, timeout=timeout)


def test_a_model_that_cannot_be_set_up_is_a_clear_error(opened_kitchen: OpenedGraph, tmp_path: Path):
    with pytest.raises(ConfigError, match="'compgcn'"):
        tune(opened_kitchen, "compgcn", tmp_path / "tuned.toml", trials=1)


def test_an_interrupted_search_writes_nothing_and_restores_all_states(
    opened_kitchen: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(**settings: object) -> None:
        np.random.seed(5)  # noqa: NPY002
        raise KeyboardInterrupt

    monkeypatch.setattr(link_tuning, "hpo_pipeline", interrupted)
    before = global_states()
    with pytest.raises(KeyboardInterrupt):
        tune(opened_kitchen, "complex", tmp_path / "tuned.toml", trials=1)
    assert global_states() == before
    assert list(tmp_path.iterdir()) == []
