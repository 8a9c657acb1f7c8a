import gzip
import io
import math
import os
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from small_scorers import cosine

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import (
    RecipeGraph,
    SplitConfig,
    known_books,
    make_split,
    open_book,
    recipe_triples,
)
from wordcraft_kg.models.scorers import features as features_module
from wordcraft_kg.models.scorers.features import (
    BUILT_IN,
    EntityFeatures,
    glove_features,
    make_features,
    named,
)
from wordcraft_kg.models.scorers.near_synonyms import (
    near_synonym_recipes,
    near_synonym_triples,
)


def test_the_vector_of_the_is_gloves():
    # The first numbers of the first line of the published glove.6B.50d.txt.
    features = glove_features(["the"])
    np.testing.assert_allclose(
        features.vectors[0, :4], [0.418, 0.24968, -0.41242, 0.1217], rtol=1e-5
    )
    assert (features.vectors.shape, features.vectors.dtype) == ((1, 50), np.float32)


def test_a_phrase_is_the_mean_of_its_words_whatever_their_case():
    features = glove_features(["Black  Hole", "black", "hole"])
    np.testing.assert_allclose(features.vectors[0], features.vectors[1:].mean(0), rtol=1e-6)


def test_words_without_a_vector_are_named_and_left_out_of_the_mean():
    features = glove_features(["zqxjkv", "water zqxjkv", "water"])
    assert features.missing_words == ("zqxjkv",)
    assert features.known.tolist() == [False, True, True]
    assert not features.vectors[0].any()
    np.testing.assert_array_equal(features.vectors[1], features.vectors[2])
    assert np.isfinite(features.unit_vectors).all()
    assert not features.unit_vectors[0].any()


def test_features_follow_the_order_of_the_labels_and_cannot_be_changed():
    labels = ["sea", "iron", "bread", "sea"]
    features = glove_features(labels)
    again = glove_features(labels[::-1])
    np.testing.assert_array_equal(features.vectors, again.vectors[::-1])
    np.testing.assert_allclose(np.linalg.norm(features.unit_vectors, axis=1), 1, rtol=1e-5)
    for array in (features.vectors, features.known, features.unit_vectors):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def refused(spec, labels=("sea", "iron"), **options):
    """Return the message that these features are refused with."""
    with pytest.raises(ConfigError) as error:
        make_features(str(spec), labels, **options)
    return str(error.value)


def test_max_pooling_takes_the_larger_of_the_words_in_each_dimension():
    made = make_features("glove", ["black hole", "black", "hole", "hole zqxjkv"], pooling="max")
    black, hole = made.vectors[1:3].tolist()
    assert made.vectors[0].tolist() == [max(pair) for pair in zip(black, hole, strict=True)]
    assert made.vectors[3].tolist() == hole
    assert made.source == "GloVe 6B, 50-d, max of words"


NOWHERE = ["", "vectors/none.txt", "x" * 5000, "a\0b", "shuffled:"]
UNKNOWN = {
    "glov": "'glove'",
    "onehot": "'one-hot'",
    "shufled:random": "'shuffled:random'",
    "shuffled:glov": "'glove'",
}


