"""A site as files: complete, with links that lead somewhere, and of safe names."""

import re
import shutil
from dataclasses import replace
from urllib.parse import unquote

import pytest

from tests.apps.explorer.shown import HOSTILE, Shown
from wordcraft_kg.apps.explorer import export
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.export import export_site
from wordcraft_kg.apps.explorer.pages import PAGES

LOADING = ("link", "script", "img")


def loaded(page):
    """The files that a page loads."""
    sources = [
        attributes.get("href") or attributes.get("src") or ""
        for tag, attributes in page.tags
        if tag in LOADING
    ]
    return [source for source in sources if source and not source.startswith("data:")]


@pytest.fixture(scope="module")
def pages(static_site):
    """The pages of the kitchen's site by their files."""
    return {path: Shown(path.read_text()) for path in sorted(static_site.rglob("*.html"))}


@pytest.fixture(scope="module")
def hostile_site(hostile, tmp_path_factory):
    out = tmp_path_factory.mktemp("static") / "hostile"
    assert not export_site(hostile, out).skipped
    return out


@pytest.mark.slow
def test_every_link_of_every_file_leads_to_a_file(static_site, pages):
    assert len(pages) > 80  # one for each entity, and more
    for path, page in pages.items():
        for link in page.links + loaded(page):
            target, _, anchor = link.partition("#")
            assert "?" not in target, (path, link)
            file = (path.parent / unquote(target)).resolve() if target else path
            assert file.is_file(), (path, link)
            assert file.is_relative_to(static_site.resolve())
            assert not anchor or f'id="{anchor}"' in pages[file].page, (path, link)


@pytest.mark.slow
def test_there_are_no_forms_and_nothing_is_loaded_from_elsewhere(pages):
    for path, page in pages.items():
        assert all("hidden" in form.attributes for form in page.forms), path
        assert not [source for source in loaded(page) if re.match(r"\w+:|//", source)], path
        assert "Content-Security-Policy" in page.page


def test_labels_make_safe_file_names_and_none_is_lost(hostile, hostile_site):
    pages = list((hostile_site / "entity").iterdir())
    assert len(pages) == hostile.opened.graph.num_entities == len(HOSTILE) + 3
    assert all(re.fullmatch(r"[a-z0-9-]{1,70}\.html", page.name) for page in pages)
    assert not [
        page for page in hostile_site.rglob("*.html") if "<script>alert" in page.read_text()
    ]


def test_the_same_site_has_the_same_bytes(hostile, hostile_site, tmp_path):
    def content(site):
        return {
            path.relative_to(site): path.read_bytes() for path in site.rglob("*") if path.is_file()
        }

    export_site(Explored(hostile.opened), tmp_path / "again")
    assert content(tmp_path / "again") == content(hostile_site)


@pytest.mark.slow
def test_no_file_says_where_folders_are_on_this_machine(
    explored, run_folder, tmp_path, monkeypatch
):
    shutil.copytree(run_folder, tmp_path / "w")
    (tmp_path / "w" / "episodes.jsonl").unlink()
    broken = Explored(explored.opened, runs={"w": tmp_path / "w"})
    # Pages of single entities say nothing of folders, and are nearly all pages.
    few = {
        name: replace(page, exported=lambda _: ()) if page.subject else page
        for name, page in PAGES.items()
    }
    monkeypatch.setattr(export, "PAGES", few)
    export_site(broken, tmp_path / "site")
    pages = [page for page in (tmp_path / "site").rglob("*.*") if page.is_file()]
    assert any("episodes.jsonl" in page.read_text() for page in pages), "the reason itself is said"
    assert not [page for page in pages if str(tmp_path) in page.read_text()]
