"""Choosing settings: what the search may look at, and what it refuses."""

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from link_helpers import global_states, interrupt_after, random_graph, train
from optuna.distributions import CategoricalDistribution, IntDistribution
from refusals import refuses

from wordcraft_kg.base.errors import ArtefactError, ConfigError, OutputExistsError, SplitError, TrainingError
from wordcraft_kg.graphs import SplitConfig, make_split
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.links import tuning as link_tuning
from wordcraft_kg.models.links.config import ComplExConfig
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.tuning import _validation_split, tune
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples


def rows(triples: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(triple) for triple in triples.tolist()}


def test_validation_triples_come_from_the_train_recipes_and_not_from_the_rest(opened_kitchen):
    train, valid = (rows(part) for part in _validation_split(opened_kitchen, 0.2, seed=0))
    split = opened_kitchen.split
    assert not train & valid
    assert train | valid == rows(split.partial)
    assert not (train | valid) & rows(split.held_out("test"))


def test_validation_holds_out_about_the_share_asked_for(opened_kitchen):
    sizes = [len(_validation_split(opened_kitchen, ratio, seed=0)[1]) for ratio in (0.1, 0.3, 0.6)]
    assert sizes == sorted(sizes)
    assert sizes[2] > 2 * sizes[0]


def test_validation_holds_out_pairs_whole(opened_kitchen):
    train, valid = (rows(part) for part in _validation_split(opened_kitchen, 0.3, seed=0))
    symmetric = {triple for triple in valid if triple[1] == 0}
    assert symmetric
    assert all((tail, relation, head) in symmetric for head, relation, tail in symmetric)
    assert not any((tail, relation, head) in train for head, relation, tail in symmetric)


def test_a_validation_part_of_the_graph_is_kept(validated_kitchen):
    train, valid = _validation_split(validated_kitchen, 0.5, seed=3)
    assert rows(train) == rows(validated_kitchen.split.partial)
    assert rows(valid) == rows(validated_kitchen.split.held_out("valid"))


def test_the_drawing_is_determined_by_its_seed(opened_kitchen):
    draws = [rows(_validation_split(opened_kitchen, 0.2, seed=seed)[1]) for seed in (0, 0, 1)]
    assert draws[0] == draws[1] != draws[2]


def test_too_few_validation_triples_are_refused_with_advice(opened_kitchen, tmp_path):
    with refuses("valid_ratio", SplitError):
        tune(opened_kitchen, "complex", tmp_path / "search", trials=1, valid_ratio=0.01)
    graph = random_graph(num_entities=6, num_recipes=8)
    tiny = OpenedGraph(graph, make_split(graph, SplitConfig()), "tiny")
    with refuses("valid_ratio", SplitError):
        tune(tiny, "complex", tmp_path / "search", trials=1, valid_ratio=0.2)
    assert list(tmp_path.iterdir()) == []


OUT_OF_RANGE = {
    "trials": (0, -1),
    "valid_ratio": (0.0, 1.0, float("nan")),
    "seed": (-1,),
    "device": ("nonsense", "meta"),
    "timeout": (0, -1),
}


@pytest.mark.parametrize(("setting", "value"), [(name, value) for name, row in OUT_OF_RANGE.items() for value in row])
def test_a_setting_of_the_search_out_of_range_is_refused(opened_kitchen, tmp_path, setting, value):
    with refuses(setting):
        tune(opened_kitchen, "complex", tmp_path / "search", **{"trials": 1, setting: value})


@pytest.mark.parametrize(("model", "match"), [("rotat", r"'rotat'.*'rotate'"), ("compgcn", "'compgcn'")])
def test_a_model_that_is_unknown_or_cannot_be_set_up_is_refused_by_name(opened_kitchen, tmp_path, model, match):
    with pytest.raises(ConfigError, match=match):
        tune(opened_kitchen, model, tmp_path / "search", trials=1)
    assert list(tmp_path.iterdir()) == []


# --- a search --------------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def fast_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search among few epochs and dimensions, so that a trial takes a moment."""
    monkeypatch.setattr(link_tuning, "_EPOCHS", IntDistribution(2, 4, step=2))
    monkeypatch.setitem(link_tuning._OTHERS, "dim", CategoricalDistribution([4, 8]))


