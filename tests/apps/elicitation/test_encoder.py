"""Vectors of a sentence encoder, and reading them as features."""

import io
import json
import os
import shutil
import sys
from importlib.metadata import version

import numpy as np
import pytest
import torch
from helpers import refuses
from short_fits import short_fits

from wordcraft_kg import RecipesConfig, RecipeScorerConfig, load_scorer, train_recipes
from wordcraft_kg.apps.elicitation.encoder import encode_labels, write_vectors
from wordcraft_kg.apps.elicitation.language_model import open_language_model
from wordcraft_kg.base.errors import ArtefactError, ConfigError, MissingExtraError
from wordcraft_kg.models.recipes.inductive import with_words
from wordcraft_kg.models.scorers.features import make_features
from wordcraft_kg.runs.record import read_run


@pytest.fixture(scope="module")
def vectors(encoder_folder, kitchen, tmp_path_factory):
    labels = (*kitchen.entities, "flour bread")
    made, hashes = encode_labels(labels, encoder_folder)
    out = tmp_path_factory.mktemp("vectors") / "kitchen"
    return write_vectors(out, labels, made, inputs={"graph": kitchen.hash, **hashes})


def test_a_vector_is_the_mean_over_the_tokens_with_length_1(
    vectors, encoder_folder, tokenizer, kitchen
):
    from transformers import AutoModel

    model = AutoModel.from_pretrained(encoder_folder).eval()
    features = make_features(str(vectors), kitchen.entities)
    for label, vector in list(zip(kitchen.entities, features.vectors, strict=True))[::7]:
        with torch.no_grad():
            states = model(**tokenizer(label, return_tensors="pt")).last_hidden_state[0]
        expected = (states.mean(0) / states.mean(0).norm()).numpy()
        np.testing.assert_allclose(vector, expected, atol=2e-3)
    assert features.vectors.dtype == np.float32
    assert features.source == "kitchen, 16-d"


def test_vectors_of_another_book_or_changed_ones_are_refused(vectors, tmp_path):
    with refuses("features"):
        make_features(str(vectors), ["iron", "gold", "flour"])
    with pytest.raises(
        ValueError,
        match=r"2 of 3.*gold, iron\. These are vectors of another book; "
        "encode this graph and any books in `with`",
    ):
        make_features(str(vectors), ["iron", "gold", "flour"])
    labels = vectors / "vectors.labels.txt"
    before = labels.read_text()
    labels.write_text(before[::-1])
    try:
        with pytest.raises(ArtefactError, match="SHA-256 differs"):
            make_features(str(vectors), ["flour"])
    finally:
        labels.write_text(before)
    with pytest.raises(ArtefactError, match="expected a file or folder with vectors"):
        make_features(str(tmp_path), ["flour"])


def test_a_recipe_scorer_learns_a_folders_further_labels(vectors, opened_kitchen, tmp_path):
    """A recipe scorer learns from a folder and scores its further labels."""
    settings = RecipeScorerConfig(kg="full", folds=2, features=str(vectors))
    config = RecipesConfig(opened_kitchen.source, settings)
    with short_fits():
        folder = train_recipes(config, tmp_path / "model").folder
    assert "flour bread" in with_words(folder, load_scorer(folder), ["flour bread"]).entities
    with pytest.raises(LookupError, match=r"'water bread'.*--labels LABEL"):
        with_words(folder, load_scorer(folder), ["water bread"])


def test_a_label_of_unknown_words_alone_is_refused(encoder_folder):
    encode_labels(["flour zqxjkv"], encoder_folder)
    with pytest.raises(ConfigError, match="label 'zqxjkv' has no tokens"):
        encode_labels(["flour", "zqxjkv"], encoder_folder)


@pytest.fixture
def static_folder(kitchen, tmp_path):
    """Return a function that makes an encoder of word vectors, with given numbers of rows and
    settings of the tokenizer."""

    def make(rows, **settings):
        from sentence_transformers import SentenceTransformer
        from sentence_transformers.sentence_transformer.modules import StaticEmbedding
        from tokenizers import Tokenizer, models, pre_tokenizers

        words = ("[UNK]", "flour", "water", "egg")
        tokenizer = Tokenizer(
            models.WordLevel(dict(zip(words, range(4), strict=True)), unk_token="[UNK]")
        )
        tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
        weights = np.eye(4, 8, dtype=np.float32)[:rows]
        module = StaticEmbedding(tokenizer, embedding_weights=weights)
        folder = tmp_path / "static"
        SentenceTransformer(modules=[module], device="cpu").save(str(folder))
        (folder / "config.json").write_text("{}")
        path = folder / "tokenizer.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | settings))
        return folder

    return make


