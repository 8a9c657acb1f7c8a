import hashlib
import http.client
import io
import json
import urllib.error
from collections import Counter
from dataclasses import replace

import pytest

from wordcraft_kg import RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.base.errors import FetchError, RecipeFileError
from wordcraft_kg.graphs import fetch_book, known_books, library
from wordcraft_kg.graphs.library import DATA_VARIABLE, FETCHABLE, cache_folder, locate_book
from wordcraft_kg.models.scorers.features import glove_features

NAME = "little-alchemy-2"
BASE = ("air", "earth", "fire", "time", "water")
RECIPES = {**{label: [] for label in BASE}, "mud": [["water", "earth"]], "water": [["mud", "fire"]]}
PUBLISHED = json.dumps(
    {"entities": {label: {"recipes": pairs} for label, pairs in RECIPES.items()}}
).encode()
"""Water has a recipe, as in the real file, so the base cannot be inferred from it."""


@pytest.fixture
def published(monkeypatch):
    """Pin a small file of our own in place of the real one."""
    pinned = replace(FETCHABLE[NAME], sha256=hashlib.sha256(PUBLISHED).hexdigest())
    monkeypatch.setitem(FETCHABLE, NAME, pinned)
    return pinned


@pytest.fixture
def data(home, monkeypatch):
    """Set an empty data folder."""
    folder = home / "data"
    folder.mkdir()
    monkeypatch.setenv(DATA_VARIABLE, str(folder))
    return folder


@pytest.fixture
def server(monkeypatch):
    """Answer each download with the next of the given answers, bytes or an error, and keep the
    addresses."""
    answers, addresses = [], []

    def urlopen(url, timeout):
        addresses.append(url)
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return io.BytesIO(answer)

    monkeypatch.setattr(library.urllib.request, "urlopen", urlopen)

    def serve(*given):
        answers.extend(given)
        return addresses

    return serve


BUILT_IN = dict.fromkeys(["everyday", "everyday-1", "kitchen", "paper-examples"], "built in")
TO_FETCH = dict.fromkeys(FETCHABLE, "to fetch")


def origins():
    return {book.name: book.origin for book in known_books()}


def test_the_built_in_books_open_by_name(home):
    assert open_book("kitchen").name == "kitchen"
    assert len(open_book("paper-examples").recipes) == 52
    assert origins() == BUILT_IN | TO_FETCH


def test_a_file_or_graph_folder_of_the_same_name_goes_before_a_known_book(home, monkeypatch):
    monkeypatch.chdir(home)
    book = open_book("kitchen")
    (home / "kitchen").write_text("not a book", encoding="utf-8")
    with pytest.raises(RecipeFileError, match="no table, because"):
        open_book("kitchen")
    (home / "kitchen").unlink()
    (home / "kitchen").mkdir()
    assert open_book("kitchen") == book  # a folder of another kind hides nothing
    (home / "mine").mkdir()
    with pytest.raises(RecipeFileError, match=r"mine' is an empty folder; expected a recipe book"):
        open_book("mine")
    (home / "kitchen" / "graph.json").write_text("{}", encoding="utf-8")
    with pytest.raises(RecipeFileError, match="has no recipe to keep"):
        open_book("kitchen")


@pytest.mark.slow
def test_made_up_words_keep_the_graph_and_hide_the_words(home):
    book, twin = open_book("everyday"), open_book("made-up-3:everyday")
    assert twin == open_book("made-up-3:everyday") != open_book("made-up:everyday")
    assert not {word for label in book.entities for word in label.split()} & {
        word for label in twin.entities for word in label.split()
    }
    graph, other = map(RecipeGraph.from_book, (book, twin))
    assert other.recipes.tolist() == graph.recipes.tolist()
    assert other.base_ids.tolist() == graph.base_ids.tolist()
    assert (
        make_split(other, SplitConfig()).parts.tolist()
        == make_split(graph, SplitConfig()).parts.tolist()
    )
    assert Counter(twin.kinds.values()) == Counter(book.kinds.values())
    assert not glove_features(twin.entities).known.any()
    with pytest.raises(RecipeFileError, match="it is made from 'kitchen'; give that book"):
        locate_book("made-up:kitchen")


def test_a_published_book_in_a_folder_is_known_by_name_and_hash(data, monkeypatch):
    """Infinite Craft lies in a folder of its own: a file `recipes.json` beside it is another."""
    text = {"items": ["Water", "Fire", "Steam"], "recipes": [[0, 1, 2]]}
    content = json.dumps(text).encode()
    (data / "infinite_craft").mkdir()
    (data / "infinite_craft" / "recipes.json").write_bytes(content)
    (data / "recipes.json").write_bytes(content)
    assert origins()["infinite-craft"] == origins()["recipes"] == "data folder"
    with pytest.raises(RecipeFileError, match="is not the published 'infinite-craft'"):
        open_book("infinite-craft")
    pinned = replace(
        FETCHABLE["infinite-craft"],
        sha256=hashlib.sha256(content).hexdigest(),
        base=("Fire", "Water"),
    )
    monkeypatch.setitem(FETCHABLE, "infinite-craft", pinned)
    book = open_book("infinite-craft")
    assert book.name == "infinite-craft"
    assert book.base == ("Fire", "Water")


