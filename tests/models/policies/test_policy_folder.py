"""Making policies from settings, and finding them again in a folder bit by bit, or not at all."""

import json
from collections.abc import Callable

import numpy as np
import pytest
import safetensors.torch
import torch
from helpers import refuses
from link_helpers import flip_bit, global_states, random_graph
from small_scorers import scaled_scorer, states as states_of
from torch import Tensor

from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.graphs import COMBINES_WITH
from wordcraft_kg.models.policies.networks import AttentionPolicy
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.policy_folder import (
    load_policy,
    make_policy,
    read_policy,
    write_constants,
    write_parameters,
)
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.features import make_features
from wordcraft_kg.runs.record import end_run, start_run

GRAPH = random_graph(num_entities=8, num_recipes=20)
SIZE = GRAPH.num_entities
SLOTS = 4
SIZES = {"key_size": 5, "value_size": 4, "hidden_size": 6}
SCORER = FrequencyScorer(GRAPH, GRAPH.triples)
FILES = ("constants.safetensors", "policy.json", "policy.safetensors")

KINDS = {
    "one-hot": {"features": "one-hot"},
    "random": {"features": "random", "value_readout": "logits"},
    "shuffled one-hot": {"features": "shuffled:one-hot"},
    "a file": {"features": "a file", "pooling": "max"},
    "u and v": {"features": "one-hot", "scorer": SCORER},
    "u and v, softmax": {"features": "random", "scorer": SCORER, "mixing": "softmax"},
    "u and v, residual": {"features": "one-hot", "scorer": SCORER, "mixing": "residual"},
    "u": {
        "features": "random",
        "scorer": SCORER,
        "use": "u",
        "scale": "ranks",
        "self_edges": "keep",
    },
    "v only": {
        "features": "one-hot",
        "scorer": SCORER,
        "use": "v",
        "kg_only": True,
        "self_edges": "drop",
    },
    "mlp on random": {"policy": "mlp", "features": "random"},
}
any_kind = pytest.mark.parametrize("kind", KINDS)


@pytest.fixture
def vector_file(home):
    """A text file with a vector for each entity."""
    path = home / "vectors.txt"
    rows = np.random.default_rng(0).normal(size=(SIZE, 3)).round(3).astype(str).tolist()
    path.write_text(
        "\n".join(" ".join([name, *row]) for name, row in zip(GRAPH.entities, rows, strict=True))
    )
    return path


@pytest.fixture
def make(vector_file):
    """Make one of the kinds of policies."""

    def make(kind, seed=0):
        features = KINDS[kind]["features"]
        return plain(
            **{**KINDS[kind], "features": str(vector_file) if features == "a file" else features},
            seed=seed,
        )

    return make


def plain(features="one-hot", seed=0, scorer=None, observed=GRAPH.triples, graph=GRAPH, **settings):
    config = PolicyConfig(**SIZES, features=features, **settings)
    return make_policy(config, graph, SLOTS, scorer=scorer, observed=observed, seed=seed)[0]


def states():
    return states_of(SIZE, 10, SLOTS)


def assert_equal_bits(one, other):
    assert type(one) is type(other)
    assert one.config == other.config
    assert one.labels == other.labels
    assert one.state_dict().keys() == other.state_dict().keys()
    for name, tensor in one.state_dict().items():
        assert torch.equal(tensor, other.state_dict()[name]), name
    for found, expected in zip(one(States(*states())), other(States(*states())), strict=True):
        assert (found is None and expected is None) or torch.equal(found, expected)


def train_a_step(policy):
    logits, value, *_ = policy(States(*states()))
    (logits[logits.isfinite()].sum() + value.sum()).backward()
    torch.optim.SGD(policy.parameters(), lr=0.1).step()


@any_kind
def test_the_same_seed_makes_the_same_policy_and_another_seed_another(make, kind):
    assert_equal_bits(make(kind, seed=3), make(kind, seed=3))
    one, other = (dict(make(kind, seed=seed).named_parameters()) for seed in (3, 4))
    differing = {name for name in one if not torch.equal(one[name], other[name])}
    constant = {"mixture.2.bias", "lambdas.step"}
    assert one.keys() - constant <= differing


@any_kind
def test_making_a_policy_leaves_every_global_generator_as_it_was(make, kind, monkeypatch):
    seeded_devices = []
    monkeypatch.setattr(torch.cuda, "manual_seed_all", seeded_devices.append)
    before = global_states()
    make(kind)
    assert global_states() == before
    assert seeded_devices == []