def test_word_vectors_with_a_row_for_each_token_are_an_encoder(static_folder):
    vectors, _ = encode_labels(["flour", "egg water"], static_folder(4))
    assert vectors.argmax(1).tolist() == [1, 2]


@pytest.mark.parametrize(
    ("rows", "settings", "says"),
    [
        (2, {}, "static' fails: .*range"),
        (
            4,
            {
                "truncation": {
                    "direction": "Right",
                    "max_length": 1,
                    "strategy": "LongestFirst",
                    "stride": 5,
                }
            },
            "static' fails: PanicException: `stride` must",
        ),
    ],
)
def test_tokens_without_a_row_and_a_panic_of_the_tokenizer_are_errors_that_name_the_model(
    static_folder, rows, settings, says
):
    with pytest.raises(ArtefactError, match=says):
        encode_labels(["flour egg water", "egg"], static_folder(rows, **settings))


def test_the_command_writes_vectors_of_all_labels(run, encoder_folder, home, monkeypatch):
    monkeypatch.chdir(home)
    outcome = run(
        "encode", "kitchen", "--encoder", encoder_folder, "--labels", "flour bread,milk", "--json"
    )
    values = json.loads(outcome.out)
    assert (outcome.code, values["labels"], values["dimensions"]) == (0, 81, 16)
    assert values["out"] == "vectors/kitchen"
    assert read_run(home / "vectors/kitchen").inputs.keys() == {"graph", "model.safetensors"}
    (home / "other.csv").write_text(
        "ingredient_a,ingredient_b,result\nflour,bread flour,water flour\n"
    )
    both = run(
        "encode", "kitchen", "other.csv", "--encoder", encoder_folder, "--out", "both", "--json"
    )
    assert (both.code, json.loads(both.out)["labels"]) == (0, 82)
    outcome = run(
        "encode", "kitchen", "--encoder", encoder_folder / "config.json", "--out", "other"
    )
    assert (outcome.code, outcome.kind) == (1, "ArtefactError")
    assert "cannot be loaded as a sentence encoder" in outcome.err
    assert not (home / "other").exists()


REFS = {"AutoConfig": "evil.Evil", "AutoModel": "evil.Evil", "AutoModelForCausalLM": "evil.Evil"}


@pytest.fixture(scope="module")
def sentence_folder(encoder_folder, tmp_path_factory):
    """A sentence encoder with modules; read only."""
    # Here, as the import takes more than a second of each process that collects tests.
    from sentence_transformers import SentenceTransformer

    folder = tmp_path_factory.mktemp("sentence") / "encoder"
    SentenceTransformer(str(encoder_folder)).save(str(folder))
    return folder


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A copy of a folder with a program that leaves a mark when it is run; a user
    would answer yes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO("y\n" * 100))
    code = f"open({str(tmp_path / 'mark')!r}, 'w')\nclass Evil:\n    pass\n"

    def copied(folder):
        shutil.copytree(folder, tmp_path / "model")
        for place in (tmp_path, tmp_path / "model"):
            (place / "evil.py").write_text(code)
        return tmp_path / "model"

    yield copied
    assert not (tmp_path / "mark").exists()


def change(file, **values):
    before = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps({**before, **values}))


def first_module(folder, **values):
    modules = json.loads((folder / "modules.json").read_text())
    modules[0].update(values)
    (folder / "modules.json").write_text(json.dumps(modules))


def as_pickle(folder):
    (folder / "model.safetensors").unlink()
    torch.save({"weight": torch.zeros(1)}, folder / "pytorch_model.bin")


def index_of_a_pickle(folder):
    (folder / "model.safetensors").rename(folder / "weights.safetensors")
    change(folder / "model.safetensors.index.json", metadata={}, weight_map={"x": "evil.bin"})


def linked_out(folder):
    (folder / "model.safetensors").unlink()
    (folder / "model.safetensors").symlink_to("/etc/passwd")


def as_a_pipe(folder):
    (folder / "tokenizer_config.json").unlink()
    os.mkfifo(folder / "tokenizer_config.json")


