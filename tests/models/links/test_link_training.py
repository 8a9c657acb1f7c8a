"""Training into a model folder: determinism, interruption and resumption, early stopping, failures
and bad settings."""

import json
import re
import shutil
import threading
import warnings
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from graph_folders import write_graph
from link_helpers import contents, global_states, interrupt_after, train
from refusals import refuses
from resumption import resume

from wordcraft_kg import (
    ComplExConfig,
    LinkModelConfig,
    LinksConfig,
    load_scorer,
    open_graph,
    open_model,
)
from wordcraft_kg.base.errors import ArtefactError, ConfigError, TrainingError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.models.links import training as link_training
from wordcraft_kg.models.links.config import N3_PARTIAL, LinkSettings
from wordcraft_kg.models.links.fitting import Epochs
from wordcraft_kg.models.scorers.ranking import rank_triples, ranking_metrics
from wordcraft_kg.runs.record import read_run

SHORT = ComplExConfig(dim=8, epochs=5, n3=0.1, folds=0)
RESUMED: dict[str, LinkSettings] = {
    "complex": SHORT,
    "complex with validation": replace(SHORT, eval_every=1),
    "complex with a sampled softmax": replace(SHORT, negatives=16, batch_size=100),
    "complex with a checkpoint each epoch": replace(SHORT, checkpoint_every=1),
    "distmult by softmax": LinkModelConfig(
        model="distmult", loop="symmetric", dim=4, epochs=5, folds=0
    ),
    "distmult by negatives": LinkModelConfig(
        model="distmult", dim=4, epochs=5, negatives=3, folds=0
    ),
    "rotate by negatives, with validation": LinkModelConfig(
        model="rotate", dim=4, epochs=5, negatives=3, eval_every=2, folds=0
    ),
}

FAST = ("complex", "rotate by negatives, with validation")
EACH = pytest.mark.parametrize(
    "config",
    [
        pytest.param(config, marks=[] if name in FAST else pytest.mark.slow)
        for name, config in RESUMED.items()
    ],
    ids=RESUMED,
)


def weights(trained):
    return (trained.folder / "model.safetensors").read_bytes()


def without_times(rows):
    return [
        {name: value for name, value in row.items() if not name.startswith("seconds")}
        for row in rows
    ]


def halved(opened, config, tmp_path, epoch, **options):
    """A run that was interrupted after an epoch, and an undisturbed one."""
    stopped = train(opened, config, tmp_path / "halves", progress=interrupt_after(epoch), **options)
    assert (stopped.interrupted, stopped.epoch, stopped.metrics) == (True, epoch + 1, None)
    return stopped.folder, train(opened, config, tmp_path / "whole", **options)


def same(one, other):
    assert weights(one) == weights(other)
    assert (trace(one), figures(one)) == (trace(other), figures(other))
    assert sorted(contents(one.folder)) == sorted(contents(other.folder))
    return True


def trace(trained):
    return without_times(
        json.loads(line) for line in (trained.folder / "trace.jsonl").read_text().splitlines()
    )


def figures(trained):
    return without_times([as_values(trained.metrics)])


# --- determinism ----------------------------------------------------------------------------------