@pytest.mark.parametrize(
    "features", ["one-hot", "random", "shuffled:one-hot", "shuffled:random", "a file"]
)
def test_vectors_are_those_of_the_features_for_the_seed(features, vector_file):
    spec = str(vector_file) if features == "a file" else features
    made, found = make_policy(PolicyConfig("attention", spec, **SIZES), GRAPH, SLOTS, seed=5)
    expected = make_features(spec, GRAPH.entities, seed=5)
    assert found.sha256 == expected.sha256
    assert made.vectors.is_one_hot is (features == "one-hot")
    assert made.vectors.dim == expected.vectors.shape[1]
    if not made.vectors.is_one_hot:
        np.testing.assert_array_equal(made.vectors.vectors[:-1].numpy(), expected.vectors)
        assert not made.vectors.vectors.requires_grad
    assert made(States(*states())).logits.shape == (10, SLOTS)


def test_a_scorer_is_mixed_in_on_the_scale_of_the_settings():
    triples = np.array([[2, COMBINES_WITH, 2]])
    for settings in (
        {"scale": "ranks", "self_edges": "keep"},
        {"scale": "none", "self_edges": "drop"},
        {"scale": "standardise", "self_edges": "observed", "observed": triples},
    ):
        policy = plain(scorer=SCORER, **settings)
        expected = scaled_scorer(SCORER, **settings)
        for name, relation in (("u", "combinesWith"), ("v", "componentOf")):
            assert torch.equal(policy.sources[name].scores[:-1, :-1].T, expected.table(relation))
    with pytest.raises(ConfigError, match="'observed' needs the scorer's training triples"):
        plain(scorer=SCORER, self_edges="observed", observed=None)


def test_a_scorer_of_another_graph_is_refused():
    other = random_graph(seed=1, num_entities=8, num_recipes=20)
    assert other.num_entities == SIZE
    with pytest.raises(GraphMismatchError, match=f"was trained on graph {other.hash[:12]}"):
        plain(scorer=FrequencyScorer(other, other.triples))


@pytest.mark.parametrize(
    ("setting", "options"),
    [("policy", {"policy": "mlp", "scorer": SCORER}), ("kg_only", {"kg_only": True})],
)
def test_settings_that_do_not_go_together_are_refused(setting, options):
    with refuses(setting):
        plain(**options)


def test_only_an_mlp_depends_on_the_number_of_slots():
    for kind, shapes in (("mlp", 2), ("attention", 1)):
        config = PolicyConfig(kind, "random", **SIZES)
        made = [make_policy(config, GRAPH, slots)[0] for slots in (SLOTS, SLOTS + 1)]
        assert (
            len({tuple(tuple(p.shape) for p in policy.parameters()) for policy in made}) == shapes
        )
    assert isinstance(made[0], AttentionPolicy)
    assert plain("random", policy="mlp").num_slots == SLOTS


def written(folder, policy, graph=GRAPH):
    folder.mkdir(exist_ok=True)
    write_constants(folder, policy)
    write_parameters(folder, policy)
    return folder


def read(folder):
    parameters = safetensors.torch.load_file(folder / "policy.safetensors")
    return read_policy(folder, (folder / "constants.safetensors").read_bytes(), parameters)


@any_kind
def test_a_policy_is_the_same_bit_by_bit_after_reading_it(make, kind, tmp_path):
    policy = make(kind)
    train_a_step(policy)
    found = read(written(tmp_path / "run", policy))
    assert_equal_bits(found, policy)
    assert not found.training
    trainable = {name for name, parameter in found.named_parameters() if parameter.requires_grad}
    assert trainable == {name for name, _ in policy.named_parameters()}


def test_sources_that_share_a_tensor_are_written_with_a_copy_each(make, tmp_path):
    policy = make("u and v")
    policy.sources["v"].scores = policy.sources["u"].scores
    written(tmp_path, policy)
    assert_equal_bits(read(tmp_path), policy.eval())


def test_restored_sources_of_one_scorer_share_its_lists(cross_fitted, kitchen, tmp_path):
    """w and p of a restored policy do not make and keep the same neighbour lists twice."""
    policy = plain(use="recipe,plan", scorer=cross_fitted, graph=kitchen, observed=None)
    written(tmp_path, policy)
    found = read(tmp_path)
    w, p = found.sources.values()
    assert w.knowledge.lists() is p.knowledge.lists()


@pytest.mark.parametrize("rows", [0, 1, -1])
def test_knowledge_with_fewer_rows_than_entities_is_refused(cross_fitted, kitchen, tmp_path, rows):
    """Compiled loops would read past the arrays."""
    policy = plain(use="recipe,plan", scorer=cross_fitted, graph=kitchen, observed=None)
    path = written(tmp_path, policy) / "constants.safetensors"
    tensors = safetensors.torch.load_file(path)
    size = len(tensors["sources.p.knowledge.vectors"][:rows])
    for name, tensor in tensors.items():
        if name.endswith(("recipes", "near_words")):
            tensor.clamp_(max=max(size - 1, 0))
        if name.endswith(("knowledge.vectors", "near_words")):
            tensors[name] = tensor[:rows].clone()
    path.write_bytes(safetensors.torch.save(tensors))
    with pytest.raises(ArtefactError, match=f"vectors has {size} rows; expected .* 80|outside 0"):
        read(tmp_path)


