"""Settings of link predictors: their ranges, and reading them back."""

import re
from dataclasses import replace

import pytest
from refusals import refuses

from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.models.links.config import CONFIGS, N3_PARTIAL, ComplExConfig, LinkModelConfig, LinksConfig

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize("config", [ComplExConfig, LinkModelConfig])
@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("kg", "half"),
        ("epochs", 0),
        ("epochs", -3),
        ("batch_size", 0),
        ("checkpoint_every", 0),
        ("threads", 0),
        ("eval_every", -1),
        ("patience", -1),
        ("seed", -1),
        ("dim", 0),
        ("learning_rate", 0.0),
        ("learning_rate", -1.0),
        ("learning_rate", NAN),
        ("learning_rate", INF),
    ],
)
def test_a_setting_out_of_range_is_an_error_that_names_it_and_its_value(config, setting, value):
    with pytest.raises(ConfigError, match=re.escape(f"`{setting}` {value!r}: expected")):
        config(**{setting: value})


@pytest.mark.parametrize("setting", ["n3", "popularity"])
@pytest.mark.parametrize("value", [-1.0, NAN, INF])
def test_a_regularisation_out_of_range_is_an_error(setting, value):
    with refuses(setting):
        ComplExConfig(**{setting: value})


@pytest.mark.parametrize("value", [0.0, -1e-3, NAN, INF])
def test_an_initial_scale_out_of_range_is_an_error(value):
    with refuses("init_scale"):
        ComplExConfig(init_scale=value)


@pytest.mark.parametrize(("setting", "value"), [("negatives", 0), ("loop", "lcwa")])
def test_settings_of_other_models_out_of_range_are_errors(setting, value):
    with refuses(setting):
        LinkModelConfig(**{setting: value})


@pytest.mark.parametrize("config", [ComplExConfig, LinkModelConfig])
def test_patience_without_validation_is_an_error_that_names_the_missing_setting(config):
    with pytest.raises(ConfigError, match="`eval_every`"):
        config(patience=2)
    assert config(patience=2, eval_every=1).patience == 2


@pytest.mark.parametrize("config", [ComplExConfig, LinkModelConfig])
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


@pytest.mark.parametrize("kg", ["full", "partial"])
def test_a_given_n3_is_kept(kg):
    assert ComplExConfig(kg=kg, n3=0.0).n3 == 0
    assert ComplExConfig(kg=kg, n3=0.7).n3 == 0.7


def test_configurations_are_found_by_their_command():
    assert {name: config().command for name, config in CONFIGS.items()} == {name: name for name in CONFIGS}


def test_a_config_file_fills_the_defaults_of_settings_that_it_lacks(tmp_path):
    (tmp_path / "config.toml").write_text('[train-complex]\ngraph = "kitchen"\ndim = 5\n')
    assert LinksConfig.read(tmp_path) == LinksConfig("kitchen", ComplExConfig(dim=5))


def test_a_missing_config_file_is_an_error_that_says_so(tmp_path):
    with pytest.raises(ArtefactError, match=r"config\.toml is missing"):
        LinksConfig.read(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "not toml",
        '[train-complex]\ngraph = "kitchen"\nepoch = 3\n',
        '[train-complex]\ngraph = "kitchen"\nepochs = 0\n',
        '[train-complex]\ngraph = "kitchen"\nepochs = "ten"\n',
        "[train-complex]\nepochs = 3\n",
        "[train-complex]\ngraph = 3\n",
        '[train-magic]\ngraph = "kitchen"\n',
        '[train-complex]\ngraph = "kitchen"\n[train-links]\ngraph = "kitchen"\n',
        'train-complex = "kitchen"\n',
    ],
    ids=lambda text: text.replace("\n", " ")[:40] or "empty",
)
def test_a_damaged_config_file_is_an_error_that_names_it(tmp_path, text):
    (tmp_path / "config.toml").write_text(text)
    with pytest.raises(ArtefactError, match=r"config\.toml is damaged"):
        LinksConfig.read(tmp_path)


def test_a_config_file_that_is_not_utf8_is_an_error_that_names_it(tmp_path):
    (tmp_path / "config.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ArtefactError, match=r"config\.toml is damaged"):
        LinksConfig.read(tmp_path)
