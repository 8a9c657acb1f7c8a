"""A site as files: complete, with links that lead somewhere, and of safe names."""

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from tests.apps.explorer.labels import HOSTILE
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.export import export_site
from wordcraft_kg.base.errors import OutputExistsError


class References(HTMLParser):
    """Collects what a page links to and loads."""

    def __init__(self, page: str):
        super().__init__()
        self.links: list[str] = []
        self.files: list[str] = []
        self.forms = 0
        self.feed(page)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = dict(attributes)
        if tag == "a" and found.get("href"):
            self.links.append(found["href"] or "")
        source = found.get("href") or found.get("src") or ""
        if tag in ("link", "script", "img") and source and not source.startswith("data:"):
            self.files.append(source)
        if tag == "form" and "hidden" not in found:
            self.forms += 1


@pytest.fixture(scope="module")
def site(explored: Explored, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sites") / "kitchen"
    export_site(explored, out)
    return out


def test_every_link_of_every_file_leads_to_a_file(site: Path):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 80  # one for each entity, and more
    for page in pages:
        found = References(page.read_text())
        for link in found.links + found.files:
            target, _, anchor = link.partition("#")
            assert "?" not in target, (page, link)
            there = (page.parent / unquote(target)).resolve() if target else page
            assert there.is_file(), (page, link)
            assert there.is_relative_to(site.resolve())
            if anchor:
                assert f'id="{anchor}"' in there.read_text(), (page, link)


def test_the_first_page_leads_to_every_entity(site: Path, explored: Explored):
    todo, seen = [site / "index.html"], set()
    while todo:
        page = todo.pop()
        seen.add(page)
        links = [link.partition("#")[0] for link in References(page.read_text()).links]
        more = {(page.parent / unquote(link)).resolve() for link in links if link}
        todo += more - seen
        seen |= more
    reached = {page.relative_to(site.resolve()) for page in seen if page.is_relative_to(site.resolve())}
    assert len([page for page in reached if page.parts[0] == "entity"]) == explored.opened.graph.num_entities


def test_there_are_no_forms_and_nothing_is_loaded_from_elsewhere(site: Path):
    for page in site.rglob("*.html"):
        text = page.read_text()
        found = References(text)
        assert not found.forms, page
        assert not [source for source in found.files if re.match(r"\w+:|//", source)], page
        assert "Content-Security-Policy" in text


def test_the_record_says_what_was_written(site: Path, explored: Explored):
    record = json.loads((site / "site.json").read_text())
    sizes = [page.stat().st_size for page in site.rglob("*.html")]
    assert (record["pages"], record["bytes"], record["largest"]) == (len(sizes), sum(sizes), max(sizes))
    assert record["graph_hash"] == explored.opened.graph.hash
    assert record["skipped"] == {}
    assert set(record["models"]) == set(explored.models)
    assert set(record["runs"]) == set(explored.runs)


def test_the_search_file_has_every_entity_the_most_used_first(site: Path, explored: Explored):
    text = (site / "search.js").read_text()
    found = json.loads(text.removeprefix("window.entities = ").removesuffix(";\n"))
    graph = explored.opened.graph
    assert sorted(label for label, _ in found) == sorted(graph.entities)
    used = [int(graph.use_counts[graph.id_of(label)]) for label, _ in found]
    assert used == sorted(used, reverse=True)
    assert all((site / file).is_file() for _, file in found)


def test_labels_make_safe_file_names_and_none_is_lost(hostile: Explored, tmp_path: Path):
    found = export_site(hostile, tmp_path / "site")
    pages = list((tmp_path / "site" / "entity").iterdir())
    assert len(pages) == hostile.opened.graph.num_entities == len(HOSTILE) + 3
    assert all(re.fullmatch(r"[a-z0-9-]{1,70}\.html", page.name) for page in pages)
    assert not found.skipped
    assert not [page for page in (tmp_path / "site").rglob("*.html") if "<script>alert" in page.read_text()]


def test_the_same_site_has_the_same_bytes(explored: Explored, site: Path, tmp_path: Path):
    export_site(explored, tmp_path / "again")
    files = {path.relative_to(site): path.read_bytes() for path in site.rglob("*") if path.is_file()}
    again = {
        path.relative_to(tmp_path / "again"): path.read_bytes()
        for path in (tmp_path / "again").rglob("*")
        if path.is_file()
    }
    assert again == files


def test_a_site_is_replaced_only_on_request(hostile: Explored, tmp_path: Path):
    export_site(hostile, tmp_path / "site")
    with pytest.raises(OutputExistsError):
        export_site(hostile, tmp_path / "site")
    export_site(hostile, tmp_path / "site", force=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError):
        export_site(hostile, tmp_path / "other", force=True)
    assert (tmp_path / "other" / "notes.txt").read_text() == "mine"


def test_no_file_says_where_folders_are_on_this_machine(
    explored: Explored, run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    shutil.copytree(run_folder, tmp_path / "w")
    (tmp_path / "w" / "episodes.jsonl").unlink()
    broken = Explored(explored.opened, explored.models, {"w": tmp_path / "w"})
    export_site(broken, tmp_path / "site")
    pages = [page for page in (tmp_path / "site").rglob("*.*") if page.is_file()]
    assert any("episodes.jsonl" in page.read_text() for page in pages), "the reason itself is said"
    assert not [page for page in pages if str(tmp_path) in page.read_text()]
