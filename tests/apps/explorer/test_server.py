"""The server: permitted requests, errors, and labels as text."""

import json
import re
import shutil
import socket
from dataclasses import replace
from urllib.parse import unquote

import pytest
from helpers import write_graph
from starlette.testclient import TestClient

from tests.apps.explorer.shown import HOSTILE, Shown, client_of
from tests.apps.people.stored import refused
from wordcraft_kg.apps.explorer import site
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.site import export_site, make_app
from wordcraft_kg.apps.web.guard import HEADERS, LONGEST_ADDRESS
from wordcraft_kg.apps.web.serving import listen
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    UnknownEntityError,
    as_values,
)


@pytest.fixture(scope="module")
def client(explored):
    return client_of(explored)


@pytest.fixture
def resplit_folder(tmp_path):
    """The kitchen with another split."""
    return write_graph(tmp_path / "graph", seed=3)


@pytest.fixture(scope="module")
def hostile_client(hostile):
    return client_of(hostile)


def test_every_page_of_the_menu_has_its_view_as_json(client, explored):
    for page in PAGES.values():
        if page.title:
            answer = client.get(f"/{page.name}?format=json")
            assert answer.json() == as_values(page.view(explored, page.state()))


@pytest.mark.parametrize(
    "address",
    ["/home", "/nothing", "/entities?q=a&format=json", "/files/explorer.css", "/entity/nothing"],
)
def test_every_answer_has_the_security_headers(client, address):
    answer = client.get(address)
    assert {name: answer.headers[name] for name in HEADERS} == HEADERS


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "", "127.0.0.1.nip.io", "[::1"]
)
def test_another_hosts_name_is_refused(client, host):
    answer = client.get("/home", headers={"Host": host})
    assert answer.status_code == 421
    assert "Crafting layers" not in answer.text


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8765", "[::1]:80", "LOCALHOST:1"])
def test_the_names_of_this_machine_are_answered(client, host):
    assert client.get("/home", headers={"Host": host}).status_code == 200


def test_a_further_name_may_be_allowed(explored):
    app = make_app(explored, more_hosts=["Lab.example"])
    assert TestClient(app, base_url="http://lab.example").get("/home").status_code == 200
    assert TestClient(app, base_url="http://lab2.example").get("/home").status_code == 421


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE"])
def test_nothing_but_reading_is_possible(client, method):
    assert client.request(method, "/home").status_code == 405


@pytest.mark.parametrize(
    "path",
    ["/../../etc/passwd", "/files/../server.py", "/files/%2e%2e%2fserver.py", "/files/server.py"],
)
def test_no_path_leads_out_of_the_site(client, path):
    answer = client.get(path)
    assert (answer.status_code, re.findall("import|root:", answer.text)) == (404, [])


