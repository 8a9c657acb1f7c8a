"""Choosing settings by PyKEEN's hyper-parameter optimisation, on validation triples; test triples are never used."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from pykeen.hpo import hpo_pipeline

from wordcraft_kg.artefacts import write_atomically
from wordcraft_kg.errors import ConfigError, SplitError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.triples import is_in, recipe_triples
from wordcraft_kg.models.links.builders import model_class
from wordcraft_kg.models.links.complex import ComplExN3
from wordcraft_kg.models.links.config import CONFIGS, MAX_SEED, ComplExConfig, LinkModelConfig
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, quiet_pykeen, seeded_pipelines, triples_factory
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES
from wordcraft_kg.records import Count, Record, Share
from wordcraft_kg.runs.config_file import toml_value
from wordcraft_kg.settings import MAX_SIZE, refuse, whole
from wordcraft_kg.tensors import check_device

_EPOCHS = {"type": "int", "low": 20, "high": 100, "q": 20}
_BATCH = {"type": "categorical", "choices": [256, 512, 1024]}


class Tuned(Record):
    """The best settings of a search.

    Attributes:
        model: the model that was tuned.
        command: the command that trains it with the settings.
        trials: number of settings tried.
        valid_mrr: best MRR of the validation triples.
        settings: the best settings, by name.
        out: the TOML file that holds them.
    """

    model: str
    command: str
    trials: Count
    valid_mrr: Share
    settings: dict[str, str | int | float]
    out: str


def tune(
    opened: OpenedGraph,
    model: str,
    out: Path,
    *,
    trials: int = 20,
    valid_ratio: float = 0.1,
    seed: int = 0,
    timeout: int | None = None,
    device: str = "cpu",
    quiet: bool = False,
) -> Tuned:
    """Search settings of a model on the partial graph and write the best as a TOML file.

    Args:
        opened: graph and split; if the split has no validation part, one is drawn from its train pairs.
        model: ``complex``, or PyKEEN's name of another model.
        out: the TOML file.
        trials: how many settings to try.
        valid_ratio: share of the train pairs to draw for validation.
        seed: seed of the search, of the draw and of each training.
        timeout: seconds after which no new trial begins.
        device: torch device.
        quiet: print no line on stderr after each trial.

    Raises:
        ConfigError: if an argument is out of range or PyKEEN has no such model.
        SplitError: if too few triples are left to validate on.
    """
    whole("trials", trials, 1, MAX_SIZE)
    if not 0 < valid_ratio < 1:
        raise refuse("valid_ratio", valid_ratio, "more than 0 and less than 1")
    if timeout is not None:
        whole("timeout", timeout, 1)
    whole("seed", seed, 0, MAX_SEED)
    check_device(device)
    train, valid = _validation_split(opened, valid_ratio, seed)
    search = _complex_search() if model.lower() == "complex" else _pykeen_search(model)
    for handler in logging.getLogger("optuna").handlers:
        handler.addFilter(_without_traceback)
    optuna.logging.set_verbosity(optuna.logging.WARNING if quiet else optuna.logging.INFO)
    try:
        with pykeen_guard(seed, threads=1), seeded_pipelines(seed), quiet_pykeen():
            result = hpo_pipeline(
                training=triples_factory(opened.graph, train),
                validation=triples_factory(opened.graph, valid),
                # PyKEEN asks for test triples too; it never looks at them while it searches.
                testing=triples_factory(opened.graph, valid),
                device=device,
                training_kwargs={"use_tqdm": False, "pin_memory": False},
                evaluation_kwargs={"batch_size": 512, "use_tqdm": False},
                sampler="tpe",
                sampler_kwargs={"seed": seed},
                n_trials=trials,
                timeout=timeout,
                **search,
            )
        best = result.study.best_trial
    except (TypeError, ValueError, NotImplementedError, AttributeError, AssertionError) as error:
        raise ConfigError(f"no trial of `model` {model!r} succeeded ({error!r}).") from None
    names = {
        "model.embedding_dim": "dim",
        "regularizer.weight": "n3",
        "optimizer.lr": "learning_rate",
        "training.batch_size": "batch_size",
        "training.num_epochs": "epochs",
        "negative_sampler.num_negs_per_pos": "negatives",
    }
    settings: dict[str, Any] = {names[name]: value for name, value in sorted(best.params.items())}
    config: type[ComplExConfig] | type[LinkModelConfig] = ComplExConfig
    if model.lower() != "complex":
        config, settings = LinkModelConfig, {"model": model, **settings}
    config(**settings)  # what is written must be readable
    valid_mrr = float(best.value)
    lines = [
        f"# validation MRR {valid_mrr:.4f}, the best of {len(result.study.trials)} trials on {opened.graph.name}",
        f"# graph {opened.graph.hash[:12]}, split {opened.split.hash[:12]}, seed {seed}",
        f"[{config.command}]",
        *(f"{name} = {toml_value(value)}" for name, value in settings.items()),
    ]
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, "\n".join(lines) + "\n")
    return Tuned(
        model=model,
        command=next(name for name, kind in CONFIGS.items() if kind is config),
        trials=len(result.study.trials),
        valid_mrr=valid_mrr,
        settings=settings,
        out=str(out),
    )


def _without_traceback(record: logging.LogRecord) -> bool:
    """Take the traceback from a message: optuna adds one even for Ctrl-C."""
    record.exc_info = record.exc_text = None
    return True


def _validation_split(opened: OpenedGraph, ratio: float, seed: int) -> tuple[Ids, Ids]:
    """Return the triples to train and to validate on; whole pairs are held out, as in the split by recipe."""
    graph, split = opened.graph, opened.split
    valid = split.held_out("valid")
    train = split.partial
    if not len(valid):
        in_train = split.is_in("train")
        pairs = np.unique(graph.pair_of_recipe[in_train])
        held_out = np.random.default_rng(seed).permutation(pairs)[: round(ratio * len(pairs))]
        is_held_out = in_train & np.isin(graph.pair_of_recipe, held_out)
        train = recipe_triples(graph.recipes[in_train & ~is_held_out])
        valid = recipe_triples(graph.recipes[is_held_out])
        valid = valid[~is_in(valid, train, graph.num_entities)]
    if len(valid) < MIN_TRIPLES:
        raise SplitError(
            f"only {len(valid)} triples to validate on; {MIN_TRIPLES} are needed. Choose a larger `valid_ratio`."
        )
    return train, valid


def _complex_search() -> dict[str, Any]:
    return {
        "model": ComplExN3,
        "model_kwargs": {"embedding_dim": ComplExConfig.dim},
        "loss": "crossentropy",
        "loss_kwargs": {"reduction": "mean"},
        "regularizer": "powersum",
        "regularizer_kwargs": {"p": 3.0, "normalize": False},
        "regularizer_kwargs_ranges": {"weight": {"type": "float", "low": 0.02, "high": 0.5, "log": True}},
        "optimizer": "Adagrad",
        "optimizer_kwargs_ranges": {"lr": {"type": "float", "low": 0.03, "high": 0.3, "log": True}},
        "training_loop": "indexedsymmetriclcwa",
        "training_kwargs_ranges": {"num_epochs": _EPOCHS, "batch_size": _BATCH},
    }


def _pykeen_search(model: str) -> dict[str, Any]:
    kind = model_class(model)
    return {
        "model": kind,
        # Settings that train-links does not offer keep the model's defaults.
        "regularizer_kwargs": {"weight": 1.0, **(kind.regularizer_default_kwargs or {})}
        if kind.regularizer_default
        else None,
        "model_kwargs_ranges": {"embedding_dim": {"type": "categorical", "choices": [64, 128, 256]}},
        "loss": "nssa",
        "loss_kwargs": {"margin": 9.0, "adversarial_temperature": 1.0, "reduction": "mean"},
        "optimizer": "Adam",
        "optimizer_kwargs_ranges": {"lr": {"type": "float", "low": 1e-3, "high": 0.1, "log": True}},
        "training_loop": "slcwa",
        "training_kwargs_ranges": {"num_epochs": _EPOCHS, "batch_size": _BATCH},
        "negative_sampler": "basic",
        "negative_sampler_kwargs_ranges": {
            "num_negs_per_pos": {"type": "categorical", "choices": [8, 32, 128]},
        },
    }