@pytest.mark.parametrize(
    ("spec", "labels", "options", "fragment"),
    [
        ("glove", "ab", {"pooling": "maxx"}, "`pooling` 'maxx'"),
        ("random", "ab", {"seed": -1}, "`seed` -1"),
        # 8,192 ** 2 floats are 2 ** 28 bytes
        (
            "one-hot",
            range(8193),
            {},
            "8,193 entities take 268,500,996 bytes; expected at most 268,435,456",
        ),
        *(
            ("glove", ["zqxjkv"], {"allow_missing": allowed}, "1 of 1 entities")
            for allowed in (0, 1)
        ),
        *((spec, "ab", {}, f"Did you mean {meant}") for spec, meant in UNKNOWN.items()),
        *(
            (spec, "ab", {}, "expected a file or folder, or one of auto, minilm, glove,")
            for spec in NOWHERE
        ),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(
    spec, labels, options, fragment, home, monkeypatch
):
    monkeypatch.chdir(home)
    assert fragment in refused(spec, labels, **options)


def test_every_built_in_label_has_a_sentence_vector():
    """Every label of the built in books has a vector of the sentence encoder."""
    files = list(BUILT_IN.parent.iterdir())
    assert sum(file.stat().st_size for file in files) <= 1_000_000
    assert "Apache License 2.0" in (BUILT_IN.parent / "NOTICE.md").read_text()
    for book in (book for book in known_books() if book.origin == "built in"):
        labels = open_book(book.name).entities
        made = make_features("auto", labels)
        assert (named("auto", labels), made.source) == ("minilm", "all-MiniLM-L6-v2, 384-d")
        assert made.known.all()
        np.testing.assert_allclose(np.linalg.norm(made.vectors, axis=1), 1, atol=1e-3)
    lake, river, bread = make_features("minilm", ["lake", "River", "bread"]).vectors
    assert lake @ river > lake @ bread + 0.2
    # As that encoder gives it: its weights are pinned in data/make_vectors.py.
    np.testing.assert_allclose(bread[:4], [-0.0197, 0.0723, -0.0278, 0.0304], atol=1e-3)


def test_auto_is_glove_unless_all_labels_are_built_in():
    labels = ["bread", "black forest"]
    assert [named("auto", some) for some in (labels[:1], labels)] == ["minilm", "glove"]
    assert named("shuffled:auto", labels[:1]) == "shuffled:minilm"
    assert named("one-hot", labels) == "one-hot"
    np.testing.assert_array_equal(
        make_features("auto", labels).vectors, glove_features(labels).vectors
    )
    said = refused("minilm", [*labels, "water"])
    assert (
        "1 of 3 entities have no vector. Unknown words: black forest. These are vectors of the "
        "built-in" in said
    )
    assert "wordcraft-kg encode" in said
    made_up = open_book("made-up:kitchen").entities
    assert f"{len(made_up)} of {len(made_up)} entities have no vector" in refused("auto", made_up)


def test_one_hot_is_the_identity_up_to_its_limit(monkeypatch):
    monkeypatch.setattr(features_module, "ONE_HOT_LIMIT", 3 * 3 * 4)
    made = make_features("one-hot", ["a", "b", "c"])
    assert made.vectors.tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert made.vectors.dtype == np.float32
    assert made.is_one_hot
    assert made.known.all()
    assert made.missing_words == ()
    assert "one-hot features for 4 entities" in refused("one-hot", "abcd")


def test_a_row_of_random_features_depends_on_its_place_and_the_seed_only():
    made, again, other = (
        make_features("random", ["sea", "iron", "bread"], seed=seed) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(
        made.vectors[:2], make_features("random", ["x", "y"], seed=3).vectors
    )
    assert made.sha256 == again.sha256
    assert not np.isin(made.vectors, other.vectors).any()
    assert len(np.unique(made.vectors)) == made.vectors.size
    expected = np.random.default_rng(3).laplace(0, 0.4 / math.sqrt(2), (3, 300))
    np.testing.assert_array_equal(made.vectors, expected.astype(np.float32))


@pytest.mark.parametrize("spec", ["glove", "random", "one-hot"])
def test_shuffling_deals_the_same_rows_to_other_entities(spec):
    labels = [*open_book("kitchen").entities[:29], "zqxjkv"]
    plain = make_features(spec, labels, seed=1)
    made, again, other = (
        make_features(f"shuffled:{spec}", labels, seed=seed) for seed in (1, 1, 2)
    )
    order = [plain.vectors.tolist().index(row) for row in made.vectors.tolist()]
    assert sorted(order) == list(range(30))
    assert order != list(range(30))
    np.testing.assert_array_equal(made.known, plain.known[order])
    assert made.missing_words == plain.missing_words
    assert made.sha256 == again.sha256
    assert len({made.sha256, plain.sha256, other.sha256}) == 3
    assert not made.is_one_hot
    assert made.source == f"{plain.source}, shuffled with seed 1"


def test_a_name_goes_before_a_file_that_is_called_so(home, monkeypatch):
    monkeypatch.chdir(home)
    Path("random").write_text("sea 1 2\niron 3 4\n")
    assert make_features("random", ["sea"]).vectors.shape == (1, 300)
    assert make_features("./random", ["sea"]).vectors.tolist() == [[1, 2]]


def test_more_than_a_fifth_without_a_vector_is_refused_unless_allowed():
    assert make_features("glove", ["sea"] * 4 + ["zqxjkv"]).known.tolist() == [True] * 4 + [False]
    labels = ["sea"] * 18 + [f"zqx{i:02} waterzqx" if i % 2 else f"zqx{i:02}" for i in range(24)]
    message = refused("glove", labels)
    listed = ", ".join(f"zqx{i:02}" for i in range(19))
    assert (
        f"24 of 42 entities have no vector. Unknown words: waterzqx, {listed} and 5 more. "
        "Labels are split at blanks, _, -, :, / and capitals; " in message
    )
    assert "`features` one-hot, which needs no words, or `allow_missing`" in message
    assert refused("shuffled:glove", labels) == message
    made = make_features("glove", labels, allow_missing=True)
    assert made.known.sum() == 18
    assert not made.vectors[18:].any()


GLOVE_TEXT = "the 0.5 -1 2e-1\nsea 1 2 3\nacid 4 0 0\nrain 2 2 -2\nSea 9 9 9\nsea 7 7 7\n"
SEA = [1, 2, 3]


@pytest.fixture
def vectors_file(home):
    """Write a vector file and return its path."""

    def write(content, name="vectors.txt"):
        path = home / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return str(path)

    return write


FORMS = {
    "GloVe": GLOVE_TEXT.encode(),
    "word2vec": b"6 3\n" + GLOVE_TEXT.encode(),
    "word2vec's own, with a space at line ends": b"6 3\n"
    + GLOVE_TEXT.replace("\n", " \n").encode(),
    "tabs": GLOVE_TEXT.replace(" ", "\t").encode(),
    "Windows": b"\xef\xbb\xbf" + GLOVE_TEXT.replace("\n", "\r\n").encode(),
    "Windows with a header": b"\xef\xbb\xbf6 3\r\n" + GLOVE_TEXT.replace("\n", "\r\n").encode(),
    "no line end": GLOVE_TEXT.rstrip().encode(),
    "blank lines": b"\n" + GLOVE_TEXT.replace("\n", "\n\n").encode(),
    "gzip": gzip.compress(GLOVE_TEXT.encode()),
    "gzip of two members": gzip.compress(b"6 3\n", mtime=0) + gzip.compress(GLOVE_TEXT.encode()),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["vectors.txt", "vectors.vec.gz"])
def test_text_files_are_read_in_all_their_forms(form, name, vectors_file):
    made = make_features(vectors_file(FORMS[form], name), ["sea", "acid rain", "the"])
    np.testing.assert_array_equal(
        made.vectors, np.array([SEA, [3, 1, -1], [0.5, -1, 0.2]], dtype=np.float32)
    )
    assert made.source == f"{name}, 3-d, mean of words"
    assert made.known.all()
    assert made.missing_words == ()


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["Acid Rain 1 1", "acid rain 2 2", "Acid_Rain 3 3", "acid_rain 4 4", "acid 5 5"], 1),
        (["acid 5 5", "acid_rain 4 4", "Acid_Rain 3 3", "acid rain 2 2"], 2),
        (["acid 5 5", "acid_rain 4 4", "Acid_Rain 3 3"], 3),
        (["acid 5 5", "acid_rain 4 4"], 4),
        (["acid 6 6", "Acid 5 5"], 5),
        (["acid 6 6"], 6),
    ],
)
def test_a_label_is_looked_up_whole_before_its_words(lines, expected, vectors_file):
    made = make_features(vectors_file("\n".join(["the 0 0", *lines])), ["Acid Rain"])
    assert made.vectors.tolist() == [[expected, expected]]