@pytest.mark.parametrize(
    ("address", "status", "message"),
    [
        ("/recipes/bread?use=size", 400, "size"),
        ("/entities?page=99", 400, "page"),
        ("/entities?q=%ff", 400, "UTF-8"),
        ("/entities?q=" + "a" * (LONGEST_ADDRESS - 100), 200, ""),
        ("/entities?q=" + "a" * LONGEST_ADDRESS, 414, "too long"),
        ("/entities?" + "&".join(f"q{i}=1" for i in range(500)), 400, "UTF-8"),
        ("/entity/brea", 404, "No entity &#39;brea&#39;"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_an_address_that_cannot_be_read_is_an_error(client, address, status, message):
    answer = client.get(address)
    assert (answer.status_code, message in answer.text) == (status, True)


def test_a_page_is_sent_at_once():
    """asyncio sets TCP_NODELAY on connections whose socket names its protocol; without it a page
    may wait 40 ms."""
    with (
        listen("127.0.0.1", 0) as listening,
        socket.create_connection(listening.getsockname()),
        listening.accept()[0] as connection,
    ):
        assert connection.proto == socket.IPPROTO_TCP


@pytest.mark.parametrize(
    ("graph", "model", "run", "error"),
    [
        pytest.param("everyday", "links_folder", None, GraphMismatchError, marks=pytest.mark.slow),
        ("everyday", None, "run_folder", GraphMismatchError),
        ("resplit_folder", None, "run_folder", GraphMismatchError),
        ("kitchen_folder", None, "links_folder", ArtefactError),
        ("kitchen_folder", "run_folder", None, ArtefactError),
        ("kitchen_folder", "tmp_path", None, ArtefactError),
    ],
)
def test_a_folder_of_another_graph_or_kind_is_refused(request, graph, model, run, error):
    models, runs = ([request.getfixturevalue(name)] if name else [] for name in (model, run))
    with pytest.raises(error):
        Explored.open(
            graph if graph == "everyday" else request.getfixturevalue(graph), models, runs
        )


def test_models_and_runs_are_found_by_name_and_the_first_without(explored):
    names = list(explored.models)
    assert names == ["kitchen-complex", "kitchen-recipes"]
    assert explored.predictor().name == names[0]
    assert explored.predictor(names[1]).name == names[1]
    with pytest.raises(UnknownEntityError, match="Did you mean 'kitchen-complex'"):
        explored.predictor("kitchen-complx")
    bare = Explored(explored.opened)
    for kind, find in (("model", bare.predictor), ("run", bare.followed)):
        with pytest.raises(ConfigError, match=f"--{kind}"):
            find()


def test_folders_of_one_name_are_told_apart_by_their_parents(
    kitchen_folder, links_folder, tmp_path
):
    for place in ("one", "two"):
        shutil.copytree(links_folder, tmp_path / place / "cx")
    found = Explored.open(kitchen_folder, [tmp_path / "one" / "cx", tmp_path / "two" / "cx"])
    assert list(found.models) == ["cx", "two-cx"]


def test_looking_writes_nothing(client, kitchen_folder, links_folder, run_folder):
    def content():
        files = [
            path
            for folder in (kitchen_folder, links_folder, run_folder)
            for path in folder.rglob("*")
        ]
        return {path: (path.stat().st_size, path.stat().st_mtime_ns) for path in files}

    before = content()
    assert [client.get(f"/{name}").status_code for name in PAGES]
    assert content() == before


def test_the_json_of_a_page_is_json_whatever_its_labels_are(hostile_client):
    assert hostile_client.get("/entities?format=json").json()["paging"]["total"] == len(HOSTILE) + 3


@pytest.mark.parametrize(
    ("arguments", "message", "kind"),
    [
        ("--port 70000", "70000", "ConfigError"),
        ("--host no.such.host.invalid", "unknown host", "ConfigError"),
        ("--host 203.0.113.7", "not an address of this machine", "ConfigError"),
        ("--model nowhere", "nowhere", "ArtefactError"),
        ("--run nowhere", "nowhere", "ArtefactError"),
    ],
)
def test_what_cannot_be_served_is_a_clear_error(run, arguments, message, kind):
    assert message in refused(run("explore", "kitchen", "--no-browser", *arguments.split()), kind)


def test_the_site_as_files(run, tmp_path):
    (tmp_path / "small.csv").write_text("ingredient_a,ingredient_b,result\na,b,c\n")
    command = ("explore", tmp_path / "small.csv", "--export", tmp_path / "site")
    record = json.loads(run(*command, "--json").out)
    assert record == json.loads((tmp_path / "site" / "site.json").read_text())
    assert record["graph"] == "small"
    refused(run(*command), "OutputExistsError")
    assert run(*command, "--force").code == 0


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
    monkeypatch.setattr(site, "PAGES", few)
    export_site(broken, tmp_path / "site")
    pages = [page for page in (tmp_path / "site").rglob("*.*") if page.is_file()]
    assert any("episodes.jsonl" in page.read_text() for page in pages), "the reason itself is said"
    assert not [page for page in pages if str(tmp_path) in page.read_text()]