@EACH
def test_the_same_seed_gives_the_same_bytes_and_settings(parted_kitchen, tmp_path, config):
    """The same seed gives the same bytes without a warning and the settings are recorded."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        one, two = (train(parted_kitchen, config, tmp_path / name) for name in ("one", "two"))
    assert same(one, two)
    assert [str(warning.message) for warning in caught] == []
    recorded = LinksConfig.read(one.folder)
    assert recorded.settings == config.for_size(parted_kitchen.graph.num_entities)
    assert open_graph(recorded.graph).split.hash == parted_kitchen.split.hash


def test_the_global_generators_do_not_influence_a_training(opened_kitchen, tmp_path):
    models = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        models.append(train(opened_kitchen, SHORT, tmp_path / str(seed)))
    assert weights(models[0]) == weights(models[1])


def fail(*arguments, **settings):
    raise RuntimeError("no more")


ROTATE = RESUMED["rotate by negatives, with validation"]


@pytest.mark.parametrize(
    ("config", "end"),
    [
        (ROTATE, "interrupted"),
        *(
            pytest.param(config, end, marks=pytest.mark.slow)
            for config, end in (
                (SHORT, "done"),
                (SHORT, "interrupted"),
                (SHORT, "failed"),
                (ROTATE, "done"),
                (ROTATE, "failed"),
            )
        ),
    ],
)
def test_training_leaves_all_global_states_as_they_were(
    parted_kitchen, tmp_path, config, end, monkeypatch
):
    if end == "failed":
        monkeypatch.setattr(link_training, "_write_results", fail)
    before = global_states()
    with pytest.raises(RuntimeError, match="no more") if end == "failed" else nullcontext():
        config = replace(config, threads=before["threads"] + 1)
        progress = interrupt_after(1) if end == "interrupted" else None
        train(parted_kitchen, config, tmp_path / "model", progress=progress)
    assert read_run(tmp_path / "model").status == end
    assert global_states() == before


# --- the folder -----------------------------------------------------------------------------------


def test_a_finished_folder_holds_what_it_should_and_nothing_else(complex_folder):
    names = (
        "README.md",
        "config.toml",
        "metrics.json",
        "model.safetensors",
        "run.json",
        "trace.jsonl",
    )
    assert sorted(contents(complex_folder)) == sorted([*names, "vocabulary.json"])
    assert [path for path in complex_folder.iterdir() if path.is_dir()] == []


def test_validation_runs_every_so_many_epochs_and_at_the_end(parted_kitchen, tmp_path):
    trained = train(parted_kitchen, replace(SHORT, eval_every=2), tmp_path / "model")
    measured = {row["epoch"]: row["valid_mrr"] for row in trace(trained) if "valid_mrr" in row}
    assert list(measured) == [2, 4, 5]
    assert trained.metrics.valid_mrr == max(measured.values())
    assert measured[trained.metrics.best_epoch] == max(measured.values())


def test_the_validation_figure_is_the_filtered_mrr_of_the_validation_part(parted_kitchen, tmp_path):
    trained = train(parted_kitchen, replace(SHORT, eval_every=5), tmp_path / "model")
    split = parted_kitchen.split
    # Filtered by what may be known when an epoch is chosen: test triples may not.
    known = np.concatenate([split.partial, split.triples_of("valid")])
    ranks = rank_triples(load_scorer(trained.folder), split.held_out("valid"), known)
    assert trained.metrics.valid_mrr == pytest.approx(ranking_metrics(ranks).mrr)


@pytest.mark.parametrize(
    "config",
    [SHORT, pytest.param(RESUMED["rotate by negatives, with validation"], marks=pytest.mark.slow)],
    ids=["complex", "rotate"],
)
def test_validating_does_not_change_what_is_learnt(parted_kitchen, tmp_path, config):
    without, with_validation = (
        train(parted_kitchen, replace(config, eval_every=every), tmp_path / str(every))
        for every in (0, 1)
    )
    assert weights(without) == weights(with_validation)


@pytest.mark.slow
def test_the_full_graph_trains_on_all_triples_and_remembers_them(opened_kitchen, tmp_path):
    trained = train(opened_kitchen, ComplExConfig(kg="full", dim=32, epochs=60), tmp_path / "model")
    assert (
        trained.metrics.triples
        == len(opened_kitchen.graph.triples)
        > len(opened_kitchen.split.partial)
    )
    assert trained.metrics.train_mrr > 0.9
    assert open_model(trained.folder).kg == "full"
    assert "test recipes" in (trained.folder / "README.md").read_text()


def test_training_works_outside_the_main_thread(opened_kitchen, tmp_path, complex_folder):
    found = []
    config = ComplExConfig(dim=8, epochs=4, n3=0.1, folds=0)
    thread = threading.Thread(
        target=lambda: found.append(train(opened_kitchen, config, tmp_path / "model"))
    )
    thread.start()
    thread.join()
    assert weights(found[0]) == (complex_folder / "model.safetensors").read_bytes()


# --- interruption and resumption ------------------------------------------------------------------


@EACH
def test_a_resumed_run_equals_an_undisturbed_one_bit_for_bit(parted_kitchen, tmp_path, config):
    folder, whole = halved(parted_kitchen, config, tmp_path, 2)
    assert same(resume(folder), whole)


@pytest.mark.parametrize(("name", "value"), [("epochs", 7), ("epochs", 2), ("seed", 1), ("dim", 9)])
def test_an_unfinished_run_of_other_settings_is_refused(unfinished, opened_kitchen, name, value):
    """An unfinished run of other settings is refused by their name and stays."""
    before = contents(unfinished)
    with pytest.raises(ConfigError, match=f"`{name}` .* and this command has {value}"):
        train(opened_kitchen, replace(SHORT, **{name: value}), unfinished)
    assert contents(unfinished) == before


def test_a_run_whose_graph_has_moved_goes_on(tmp_path, parted_folder):
    """A run whose graph has moved goes on and is opened with the new place."""
    graph, moved = Path(shutil.copytree(parted_folder, tmp_path / "graph")), tmp_path / "moved"
    folder, whole = halved(open_graph(graph), SHORT, tmp_path, 1)
    graph.rename(moved)
    assert same(resume(folder, graph=str(moved)), whole)
    assert Path(open_model(folder).opened.source).resolve() == moved.resolve()


def test_resuming_on_another_split_is_an_error(tmp_path, opened_kitchen, parted_folder):
    stopped = train(opened_kitchen, SHORT, tmp_path / "model", progress=interrupt_after(1))
    with pytest.raises(ConfigError, match="another split"):
        resume(stopped.folder, graph=str(parted_folder))


@pytest.fixture
def unfinished(opened_kitchen, tmp_path):
    return train(opened_kitchen, SHORT, tmp_path / "model", progress=interrupt_after(1)).folder


# --- validation -----------------------------------------------------------------------------------


def test_of_equal_validations_the_first_is_the_best(parted_kitchen, tmp_path, monkeypatch):
    figures = [0.1, 0.4, 0.2, 0.4]
    monkeypatch.setattr(Epochs, "_validate", lambda epochs: figures[len(epochs.trace)])
    settings = replace(SHORT, epochs=4, eval_every=1)
    metrics = train(parted_kitchen, settings, tmp_path / "model").metrics
    assert (metrics.epochs, metrics.best_epoch, metrics.valid_mrr) == (4, 2, 0.4)


# --- settings that cannot be met ------------------------------------------------------------------


NO_GPU = pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")


@pytest.mark.parametrize(
    ("config", "match"),
    [
        (replace(SHORT, eval_every=1), "`valid_ratio`"),
        *(
            (replace(SHORT, device=name), f"`device` {name!r}")
            for name in ("nonsense", "cpu:x", "", "meta")
        ),
        pytest.param(replace(SHORT, device="cuda"), "^`device` 'cuda'.*Use cpu", marks=NO_GPU),
        (LinkModelConfig(model="rotat", dim=4), "'rotat'.*'rotate'"),
        *(
            (LinkModelConfig(model=name, dim=4, epochs=1), f"'{name}'")  # needs more than triples
            for name in ("nodepiece", "inductivenodepiece", "compgcn", "distmultliteral")
        ),
    ],
)
def test_settings_that_cannot_be_met_are_refused_by_name_and_leave_nothing(
    opened_kitchen, tmp_path, config, match
):
    with pytest.raises(ConfigError, match=match):
        train(opened_kitchen, config, tmp_path / "model")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "model", ["TransE", "tucker", "rescal", "rgcn", "conve", "complexn3", "quate"]
)
def test_other_models_train_and_load(opened_kitchen, tmp_path, model):
    config = LinkModelConfig(model=model, dim=8, epochs=1, negatives=2, folds=0)
    scorer = load_scorer(
        train(opened_kitchen, config, tmp_path / "model").folder, graph=opened_kitchen.graph
    )
    assert scorer.table("combinesWith").shape == (80, 80)
    assert torch.isfinite(scorer.table("componentOf")).all()


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["slcwa", "symmetric"])
def test_every_model_of_pykeen_trains_or_is_refused_clearly(opened_kitchen, tmp_path, loop):
    from pykeen.models import model_resolver

    crashed = {}
    for model in sorted(model_resolver.lookup_dict):
        config = LinkModelConfig(model=model, dim=8, epochs=1, negatives=2, loop=loop)
        try:
            load_scorer(train(opened_kitchen, config, tmp_path / model).folder)
        except ConfigError:
            continue
        except Exception as error:
            crashed[model] = repr(error)
    assert crashed == {}


def test_a_graph_without_a_split_has_no_partial_graph_to_train_on(tmp_path):
    opened = open_graph(write_graph(tmp_path / "graph", "paper-examples", kind="none"))
    with refuses("kg"):
        train(opened, SHORT, tmp_path / "model")
    trained = train(opened, replace(SHORT, kg="full"), tmp_path / "model")
    assert trained.metrics.triples == len(opened.graph.triples)


def test_a_diverging_training_is_a_clear_error_and_leaves_nothing(opened_kitchen, tmp_path):
    with refuses("learning_rate", TrainingError):
        train(opened_kitchen, replace(SHORT, learning_rate=1e30), tmp_path / "model")
    assert not list(tmp_path.iterdir())


def test_a_misspelt_model_leaves_an_unfinished_run_alone(opened_kitchen, tmp_path):
    stopped = train(opened_kitchen, SHORT, tmp_path / "model", progress=interrupt_after(2))
    with refuses("model"):
        train(opened_kitchen, LinkModelConfig(model="nosuch"), tmp_path / "model", force=True)
    assert (stopped.folder / "checkpoints" / "epoch-3.json").exists()


NAN, INF = float("nan"), float("inf")
BOTH = (ComplExConfig, LinkModelConfig)


OUT_OF_RANGE = {
    "kg": ["half"],
    "epochs": [0, -3],
    **{name: [0] for name in ("batch_size", "checkpoint_every", "threads", "dim")},
    **{name: [-1] for name in ("eval_every",)},
    "seed": [-1, 2**32],
    "learning_rate": [0.0, -1.0, NAN, INF],
}


@pytest.mark.parametrize(
    ("config", "setting", "value"),
    [
        *(
            (config, name, value)
            for config in BOTH
            for name, values in OUT_OF_RANGE.items()
            for value in values
        ),
        *(
            (ComplExConfig, name, value)
            for name in ("n3", "popularity")
            for value in (-1.0, NAN, INF)
        ),
        *((ComplExConfig, "init_scale", value) for value in (0.0, -1e-3, NAN, INF)),
        *((ComplExConfig, "negatives", value) for value in (-1, 1.5, True)),
        (LinkModelConfig, "negatives", 0),
        (LinkModelConfig, "loop", "lcwa"),
    ],
)
def test_a_setting_out_of_range_is_an_error_that_names_it_and_its_value(config, setting, value):
    with pytest.raises(ConfigError, match=re.escape(f"`{setting}` {value!r}: expected")):
        config(**{setting: value})


@pytest.mark.parametrize("config", BOTH)
def test_the_least_allowed_settings_are_allowed(config):
    least = {
        "epochs": 1,
        "batch_size": 1,
        "checkpoint_every": 1,
        "threads": 1,
        "dim": 1,
        "seed": 0,
        "eval_every": 0,
    }
    assert vars(replace(config(), **least)).items() >= least.items()


def test_regularisation_is_off_on_full_and_open_on_partial():
    """The regularisation is off by default on the full graph and open on the partial."""
    full, partial = ComplExConfig(kg="full"), ComplExConfig(kg="partial")
    assert (full.n3, full.popularity, full.is_open) == (0, 0, False)
    assert (partial.n3, partial.popularity, partial.is_open) == (None, None, True)
    assert (partial.fixed().n3, partial.fixed().popularity) == (N3_PARTIAL, 0)


@pytest.mark.parametrize(
    ("given", "n3", "popularity"), [({"n3": 0.3}, 0.3, 0), ({"popularity": 2.0}, N3_PARTIAL, 2)]
)
def test_naming_one_part_of_the_regularisation_fixes_the_other(given, n3, popularity):
    config = ComplExConfig(**given)
    assert (config.n3, config.popularity, config.is_open) == (n3, popularity, False)
    assert config.fixed() == config


def test_a_config_file_fills_the_defaults_of_settings_that_it_lacks(tmp_path):
    (tmp_path / "config.toml").write_text('[train-complex]\ngraph = "kitchen"\ndim = 5\n')
    assert LinksConfig.read(tmp_path) == LinksConfig("kitchen", ComplExConfig(dim=5))


TABLE = '[train-complex]\ngraph = "kitchen"\n'


@pytest.mark.parametrize(
    "text",
    [
        None,
        "",
        "not toml",
        "\udcff\udcfe",
        *(f"{TABLE}{line}\n" for line in ("epoch = 3", "epochs = 0", 'epochs = "ten"')),
        f'{TABLE}[train-links]\ngraph = "kitchen"\n',
        *("[train-complex]\nepochs = 3\n", "[train-complex]\ngraph = 3\n"),
        *('[train-magic]\ngraph = "kitchen"\n', 'train-complex = "kitchen"\n'),
    ],
    ids=repr,
)
def test_a_missing_or_damaged_config_file_is_an_error_that_names_it(tmp_path, text):
    if text is not None:
        (tmp_path / "config.toml").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(
        ArtefactError, match=rf"config\.toml is {'missing' if text is None else 'damaged'}"
    ):
        LinksConfig.read(tmp_path)