IDS = ["oak_log", "iron-plate", "minecraft:stick", "fire/wood", "IronOre", "birch_HTTPLog"]


def test_ids_have_the_vectors_of_their_words():
    words = ["oak log", "iron plate", "minecraft stick", "fire wood", "iron ore", "birch http log"]
    made = make_features("glove", IDS)
    np.testing.assert_array_equal(made.vectors, make_features("glove", words).vectors)
    assert made.known.all()
    assert made.missing_words == ()


def test_signs_at_the_end_and_words_with_vectors_stay_whole():
    """A sign at the end is not split off and a word with a vector stays whole."""
    labels = ["zqx-", "C-", "t-shirt"]
    made = make_features("glove", labels, allow_missing=True)
    assert made.missing_words == ("c-", "zqx-")
    assert not np.array_equal(made.vectors[1], make_features("glove", ["C"]).vectors[0])


@pytest.mark.parametrize("line", ["oak log 1 1", "oak_log 1 1", "Oak Log 1 1"])
def test_an_id_is_looked_up_as_a_phrase_before_its_words(line, vectors_file):
    made = make_features(vectors_file(f"{line}\noak 5 5\nlog 7 7\n"), ["Oak_Log"])
    assert made.vectors.tolist() == [[1, 1]]


SPACED = "the 0.1 0.2\nroute 66 1.5 2.5\nroute 0.5 0.25\nat name@domain.com 3.0 1.0\n. . . 0.5 0.5"
READ = {
    "words may hold spaces and end in a whole number": (
        SPACED,
        {
            "route 66": [1.5, 2.5],
            "Route": [0.5, 0.25],
            "at name@domain.com": [3, 1],
            ". . .": [0.5, 0.5],
        },
    ),
    "white space of other scripts": (
        "the 1 2\nsea\u3000side 3 4\nsea\x85 5 6\n7 8 9\n",
        {"sea\u3000side": [3, 4], "7": [8, 9]},
    ),
    "other words are not read": ("the 1 2\nother x nan\nsea 3 4\nsea y 5\n", {"sea": [3, 4]}),
    "whole labels before words": (
        "acid_rain 1 2\nfall 3 4\n",
        {"acid rain": [1, 2], "rain fall": [3, 4]},
    ),
}


