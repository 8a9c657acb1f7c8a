"""Tables of a language model's probabilities, against loops that read one text at a time."""

import json
import shutil

import numpy as np
import pytest
import torch
from helpers import refuses

from wordcraft_kg.apps.elicitation import language_model as module
from wordcraft_kg.apps.elicitation.language_model import (
    DEFAULT,
    elicit_knowledge,
    open_language_model,
    prompts_text,
    read_prompts,
)
from wordcraft_kg.base.errors import ArtefactError, ConfigError, MissingExtraError
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.knowledge.knowledge_folder import TABLES, read_knowledge
from wordcraft_kg.runs.record import read_run

PROMPTS = tuple(
    each for each in read_prompts(DEFAULT) if each.name in ("need", "use", "from", "and", "with")
)


@pytest.fixture(scope="module")
def language_model(model_folder):
    return open_language_model(model_folder)


@pytest.fixture(scope="module")
def written(language_model, kitchen, tmp_path_factory):
    folder = tmp_path_factory.mktemp("knowledge") / "lm"
    elicit_knowledge(folder, kitchen, language_model, PROMPTS)
    return folder


def log_prob(language_model, text, label):
    """Mean over the words of a label of the log-probability of the word after a text."""
    ids = language_model.tokenizer(text, return_tensors="pt").input_ids
    with torch.no_grad():
        logits = language_model.model(ids).logits[0, -1].double().numpy()
    log_probs = logits - np.log(np.exp(logits).sum())
    return np.mean(
        [log_probs[language_model.tokenizer.convert_tokens_to_ids(word)] for word in label.split()]
    )


def information(language_model, prompt, entity, label):
    neutral = [np.exp(log_prob(language_model, text, label)) for text in prompt.neutral]
    return log_prob(language_model, prompt.text(entity), label) - np.log(np.mean(neutral))


def test_a_cell_is_a_difference_of_log_probabilities(written, language_model, kitchen):
    """A cell is the log probability of a label after a text minus that after neutral texts."""
    knowledge, labels = read_knowledge(written), kitchen.entities
    rng = np.random.default_rng(0)
    several = [label for label in labels if " " in label]
    assert several
    for prompt, info, table in zip(PROMPTS, knowledge.record.tables, knowledge.tables, strict=True):
        assert (info.name, info.role, info.phrase) == (prompt.name, prompt.role, prompt.phrase)
        for one, other in [*rng.permutation(labels)[:20].reshape(-1, 2), (several[0], labels[0])]:
            there, back = (
                information(language_model, prompt, *pair) for pair in ((one, other), (other, one))
            )
            expected = {
                "part": back if prompt.about == "result" else there,
                "pair": (there + back) / 2,
            }[prompt.role]
            found = float(table[labels.index(one), labels.index(other)])
            assert found == pytest.approx(expected, abs=0.01), (prompt.name, one, other)
        assert not table.diagonal().any()
        assert prompt.role == "part" or torch.equal(table, table.T)


def test_the_folder_names_graph_weights_and_prompts(written, model_folder, kitchen, tmp_path):
    assert read_prompts(written / "prompts.json") == PROMPTS
    inputs = read_run(written).inputs
    assert inputs.keys() == {"graph", "prompts", "model.safetensors"}
    assert inputs["graph"] == kitchen.hash
    assert inputs["prompts"] == read_run(written).outputs["prompts.json"]
    assert inputs["model.safetensors"] in (written / "README.md").read_text()
    assert "{" not in (written / "README.md").read_text().split("|---|")[1].replace(
        "{e}", ""
    ).replace("{E}", "")