MODELS = {
    "code": (
        lambda at: change(at / "config.json", model_type="evil", auto_map=REFS),
        "its own Python code",
    ),
    "code of an unknown tokenizer": (
        lambda at: change(
            at / "tokenizer_config.json",
            tokenizer_class="EvilTokenizer",
            auto_map={"AutoTokenizer": ["evil.Evil", "evil.Evil"], "AutoProcessor": "evil.Evil"},
        ),
        "its own Python code",
    ),
    "code of a tokenizer": (
        lambda at: change(at / "tokenizer_config.json", tokenizer_class="AutoModel"),
        "'AutoModel', which is no class of a tokenizer",
    ),
    "a kernel": (
        lambda at: change(at / "config.json", attn_implementation="me/evil"),
        "a kernel to download, 'me/evil'",
    ),
    "another model": (lambda at: change(at / "adapter_config.json"), "is an adapter"),
    "a pickle": (as_pickle, r"pickle only, pytorch_model\.bin"),
    "a pickle in an index": (index_of_a_pickle, r"names 'evil\.bin'"),
    "a link": (linked_out, "link out of the model folder, to /etc/passwd"),
    "a pipe": (as_a_pipe, "not a regular file"),
    "many layers": (
        lambda at: change(at / "config.json", num_hidden_layers=10**9),
        "num_hidden_layers is 1,000,000,000",
    ),
    "many labels": (
        lambda at: change(at / "config.json", num_labels=10**6),
        "num_labels is 1,000,000",
    ),
    "many words": (lambda at: change(at / "config.json", vocab_size=10**12), "is damaged: config"),
}

READERS = {
    "encode": lambda folder: encode_labels(["flour"], folder),
    "elicit": open_language_model,
    "elicit random": lambda folder: open_language_model(folder, 0),
}


@pytest.mark.parametrize(("spoil", "says"), MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("reader", READERS)
def test_a_model_that_names_code_or_sizes_is_refused_by_name(
    evil, sentence_folder, model_folder, spoil, says, reader
):
    folder = evil(sentence_folder if reader == "encode" else model_folder)
    spoil(folder)
    with pytest.raises(ArtefactError, match=says):
        READERS[reader](folder)


@pytest.mark.parametrize(
    "kind",
    [
        *("evil.Evil", "os.system", "", None),
        "sentence_transformers.base.model.torch",  # what a module of the package imports
        "sentence_transformers.base.modules.router.Router",  # names further classes in its own file
    ],
)
def test_a_foreign_module_of_a_sentence_encoder_is_refused_by_name(evil, sentence_folder, kind):
    folder = evil(sentence_folder)
    first_module(folder, type=kind)
    with pytest.raises(ArtefactError) as raised:
        encode_labels(["flour"], folder)
    assert f"modules.json' names the module {kind!r}" in str(raised.value)


@pytest.mark.parametrize("path", ["../model", "/etc", "a/b", 1])
def test_a_module_outside_its_folder_is_refused(evil, sentence_folder, path):
    folder = evil(sentence_folder)
    first_module(folder, path=path)
    with pytest.raises(ArtefactError, match="expected the name of a folder"):
        encode_labels(["flour"], folder)


@pytest.mark.parametrize("option", ["trust_remote_code", "weights_only", "code_revision"])
def test_an_option_that_the_loader_decides_is_refused_in_a_folder(evil, sentence_folder, option):
    folder = evil(sentence_folder)
    change(folder / "sentence_bert_config.json", model_args={option: True})
    with pytest.raises(ArtefactError, match=f"sets the loader's option '{option}'"):
        encode_labels(["flour"], folder)


def test_code_beside_a_kind_that_transformers_knows_is_not_run(evil, sentence_folder, tmp_path):
    before, _ = encode_labels(["flour"], sentence_folder)
    folder = evil(sentence_folder)
    change(folder / "config.json", auto_map=REFS)
    after, _ = encode_labels(["flour"], folder)
    assert (before == after).all()


def test_a_model_in_the_cache_of_the_hub_loads_through_its_links(sentence_folder, tmp_path):
    snapshot, blobs = tmp_path / "snapshots" / "a1", tmp_path / "blobs"
    shutil.copytree(sentence_folder, snapshot)
    blobs.mkdir()
    (snapshot / "model.safetensors").rename(blobs / "b1")
    (snapshot / "model.safetensors").symlink_to("../../blobs/b1")
    assert encode_labels(["flour"], snapshot)[0].shape == (1, 16)


def test_a_name_on_the_hub_downloads_no_code_and_no_pickle(monkeypatch, tmp_path):
    from wordcraft_kg.apps.elicitation import foreign_code as weights

    asked = {}
    monkeypatch.setattr(
        "huggingface_hub.snapshot_download",
        lambda name, **options: asked.update(options) or str(tmp_path),
    )
    assert weights.locate_model("encoder", "me/evil") == tmp_path
    assert {"*.py", "*.bin", "*.pkl"} <= set(asked["ignore_patterns"])


def test_an_old_version_that_runs_the_code_of_folders_is_refused(monkeypatch, sentence_folder):
    monkeypatch.setattr(
        "wordcraft_kg.base.extras.version",
        lambda name: "5.1.0" if name == "sentence-transformers" else version(name),
    )
    with pytest.raises(
        MissingExtraError, match=r"has version 5\.1\.0, expected >=6\.0\.1; earlier"
    ):
        encode_labels(["flour"], sentence_folder)