def test_a_book_that_was_not_fetched_says_how_to_fetch_it(home):
    with pytest.raises(FetchError, match=rf"no book 'kitchen' to fetch; expected one of {NAME}"):
        fetch_book("kitchen")
    with pytest.raises(
        RecipeFileError,
        match=f"not on this machine yet. Fetch it: wordcraft-kg books --fetch {NAME}",
    ):
        open_book(NAME)


def test_a_fetched_book_is_kept_in_the_cache_and_opens_with_its_base(home, published, server):
    addresses = server(PUBLISHED)
    path = fetch_book(NAME)
    assert fetch_book(NAME) == path
    assert path == home / "cache" / "wordcraft-kg" / "books" / "alchemy2.json"
    assert path.read_bytes() == PUBLISHED
    assert addresses == [published.url]
    assert [item.name for item in path.parent.iterdir()] == ["alchemy2.json"]
    assert origins()[NAME] == "cache"
    assert open_book(NAME).name == NAME
    assert RecipeGraph.from_book(open_book(NAME)).base == BASE


def test_a_damaged_book_in_the_cache_is_refused_and_downloaded_again(home, published, server):
    server(PUBLISHED, PUBLISHED)
    path = fetch_book(NAME)
    path.write_bytes(PUBLISHED[:-3])
    with pytest.raises(
        RecipeFileError,
        match=rf"alchemy2\.json is not the published '{NAME}'.*Fetch the book again",
    ):
        open_book(NAME)
    assert fetch_book(NAME).read_bytes() == PUBLISHED


def test_other_bytes_than_the_pinned_ones_are_not_kept(home, published, server):
    server(b"<html>not found</html>")
    with pytest.raises(
        FetchError,
        match=rf"expected {published.sha256[:12]}…; not kept\. Or place the file by hand",
    ):
        fetch_book(NAME)
    assert not cache_folder().exists()
    cache_folder().mkdir(parents=True)
    earlier = cache_folder() / "alchemy2.json"
    earlier.write_bytes(b"mine")
    server(b"<html>not found</html>")
    with pytest.raises(FetchError, match="not kept"):
        fetch_book(NAME)
    assert earlier.read_bytes() == b"mine"


FAILURES = {
    "no route to host": urllib.error.URLError("no route to host"),
    "timed out": TimeoutError("timed out"),
    "reset by peer": ConnectionResetError(104, "Connection reset by peer"),
    "IncompleteRead": http.client.IncompleteRead(b"half", 400),
    "nonsense": http.client.BadStatusLine("nonsense"),
}


@pytest.mark.parametrize("reason", FAILURES)
def test_a_failed_download_says_how_to_place_the_file_by_hand(home, published, server, reason):
    server(FAILURES[reason])
    with pytest.raises(FetchError) as caught:
        fetch_book(NAME)
    message = str(caught.value)
    assert f"could not download '{NAME}'" in message
    assert reason in message
    assert f"save {published.url} as {cache_folder() / 'alchemy2.json'}" in message
    assert f"or as alchemy2.json into the folder that {DATA_VARIABLE} names" in message
    assert not cache_folder().exists()


@pytest.mark.parametrize("bound", ["_MAX_BYTES", "_LONGEST"])
def test_a_download_is_bounded_in_size_and_time(home, published, server, monkeypatch, bound):
    server(PUBLISHED)
    monkeypatch.setattr(library, bound, 1 if bound == "_MAX_BYTES" else -1)
    with pytest.raises(FetchError, match=r"could not download .* bytes or"):
        fetch_book(NAME)


def test_a_file_in_the_data_folder_has_the_published_name(data, published):
    """A file placed in the data folder by hand is known by the published name."""
    (data / "alchemy2.json").write_bytes(PUBLISHED)
    assert origins()[NAME] == "data folder"
    assert fetch_book(NAME) == data / "alchemy2.json"
    assert RecipeGraph.from_book(open_book(NAME)).base == BASE


def test_another_file_in_its_place_is_refused_by_name_but_opens_by_path(data):
    path = data / "alchemy2.json"
    path.write_bytes(PUBLISHED)
    with pytest.raises(
        RecipeFileError,
        match=rf"is not the published '{NAME}' \(its SHA-256 differs\).*{path.name}",
    ):
        open_book(NAME)
    assert open_book(path).name == "alchemy2"