@pytest.mark.parametrize("damage", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_an_interrupted_run_continues_with_the_same_bits(
    written, language_model, kitchen, tmp_path, monkeypatch, damage
):
    after, calls = module._LabelProbabilities.after, []

    def interrupted(self, texts):
        calls.append(len(texts))
        if len(calls) == 9:
            raise KeyboardInterrupt
        return after(self, texts)

    out = tmp_path / "lm"
    monkeypatch.setattr(module._LabelProbabilities, "after", interrupted)
    with pytest.raises(KeyboardInterrupt, match=r"\d+ of 400 texts are saved. Repeat"):
        elicit_knowledge(out, kitchen, language_model, PROMPTS)
    assert not out.exists()
    (saved,) = tmp_path.iterdir()
    if damage:
        file = max(saved.iterdir())
        file.write_bytes(file.read_bytes()[:100])
    done = len(list(saved.iterdir())) - damage
    elicit_knowledge(out, kitchen, language_model, PROMPTS)
    repeated = len(calls) - 9
    assert list(tmp_path.iterdir()) == [out]
    assert (out / TABLES).read_bytes() == (written / TABLES).read_bytes()
    calls[:] = [0] * 9
    elicit_knowledge(out, kitchen, language_model, PROMPTS, force=True)
    assert 0 < repeated <= len(calls) - 9 - done


def test_random_weights_are_a_control_that_depends_on_the_seed_alone(
    model_folder, kitchen, tmp_path
):
    before = torch.random.get_rng_state()
    models = [open_language_model(model_folder, seed) for seed in (0, 0, 1)]
    assert torch.equal(torch.random.get_rng_state(), before)
    tables = [
        elicit_knowledge(tmp_path / str(place), kitchen, model, PROMPTS[:1])
        for place, model in enumerate(models)
    ]
    assert torch.equal(tables[0].tables[0], tables[1].tables[0])
    assert not torch.equal(tables[0].tables[0], tables[2].tables[0])
    assert tables[0].record.source == "language model with random weights"
    assert read_run(tmp_path / "2").inputs["random weights, seed"] == "1"


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind", ["no weights", "no configuration", "cut", "masked", "encoder", "not a model"]
)
def test_what_is_no_whole_causal_model_is_refused(
    kind, model_folder, masked_folder, encoder_folder, tmp_path
):
    folder = tmp_path / "model"
    shutil.copytree(
        {"masked": masked_folder, "encoder": encoder_folder}.get(kind, model_folder), folder
    )
    weights, reason = folder / "model.safetensors", "cannot be loaded as a causal language model"
    if kind == "no weights":
        weights.unlink()
        reason = r"has no weights \("
    elif kind == "no configuration":
        (folder / "config.json").unlink()
        reason = r"has no config\.json"
    elif kind == "cut":
        weights.write_bytes(weights.read_bytes()[: weights.stat().st_size // 2])
    elif kind == "not a model":
        folder = weights
    else:
        reason += {"masked": ".*later tokens", "encoder": r".*the weights lack cls\."}[kind]
    with pytest.raises(ArtefactError, match=reason):
        open_language_model(folder)


def test_a_label_without_tokens_is_refused(language_model, tmp_path):
    graph = RecipeGraph.from_recipes([("flour", "water", "dough"), ("dough", "zqxjkv", "bread")])
    with pytest.raises(ConfigError, match="label 'zqxjkv' has no tokens"):
        elicit_knowledge(tmp_path / "lm", graph, language_model, PROMPTS)
    assert not [*tmp_path.iterdir()]


def test_tables_beyond_the_memory_are_refused(language_model, kitchen, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_LARGEST", 5 * 80 * 80 * 2 - 1)
    with refuses("prompts"):
        elicit_knowledge(tmp_path / "lm", kitchen, language_model, PROMPTS)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"template": "To make it, you need"}, "no {e}"),
        ({"template": "{e} needs "}, "neither start nor end with a blank"),
        ({"neutral": []}, "needs neutral texts"),
        ({"phrase": "{a} goes with {b}"}, "lacks {ingredient} or {result}"),
        ({"role": "whole"}, "'whole'"),
        ({"name": "use"}, "different names"),
    ],
)
def test_prompts_with_a_fault_are_refused(change, reason, tmp_path):
    values = json.loads(prompts_text(PROMPTS))
    values["prompts"][0] |= change
    (tmp_path / "prompts.json").write_text(json.dumps(values))
    with pytest.raises(ArtefactError) as error:
        read_prompts(tmp_path / "prompts.json")
    assert reason in str(error.value)
    with pytest.raises(ArtefactError, match="absent is missing"):
        read_prompts(tmp_path / "absent")


def test_the_command_writes_tables_and_names_a_missing_extra(
    run, model_folder, home, monkeypatch, uninstalled
):
    monkeypatch.chdir(home)
    (home / "prompts.json").write_text(
        prompts_text(tuple(each for each in PROMPTS if each.name == "use"))
    )
    command = (
        "elicit",
        "kitchen",
        "--model",
        model_folder,
        "--prompts",
        "prompts.json",
        "--out",
        "lm",
    )
    outcome = run(*command, "--json")
    values = json.loads(outcome.out)
    assert (outcome.code, values["out"], values["entities"], list(values["tables"])) == (
        0,
        "lm",
        80,
        ["use"],
    )
    assert " makes " in values["tables"]["use"][0]
    assert read_knowledge(home / "lm").record.tables[0].name == "use"
    assert run(*command).kind == "OutputExistsError"
    assert "not on disk" in run("elicit", "kitchen", "--model", "/no/such model").err
    uninstalled("gguf")
    outcome = run(*command, "--force")
    assert outcome.kind == MissingExtraError.__name__
    assert "pip install" in outcome.err