def test_weights_that_overflow_are_refused_when_they_are_used(tmp_path):
    policy = plain("random", scorer=SCORER, scale="none", mixing="free")
    for parameter in policy.parameters():
        torch.nn.init.constant_(parameter, 1e6)
    policy.vectors.vectors.fill_(1e6)
    loaded = read(written(tmp_path, policy))
    with pytest.raises(ArtefactError, match="logits are not finite"):
        loaded.act(0, [1, 2])


@pytest.fixture
def folder(tmp_path):
    """A finished run with nothing in it but a policy."""
    folder = written(tmp_path / "run", plain("random", scorer=SCORER))
    end_run(folder, start_run(folder, "train-agent"), "done", FILES)
    return folder


def edited(folder, **changes):
    path = folder / "policy.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return folder


def test_a_finished_run_is_all_that_a_policy_needs(folder):
    policy = load_policy(str(folder))
    assert_equal_bits(policy, read(folder))
    assert (policy.entities, policy.graph_hash) == (GRAPH.entities, GRAPH.hash)


@pytest.mark.parametrize("name", [*FILES, "run.json"])
def test_a_changed_or_missing_file_is_named(folder, name):
    """A file that is changed or missing is an artefact error that names it."""
    flip_bit(folder / name, 0, bit=5)
    with pytest.raises(ArtefactError, match=f"{name} is damaged"):
        load_policy(folder)
    (folder / name).unlink()
    with pytest.raises(ArtefactError, match=rf"{name} is missing|has none of .*{name}"):
        load_policy(folder)


@pytest.mark.parametrize(
    "changes",
    [
        {"format": "wordcraft-kg policy 0"},
        *(
            {"settings": value}
            for value in (None, {"policy": 5}, {"use": 5}, {"key_size": "5"}, {"unheard": 1})
        ),
        {"settings": {**SIZES, "features": "random", "key_size": 6}},
        {"settings": {**SIZES, "features": "random", "policy": "mlp"}},
        *({"entities": value} for value in (5, list(GRAPH.entities[:-1]), None)),
        {"entities": [list(GRAPH.entities)]},
        {"entities": [GRAPH.entities[0]] * SIZE},
        *({"dim": value} for value in (0, -1, 2_000_000, 2**62, 2**63 - 1, 10**30, "many")),
        *({"sources": value} for value in (["u"], [], None)),
    ],
    ids=str,
)
def test_a_description_that_does_not_fit_the_weights_is_an_artefact_error(folder, changes):
    with pytest.raises(ArtefactError, match=r"policy\.json (and the weights|is damaged)"):
        read(edited(folder, **changes))


@pytest.mark.parametrize("slots", [None, "4", SLOTS + 1, -3, 0, 40_000, 2**62, 2**63 - 1])
def test_other_slots_and_cut_constants_are_artefact_errors(tmp_path, slots):
    """An mlp with other slots and truncated constants are artefact errors."""
    folder = written(tmp_path, plain("random", policy="mlp"))
    parameters = safetensors.torch.load_file(folder / "policy.safetensors")
    for kept in (0, 7, 100, -1):
        with pytest.raises(ArtefactError, match=r"constants\.safetensors is damaged"):
            read_policy(folder, (folder / "constants.safetensors").read_bytes()[:kept], parameters)
    with pytest.raises(ArtefactError, match=r"policy\.json (and the weights|is damaged)"):
        read(edited(folder, num_slots=slots))


Tensors = dict[str, Tensor]
BIAS = "value.0.bias"
SPOILT: dict[str, tuple[Callable[[Tensors], Tensors], str]] = {
    "none": (lambda all: {}, "do not make a policy"),
    "two missing": (
        lambda all: {k: x for k, x in all.items() if k not in (BIAS, "attention.key.weight")},
        "Missing key",
    ),
    "one too many": (lambda all: all | {"unheard": all[BIAS]}, "do not make a policy"),
    "of another shape": (lambda all: all | {BIAS: all[BIAS][:-1]}, "do not make a policy"),
    **{
        str(dtype): (
            lambda all, dtype=dtype: all | {BIAS: all[BIAS].to(dtype)},
            rf"value\.0\.bias has type {dtype}, shape \(4,\); settings and entities need",
        )
        for dtype in (torch.complex64, torch.int64, torch.float64)
    },
}


@pytest.mark.parametrize("kind", SPOILT)
def test_parameters_that_do_not_fit_are_an_artefact_error_of_one_line(folder, kind):
    constants = (folder / "constants.safetensors").read_bytes()
    whole = safetensors.torch.load_file(folder / "policy.safetensors")
    spoil, fragment = SPOILT[kind]
    with pytest.raises(ArtefactError, match=fragment) as refusal:
        read_policy(folder, constants, spoil(whole))
    assert "\n" not in str(refusal.value)
    assert_equal_bits(read_policy(folder, constants, whole), read(folder))