def tried(folder: Path) -> list[dict[str, object]]:
    rows = [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]
    return [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


@pytest.mark.parametrize("model", ["complex", "distmult"])
def test_a_search_that_goes_on_ends_like_one_without_a_break(opened_kitchen, tmp_path, model):
    # The sampler draws at random for ten trials; only then does it look at those before.
    whole = tune(opened_kitchen, model, tmp_path / "whole", trials=12)
    for trials in (1, 11, 12):
        found = tune(opened_kitchen, model, tmp_path / "parts", trials=trials)
    assert tried(tmp_path / "whole") == tried(tmp_path / "parts")
    assert (found.settings, found.valid_mrr) == (whole.settings, whole.valid_mrr)
    assert (tmp_path / "parts" / "best.toml").read_bytes() == (tmp_path / "whole" / "best.toml").read_bytes()
    assert len({str(row["settings"]) for row in tried(tmp_path / "whole")}) > 6


def test_ctrl_c_keeps_the_finished_trials_and_says_how_to_go_on(opened_kitchen, tmp_path):
    def press(done: int, total: int, figures: dict[str, float]) -> None:
        if done == 1 and "next trial" in figures:
            signal.raise_signal(signal.SIGINT)

    before = global_states()
    with pytest.raises(
        KeyboardInterrupt, match=r"1 trial is saved .* best so far in .*best\.toml .*Repeat the command"
    ):
        tune(opened_kitchen, "complex", tmp_path / "search", trials=3, progress=press)
    assert global_states() == before
    assert len(tried(tmp_path / "search")) == 1
    assert tune(opened_kitchen, "complex", tmp_path / "search", trials=2).trials == 2


def test_ctrl_c_in_the_first_trial_leaves_nothing(opened_kitchen, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        tune(opened_kitchen, "complex", tmp_path / "search", trials=1, progress=interrupt_after(0))
    assert list(tmp_path.iterdir()) == []


def test_another_search_is_not_mixed_in(opened_kitchen, tmp_path):
    tune(opened_kitchen, "complex", tmp_path / "search", trials=1)
    with pytest.raises(OutputExistsError):
        tune(opened_kitchen, "distmult", tmp_path / "search", trials=1, seed=1)
    assert tune(opened_kitchen, "distmult", tmp_path / "search", trials=1, seed=1, force=True).model == "distmult"


def test_damaged_trials_are_an_error_and_stay(opened_kitchen, tmp_path):
    tune(opened_kitchen, "complex", tmp_path / "search", trials=1)
    (tmp_path / "search" / "trials.jsonl").write_text("{")
    with pytest.raises(ArtefactError, match=r"trials\.jsonl, line 1"):
        tune(opened_kitchen, "complex", tmp_path / "search", trials=2)
    assert (tmp_path / "search" / "trials.jsonl").read_text() == "{"


def test_a_trial_whose_loss_is_not_finite_is_noted_and_the_search_goes_on(opened_kitchen, tmp_path, monkeypatch):
    calls = []

    def second_works(*arguments: object) -> object:
        calls.append(arguments)
        if len(calls) != 2:
            raise TrainingError("no more")
        return fit(*arguments)

    monkeypatch.setattr(link_tuning, "fit", second_works)
    with pytest.raises(TrainingError, match="all 1 trials"):
        tune(opened_kitchen, "complex", tmp_path / "search", trials=1)
    found = tune(opened_kitchen, "complex", tmp_path / "search", trials=3)
    assert [row.valid_mrr is None for row in found.table] == [True, False, True]
    assert found.settings == found.table[1].settings


def test_the_figure_of_a_trial_is_that_of_a_training_with_its_settings(validated_kitchen, tmp_path):
    found = tune(validated_kitchen, "complex", tmp_path / "search", trials=1, seed=3)
    settings = ComplExConfig(**found.settings, seed=3)
    scorer = load_scorer(train(validated_kitchen, settings, tmp_path / "model").folder)
    split = validated_kitchen.split
    known = np.concatenate([split.partial, split.held_out("valid")])
    assert found.valid_mrr == pytest.approx(mean_reciprocal_rank(rank_triples(scorer, split.held_out("valid"), known)))
