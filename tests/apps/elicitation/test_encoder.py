"""Vectors of a sentence encoder, and reading them as features."""

import json

import numpy as np
import pytest
import torch
from refusals import refuses
from short_fits import short_fits

from wordcraft_kg import RecipesConfig, RecipeScorerConfig, load_scorer, train_recipes
from wordcraft_kg.apps.elicitation import encoder as module
from wordcraft_kg.apps.elicitation.encoder import encode_labels, write_vectors
from wordcraft_kg.base.errors import ArtefactError, ConfigError
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


def test_vectors_follow_the_labels_whatever_their_order(encoder_folder, kitchen, monkeypatch):
    monkeypatch.setattr(module, "_PART", 32)
    reports = []
    forth, _ = encode_labels(
        kitchen.entities, encoder_folder, lambda *report: reports.append(report)
    )
    assert [done for done, *_ in reports] == [32, 64, 80]
    assert reports[-1] == (80, 80, {"minutes_left": 0.0})
    back, _ = encode_labels(kitchen.entities[::-1], encoder_folder)
    assert np.array_equal(forth, back[::-1])
    assert len(np.unique(forth, axis=0)) > 70
