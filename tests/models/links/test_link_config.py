"""Settings of link predictors: their ranges, and reading them back."""

import re
from dataclasses import replace

import pytest

from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.models.links.config import N3_PARTIAL, ComplExConfig, LinkModelConfig, LinksConfig

NAN, INF = float("nan"), float("inf")
BOTH = (ComplExConfig, LinkModelConfig)


OUT_OF_RANGE = {
    "kg": ["half"],
    "epochs": [0, -3],
    **{name: [0] for name in ("batch_size", "checkpoint_every", "threads", "dim")},
    **{name: [-1] for name in ("eval_every", "patience")},
    "seed": [-1, 2**32],
    "learning_rate": [0.0, -1.0, NAN, INF],
}


@pytest.mark.parametrize(
    ("config", "setting", "value"),
    [
        *((config, name, value) for config in BOTH for name, values in OUT_OF_RANGE.items() for value in values),
        *((ComplExConfig, name, value) for name in ("n3", "popularity") for value in (-1.0, NAN, INF)),
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
def test_patience_without_validation_is_an_error_that_names_the_missing_setting(config):
    with pytest.raises(ConfigError, match="`eval_every`"):
        config(patience=2)
    assert config(patience=2, eval_every=1).patience == 2


@pytest.mark.parametrize("config", BOTH)
def test_the_least_allowed_settings_are_allowed(config):
    least = {"epochs": 1, "batch_size": 1, "checkpoint_every": 1, "threads": 1, "dim": 1, "seed": 0, "eval_every": 0}
    assert vars(replace(config(), **least)).items() >= least.items()


def test_the_regularisation_is_off_by_default_on_the_full_graph_and_open_on_the_partial():
    full, partial = ComplExConfig(kg="full"), ComplExConfig(kg="partial")
    assert (full.n3, full.popularity, full.is_open) == (0, 0, False)
    assert (partial.n3, partial.popularity, partial.is_open) == (None, None, True)
    assert (partial.fixed().n3, partial.fixed().popularity) == (N3_PARTIAL, 0)


@pytest.mark.parametrize(("given", "n3", "popularity"), [({"n3": 0.3}, 0.3, 0), ({"popularity": 2.0}, N3_PARTIAL, 2)])
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
    with pytest.raises(ArtefactError, match=rf"config\.toml is {'missing' if text is None else 'damaged'}"):
        LinksConfig.read(tmp_path)
