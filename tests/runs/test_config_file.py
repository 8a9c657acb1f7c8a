"""``config.toml``: what is written is read back, paths move with the folder, and
damage is named."""

from pathlib import Path

import pytest

from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.settings import FeatureSpec
from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig, LinksConfig
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.runs.config_file import read_config, write_config


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A run's folder, ``runs/mine`` of the working folder."""
    monkeypatch.chdir(tmp_path)
    path = Path("runs/mine")
    path.mkdir(parents=True)
    return path


def written(features, folder):
    AgentConfig("kitchen", policy=PolicyConfig(features=features)).write(folder)
    return str(read_config(folder)[1]["features"])


@pytest.mark.parametrize(
    "name", ["glove", "one-hot", "random", "learned", "shuffled:glove", "shuffled:learned"]
)
def test_a_name_of_features_stays_though_a_file_is_called_so(folder, name):
    Path(name.removeprefix("shuffled:")).write_text("a file of mine")
    assert written(name, folder) == name
    assert f'features = "{name}"\n' in (folder / "config.toml").read_text()


@pytest.mark.parametrize("spec", ["vectors.txt", "shuffled:vectors.txt", "./glove"])
def test_a_file_of_features_is_found_from_the_run_s_folder(folder, spec):
    path = spec.removeprefix("shuffled:")
    Path(path).write_text("water 1.0\n")
    assert written(spec, folder) == spec.replace("./", "") or written(spec, folder) == spec
    assert f"../../{Path(path).name}" in (folder / "config.toml").read_text()


@pytest.mark.parametrize(
    ("text", "source", "is_path"),
    [
        ("glove", "glove", False),
        ("learned", "learned", False),
        ("shuffled:shuffled:random", "random", False),
        ("./glove", "./glove", True),
        ("shuffled:vec.txt", "vec.txt", True),
        ("shuffled:", "", True),
    ],
)
def test_a_spec_of_features_is_a_name_or_a_path(text, source, is_path):
    spec = FeatureSpec.parse(text)
    assert (spec.source, spec.is_path, str(spec)) == (source, is_path, text)


@pytest.mark.parametrize(
    "config",
    [
        LinksConfig("kitchen"),
        LinksConfig("kitchen", ComplExConfig(n3=1e-17, init_scale=0.1 + 0.2, learning_rate=1 / 3)),
        LinksConfig(
            'a graph with "quotes" and ⚗', LinkModelConfig(model="tucker", loop="symmetric")
        ),
        AgentConfig("kitchen"),
        AgentConfig(
            "kitchen",
            "models/x",
            TaskConfig(max_attempts=3),
            PolicyConfig(kg_only=True),
            ImpalaConfig(seed=7),
        ),
    ],
    ids=lambda config: type(config).__name__,
)
def test_what_is_written_is_read_back(folder, config):
    config.write(folder)
    assert type(config).read(folder) == config


def test_a_file_that_says_the_same_is_left_alone(folder):
    write_config(folder, "train-complex", {"graph": "kitchen"})
    before = (folder / "config.toml").stat().st_ino
    write_config(folder, "train-complex", {"graph": "kitchen"})
    assert (folder / "config.toml").stat().st_ino == before
    write_config(folder, "train-complex", {"graph": "everyday"})
    assert "everyday" in (folder / "config.toml").read_text()


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('seed = "7"', "seed"),
        ("steps = 1979-05-27", "steps"),
        ("threads = 1.5", "threads"),
        ("kg_only = 1", "kg_only"),
        ("discount = nan", "discount"),
        ("distractors = -1", "distractors"),
        ("graph = 3", "graph"),
        ("unheard = 1", "unheard"),
        ('kg_only = true\nmixing = "free"', "kg_only"),
    ],
)
def test_a_setting_of_another_type_or_out_of_range_is_named(folder, line, problem):
    graph = "" if line.startswith("graph") else 'graph = "kitchen"\n'
    (folder / "config.toml").write_text(f"[train-agent]\n{graph}{line}\n")
    with pytest.raises(ArtefactError, match=rf"config\.toml is damaged.*{problem}"):
        AgentConfig.read(folder)


# --- a configuration is the whole run, and checks itself ------------------------------------------


@pytest.mark.parametrize(
    "policy",
    [
        PolicyConfig(use="u"),
        PolicyConfig(kg_only=True),
        PolicyConfig(scale="none"),
        PolicyConfig(self_edges="keep"),
    ],
    ids=str,
)
def test_settings_of_a_scorer_need_a_scorer(policy):
    with pytest.raises(ConfigError, match="give a `scorer` too"):
        AgentConfig("kitchen", policy=policy)
    # The recommended preset closes what is open: pairs, one attempt, and neither recipe nor plan in `use`.
    # Attention alone can do without its own scores.
    kind = "attention" if policy.kg_only else "pairs"
    closed = policy.closed(policy=kind, mixing="residual")
    assert AgentConfig("kitchen", "models/x", policy=policy).policy == closed


def test_the_full_graph_is_not_validated_on_what_it_holds():
    with pytest.raises(ConfigError, match="contains the validation triples"):
        ComplExConfig(kg="full", eval_every=5)


def test_runs_and_models_have_folders_of_their_own_names():
    assert LinksConfig("g").default_folder("everyday") == Path("models/everyday-partial")
    rotate = LinksConfig("g", LinkModelConfig(model="RotatE", kg="full"))
    assert rotate.default_folder("everyday") == Path("models/everyday-rotate-full")
    assert AgentConfig("g").default_folder("everyday") == Path("runs/everyday-no-kg")
    assert AgentConfig("g", "models/cx").default_folder("everyday") == Path("runs/everyday-cx")


def test_the_file_of_a_made_up_book_stays_found_from_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("book.csv").write_text("")
    Path("run").mkdir()
    write_config(Path("run"), "train-agent", {"graph": "made-up-7:book.csv"})
    assert read_config(Path("run"))[1]["graph"] == "made-up-7:book.csv"
    Path("below").mkdir()
    monkeypatch.chdir("below")
    assert read_config(Path("../run"))[1]["graph"] == "made-up-7:../book.csv"