@pytest.mark.parametrize("case", READ)
def test_labels_get_their_vectors_from_unusual_files(case, vectors_file):
    content, expected = READ[case]
    made = make_features(vectors_file(content), list(expected))
    assert made.vectors.tolist() == list(expected.values())
    assert made.missing_words == (("rain",) if case.startswith("whole") else ())


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", " is empty"),
        (gzip.compress(b"", mtime=0), " is empty"),
        (b"2 3\n", ": the first line announces 2 vectors, but 0 follow"),
        (b"3 2\nsea 1 2\niron 1 2\n", ": the first line announces 3 vectors, but 2 follow."),
        (b"sea 1 2\niron 1\n", ", line 2: 1 columns after the word, expected 2"),
        (b"sea 1 2\nother 1\n", ", line 2: 1 columns"),
        (b"sea 1 2\n\niron .5 1 2\n", ", line 3: 3 columns"),
        (b"sea 1 2\nother 0 -1 1 2\n", ", line 2: 4 columns"),
        (b"2 3\nsea 1 2\niron 1 2\n", ", line 2: 2 columns after the word, expected 3"),
        (b"2 0\nsea .1 .2\niron .1 .2\n", ", line 2: 2 columns after the word, expected 1"),
        (b"sea\niron 1 2\n", ", line 1: 0 columns after the word, expected numbers"),
        (b"sea 1 x\niron 1 2\n", ", line 1: 2 columns after the word, expected numbers"),
        (b"the 1 2\niron x 2\n", ", line 2: the vector for 'iron' has a value that is not a"),
        (b"the 1 2\niron 1 \xff\n", ", line 2: the vector for 'iron' has a value that is not a"),
        (b"the 1 2\niron nan 2\n", ", line 2: the vector for 'iron' has a value"),
        (b"the 1 2\nsea 1 2\niron 1 -inf\n", ", line 3: the vector for 'iron' has a value"),
        (b"the 1 2\niron 1 1e39\n", ", line 2: the vector for 'iron' has a value"),
        (b"2 300\nsea " + struct.pack("<3f", *SEA) + b"\niron ", ", line 2: 1 columns"),
    ],
)
def test_a_damaged_text_file_is_refused_with_its_line(content, expected, vectors_file):
    path = vectors_file(content)
    assert refused(path).startswith(path + expected)


@given(
    st.dictionaries(
        st.text(
            st.characters(codec="utf-8", exclude_categories=["Cs", "Cc", "Z"]),
            min_size=1,
            max_size=4,
        ),
        st.lists(
            st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=3, max_size=3
        ),
        min_size=1,
        max_size=6,
    )
)
@example({"1": [1.0, 2.0, 3.0]})
@example({"\ufeff": [1.0, 2.0, 3.0], "a": [0.0, 0.0, 2.0**-149]})
def test_what_a_file_says_is_what_is_read(tmp_path_factory, vectors):
    path = tmp_path_factory.mktemp("files") / "vectors.txt"
    lines = [
        f"{len(vectors)} 3",
        *(" ".join([word, *map(repr, row)]) for word, row in vectors.items()),
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    words, _, rows = features_module._read_text(path, set(vectors))
    assert dict(zip(words, rows.tolist(), strict=True)) == vectors


MATRIX = np.array([[1, 2], [3, 4], [5, 6], [7, 8]], dtype=np.float32)
WORDS = "sea\nacid rain\nIron\nsea\n"


@pytest.fixture
def npy_file(home):
    """Write an array, its labels if there are any, and return the array's path."""

    def write(array=MATRIX, labels=WORDS):
        path = home / "vectors.npy"
        np.save(path, array)
        if labels is not None:
            path.with_suffix(".labels.txt").write_bytes(
                labels if isinstance(labels, bytes) else labels.encode()
            )
        return str(path)

    return write


@pytest.mark.parametrize("dtype", ["<f2", "<f4", "<f8", ">f4", np.longdouble])
def test_a_numpy_file_is_read_with_the_labels_beside_it(dtype, npy_file, home):
    made = make_features(npy_file(MATRIX.astype(dtype)), ["acid rain", "Sea", "Iron"])
    assert made.vectors.tolist() == [[3, 4], [1, 2], [5, 6]]
    assert made.vectors.dtype == np.float32
    assert made.source == "vectors.npy, 2-d, mean of words"
    assert not (home / "cache").exists()


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("labels", [WORDS.rstrip(), WORDS.replace("\n", "\r\n"), "\ufeff" + WORDS])
def test_labels_of_a_numpy_file_may_end_in_any_way(labels, order, npy_file):
    path = npy_file(np.asarray(MATRIX, order=order), labels)
    assert make_features(path, ["sea", "Iron"]).vectors.tolist() == [[1, 2], [5, 6]]


@pytest.mark.parametrize(
    ("labels", "count"), [("sea\niron\n", 2), (WORDS + "more", 5), (WORDS + "\n", 5), ("", 0)]
)
def test_a_numpy_file_with_more_or_fewer_labels_is_refused(labels, count, npy_file, home):
    path = npy_file(labels=labels)
    assert f"{path} has 4 rows but {home / 'vectors.labels.txt'} has {count} labels" in refused(
        path
    )


@pytest.mark.parametrize(
    "array",
    [
        MATRIX[0],
        MATRIX[None],
        MATRIX.astype(int),
        MATRIX.astype(complex),
        MATRIX[:0],
        MATRIX[:, :0],
        np.float32(1),
    ],
    ids=lambda array: f"{array.dtype} {array.shape}",
)
def test_a_numpy_file_of_another_kind_is_refused(array, npy_file):
    path = npy_file(array)
    assert re.match(f"{path} .*(expected floats, shape|truncated)", refused(path))


@pytest.mark.parametrize(
    "kind", ["no labels", "labels that are not UTF-8", "a zip of arrays", "plain text"]
)
def test_a_numpy_file_in_need_of_something_is_refused(kind, npy_file, home):
    labels = {"no labels": None, "labels that are not UTF-8": b"sea\niron\n\xff\nx\n"}.get(
        kind, WORDS
    )
    path = npy_file(labels=labels)
    packed = io.BytesIO()
    np.savez(packed, MATRIX)
    if content := {"a zip of arrays": packed.getvalue(), "plain text": GLOVE_TEXT.encode()}.get(
        kind
    ):
        Path(path).write_bytes(content)
    beside = home / "vectors.labels.txt"
    expected = {
        "no labels": f"{path} has no labels",
        "labels that are not UTF-8": f"{beside} is not UTF-8",
    }.get(kind, "not a numeric array")
    assert expected in refused(path)


def test_a_numpy_file_of_python_objects_is_refused_without_unpickling(npy_file, home):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(home / "sprung"),)

    path = npy_file(np.array([[Trap()]], dtype=object))
    assert "not a numeric array" in refused(path)
    assert not (home / "sprung").exists()


def test_a_numpy_file_that_is_cut_off_anywhere_is_refused(npy_file):
    path = npy_file()
    whole = Path(path).read_bytes()
    for size in (*range(0, len(whole), 5), len(whole) - 1):
        Path(path).write_bytes(whole[:size])
        assert refused(path).startswith(f"{path} is truncated")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39])
def test_a_value_that_is_no_finite_number_is_refused_with_its_row(value, npy_file):
    array = MATRIX.astype(np.float64)
    array[2, 1] = value
    path = npy_file(array)
    expected = f"{path}, row 2 (the first is 0): the vector for 'Iron' has a value"
    assert refused(path, ["sea", "Iron"]).startswith(expected)
    assert make_features(path, ["sea"]).vectors.tolist() == [[1, 2]]


def slow_near_synonyms(split, vectors, threshold):
    """Compare each test recipe with each train recipe, word by word as the definition says."""
    rows = list(zip(split.graph.recipes.tolist(), split.parts.tolist(), strict=True))
    train = [recipe for recipe, part in rows if part == 0]

    def repeats(one, other):
        return one[2] == other[2] and any(
            one[1 - i] == other[1 - j] and cosine(vectors[one[i]], vectors[other[j]]) >= threshold
            for i in (0, 1)
            for j in (0, 1)
        )

    return [part == 2 and any(repeats(recipe, other) for other in train) for recipe, part in rows]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("threshold", [0.3, 0.7])
def test_near_synonyms_are_those_of_the_definition(seed, threshold):
    rng = np.random.default_rng(seed)
    rows = [(f"e{a}", f"e{b}", f"e{c}") for a, b, c in rng.integers(0, 9, size=(60, 3)).tolist()]
    graph = RecipeGraph.from_recipes(rows)
    split = make_split(
        graph, SplitConfig("by-recipe-plain", train_ratio=0.6, valid_ratio=0.1, seed=seed)
    )
    vectors = rng.normal(size=(graph.num_entities, 3)).astype(np.float32)
    vectors[0] = 0
    known = np.ones(graph.num_entities, dtype=bool)
    features = EntityFeatures("test", vectors, known, ())
    expected = slow_near_synonyms(split, vectors.tolist(), threshold)
    assert near_synonym_recipes(split, features, threshold).tolist() == expected
    assert any(expected)
    assert not all(
        flag for flag, part in zip(expected, split.parts.tolist(), strict=True) if part == 2
    )


def test_a_triple_counts_if_any_near_synonym_recipe_gives_it():
    graph = RecipeGraph.from_recipes([("a", "b", "x"), ("a", "c", "x"), ("b", "c", "y")])
    repeated = np.array([True, False, False])
    triples = graph.triples
    given = {tuple(row) for row in recipe_triples(graph.recipes[:1]).tolist()}
    expected = [tuple(row) in given for row in triples.tolist()]
    assert near_synonym_triples(graph, repeated, triples).tolist() == expected
    assert not near_synonym_triples(graph, np.zeros(3, dtype=bool), triples).any()
