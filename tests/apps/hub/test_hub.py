"""`hub push` and `hub pull`: the real client and a server on this machine."""

import base64
import copy
import hashlib
import json
import re
import shutil
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import safetensors.torch
import torch
from huggingface_hub import constants

import wordcraft_kg.agents.training as agents
import wordcraft_kg.models.links.training as links
import wordcraft_kg.models.recipes.training as recipes
from wordcraft_kg import open_model
from wordcraft_kg.agents.agent_folder import INPUTS
from wordcraft_kg.apps.hub import folders
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.folder import make_policy, save_policy
from wordcraft_kg.models.scorers.folder import FOLD_OUTPUTS
from wordcraft_kg.runs.config_file import CONFIG_FILE


class Hub(BaseHTTPRequestHandler):
    """The client's requests; the server has ``files`` by repository and revision, and ``created``
    repositories."""

    wbufsize = -1  # head and body in one packet: a body alone waits 40 ms for the head's receipt

    def do_POST(self):
        body, files = self.rfile.read(int(self.headers["Content-Length"])), self.server.files
        if self.headers["Authorization"] != "Bearer hf_right":
            return self.answer({"error": "not logged in"}, 401)
        match self.path.split("/")[2:]:
            case ["repos", "create"]:
                self.server.created.append(json.loads(body))
                return self.answer({"url": f"http://{self.headers['Host']}/me/mine"})
            case [_, _, _, "preupload", _]:
                modes = [
                    {"uploadMode": "regular", "shouldIgnore": False, **one}
                    for one in json.loads(body)["files"]
                ]
                return self.answer({"files": modes})
            case [kind, *repository, "commit", revision]:
                values = [
                    line["value"]
                    for line in map(json.loads, body.splitlines())
                    if line["key"] == "file"
                ]
                commit, repository = hashlib.sha1(body).hexdigest(), (kind, "/".join(repository))
                pushed = {one["path"]: base64.b64decode(one["content"]) for one in values}
                files[*repository, revision] = files[*repository, commit] = {"": commit, **pushed}
                url = f"http://{self.headers['Host']}/me/mine/commit/{commit}"
                return self.answer({"commitOid": commit, "commitUrl": url})
        return self.answer({})  # a branch, or a check of the card

    def do_GET(self):
        match self.path.partition("?")[0].split("/")[1:]:
            case ["api", kind, owner, name, *rest]:
                files = self.server.files.get(
                    (kind, f"{owner}/{name}", rest[1] if rest else "main")
                )
                if files is None:
                    return self.answer({"error": "absent"}, 404, {"X-Error-Code": "RepoNotFound"})
                siblings = [
                    {"rfilename": file, "size": len(data)} for file, data in files.items() if file
                ]
                values = {"id": f"{owner}/{name}", "sha": files[""], "siblings": siblings}
                return self.answer(values)
            case [*dataset, owner, name, "resolve", commit, file] | [
                *dataset,
                owner,
                name,
                "resolve",
                commit,
                _,
                file,
            ]:
                files = self.server.files[
                    "datasets" if dataset else "models", f"{owner}/{name}", commit
                ]
                data = files[self.path.partition(f"{commit}/")[2]]
                return self.answer(data, headers={"X-Repo-Commit": commit, "ETag": f'"{file}"'})
        return self.answer({"error": "absent"}, 404)

    do_HEAD = do_GET

    def answer(self, content, status=200, headers=()):
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        for header in {"Content-Length": str(len(data)), **dict(headers)}.items():
            self.send_header(*header)
        self.end_headers()
        self.wfile.write(data if self.command != "HEAD" else b"")


@pytest.fixture
def hub(monkeypatch, home):
    with ThreadingHTTPServer(("127.0.0.1", 0), Hub) as server:
        server.files, server.created = {}, []
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        monkeypatch.setattr(constants, "ENDPOINT", address)
        template = address + "/{repo_id}/resolve/{revision}/{filename}"
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        monkeypatch.setenv("HF_TOKEN", "hf_right")
        monkeypatch.chdir(home)
        yield server
        server.shutdown()


def test_a_graph_and_a_model_come_back_byte_for_byte_with_cards(
    hub, run, home, parted_folder, recipes_folder
):
    for kind, folder in (("dataset", parted_folder), ("model", recipes_folder)):
        pushed = run("hub", "push", folder, "me/mine", "--private", "--revision", "trial", "--json")
        pulled = run("hub", "pull", "me/mine", "--revision", "trial", "--out", kind)
        assert (pushed.code, pulled.code) == (0, 0), pushed.err + pulled.err
        view = json.loads(pushed.out)
        assert (view["type"], hub.created[-1]["visibility"]) == (kind, "private")
        assert (home / kind / "README.md").read_text() == view["card"]
        for name in set(view["files"]) - {"README.md"}:
            assert (home / kind / name).read_bytes() == (folder / name).read_bytes()
        assert run("hub", "pull", "me/mine", "--out", kind).kind == "OutputExistsError"
    assert view["card"].startswith("---\nlicense: cc0-1.0\nlibrary_name: wordcraft-kg\n")
    assert f"- graph: `{open_model(recipes_folder).run.inputs['graph']}`" in view["card"]


def test_changed_files_and_foreign_paths_are_refused(hub, run, parted_folder):
    shutil.copytree(parted_folder, "mine")
    assert run("hub", "push", "mine", "me/mine").code == 0
    files = hub.files["datasets", "me/mine", "main"]
    before, files["graph.json"] = files["graph.json"], b"{}"
    outcome = run("hub", "pull", "me/mine", "--out", "new")
    assert (outcome.kind, "me/mine/graph.json" in outcome.err) == ("ArtefactError", True)
    assert not Path("new").exists()
    files["graph.json"] = before
    files["../evil"] = b"x"
    assert run("hub", "pull", "me/mine", "--out", "new").code == 0
    assert not Path("evil").exists()
    Path("mine/split.json").write_text("{}")
    assert run("hub", "push", "mine", "me/other").kind == "ArtefactError"
    assert ("datasets", "me/other", "main") not in hub.files


def test_a_book_without_a_known_licence_needs_one(hub, run):
    Path("book.csv").write_text("# base: a, b\ningredient_a,ingredient_b,result\na,b,c\n")
    assert run("build-graph", "book.csv", "--split", "none", "--out", "graph").code == 0
    for options in ((), ("--licence", "MIT: yes")):
        assert run("hub", "push", "graph", "me/mine", *options).setting == "licence"
    outcome = run("hub", "push", "graph", "me/mine", "--licence", "cc-by-4.0", "--dry-run")
    assert "license: cc-by-4.0\n" in outcome.out
    assert not hub.created


def test_failures_name_the_remedy_and_never_the_token(hub, run, parted_folder, monkeypatch):
    assert run("hub", "pull", "absent", "--out", "new").setting == "repository"
    assert "status 404" in run("hub", "pull", "me/absent", "--out", "new").err
    monkeypatch.setenv("HF_TOKEN", "hf_wrong")
    outcome = run("hub", "push", parted_folder, "me/mine")
    assert (outcome.kind, "status 401" in outcome.err, "hf auth login" in outcome.err) == (
        "FetchError",
        True,
        True,
    )
    assert "hf_wrong" not in outcome.err


@pytest.fixture(scope="module")
def pushed():
    """What the server has after a push, by the folder: each is pushed once for all attacks."""
    return {}


@pytest.fixture
def push_and_change(hub, run, pushed):
    """Push a folder, let an attacker change the pushed files by name, and return how the pull of
    these files ends."""

    def push_and_change(folder, change):
        if folder not in pushed:
            assert run("hub", "push", folder, "me/mine").code == 0
            pushed[folder] = copy.deepcopy(hub.files)
        # One copy of all, so that the branch and its commit stay the same files.
        hub.files = copy.deepcopy(pushed[folder])
        kind = "datasets" if (folder / "graph.json").exists() else "models"
        files = hub.files[kind, "me/mine", "main"]
        change(files)
        return run("hub", "pull", "me/mine", "--out", "new")

    return push_and_change


@pytest.mark.parametrize("name", ["evil.pkl", "setup.py", "run.sh", "a.exe", "triples/more.tsv"])
def test_a_file_that_is_none_of_ours_is_never_pulled(push_and_change, parted_folder, name):
    outcome = push_and_change(parted_folder, lambda files: files.update({name: b"x"}))
    assert outcome.code == 0
    assert not Path("new", name).exists()


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("parted_folder", "policy.safetensors"),
        pytest.param("parted_folder", "run.json", marks=pytest.mark.slow),
        pytest.param("recipes_folder", "metrics.jsonl", marks=pytest.mark.slow),
    ],
)
def test_a_file_of_another_kind_of_folder_is_never_pulled(push_and_change, request, folder, name):
    shared = request.getfixturevalue(folder)
    outcome = push_and_change(shared, lambda files: files.update({name: b"x"}))
    assert (outcome.kind, f"the file '{name}', which does not belong" in outcome.err) == (
        "ArtefactError",
        True,
    )
    assert not Path("new").exists()


def test_a_download_that_cannot_fit_never_begins(hub, run, parted_folder, monkeypatch):
    assert run("hub", "push", parted_folder, "me/graph").code == 0
    usage = shutil.disk_usage(parted_folder)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=100))
    outcome = run("hub", "pull", "me/graph", "--out", "pulled")
    assert outcome.kind == "ArtefactError"
    assert re.search("bytes; at most 100 fit here", outcome.err)
    assert not Path("pulled").exists()


def without_last_line(text):
    return b"".join(text.splitlines(keepends=True)[:-1])


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("recipes.csv", without_last_line),
        *(
            pytest.param(name, change, marks=pytest.mark.slow)
            for name, change in (
                ("entities.tsv", without_last_line),
                ("triples/full.tsv", without_last_line),
                ("triples/partial.tsv", lambda text: text + text.splitlines(keepends=True)[-1]),
                ("triples/unseen.tsv", lambda text: b""),
            )
        ),
        ("audit.json", lambda text: text.replace(b'"entities": 80', b'"entities": 81')),
    ],
)
def test_a_table_that_disagrees_with_its_graph_is_refused(
    push_and_change, parted_folder, name, change
):
    """A table that disagrees with its graph is refused though the hashes agree."""

    def changed(files):
        before = files[name]
        files[name] = change(before)
        assert files[name] != before

    outcome = push_and_change(parted_folder, changed)
    assert outcome.kind == "ArtefactError"
    assert f"me/mine/{name} does not agree with graph.json" in outcome.err
    assert not Path("new").exists()


def test_a_model_that_does_not_open_is_refused_though_all_hashes_agree(
    push_and_change, recipes_folder
):
    def changed(files):
        vocabulary = json.loads(files["vocabulary.json"])
        del vocabulary["entities"][-1]
        files["vocabulary.json"] = json.dumps(vocabulary).encode()
        record = json.loads(files["run.json"])
        record["outputs"]["vocabulary.json"] = hashlib.sha256(files["vocabulary.json"]).hexdigest()
        files["run.json"] = json.dumps(record).encode()

    outcome = push_and_change(recipes_folder, changed)
    assert (outcome.code, outcome.kind, Path("new").exists()) == (1, "ArtefactError", False)


def test_an_agent_with_fewer_rows_of_knowledge_than_entities_is_never_kept(
    push_and_change, cross_fitted, kitchen, tmp_path
):
    policy, _ = make_policy(PolicyConfig(use="recipe"), kitchen, 4, scorer=cross_fitted.whole)
    name = "constants.safetensors"

    def changed(files):
        tensors = safetensors.torch.load(files[name])
        for part in ("vectors", "near_words", "recipes"):
            key = f"sources.w.knowledge.{part}"
            tensors[key] = tensors[key][:3].clamp(max=2).clone()
        tensors["sources.w.knowledge.seen"] = torch.ones(1, 3, dtype=torch.bool)
        files[name] = safetensors.torch.save(tensors)
        record = json.loads(files["run.json"])
        record["outputs"][name] = hashlib.sha256(files[name]).hexdigest()
        files["run.json"] = json.dumps(record).encode()

    outcome = push_and_change(save_policy(tmp_path / "agent", policy), changed)
    assert (outcome.code, outcome.kind, Path("new").exists()) == (1, "ArtefactError", False)
    assert "vectors has 3 rows; expected one for each of 80 entities" in outcome.err


@pytest.mark.parametrize("name", ["README.md", "config.toml", "metrics.json", "run.json"])
def test_a_link_out_of_a_model_folder_is_never_pushed(hub, run, recipes_folder, name):
    shutil.copytree(recipes_folder, "mine")
    shutil.copyfile(f"mine/{name}", "private")  # even with the right hash
    Path("mine", name).unlink()
    Path("mine", name).symlink_to("../private")
    outcome = run("hub", "push", "mine", "me/mine")
    assert (outcome.kind, f"mine/{name} is a link out of the folder" in outcome.err) == (
        "ArtefactError",
        True,
    )
    assert not hub.created


@pytest.mark.parametrize("name", ["recipes.csv", "triples", "graph.json"])
def test_a_link_out_of_a_graph_folder_is_never_pushed(hub, run, parted_folder, name):
    shutil.copytree(parted_folder, "mine")
    Path("mine", name).rename("private")
    Path("mine", name).symlink_to("../private")
    outcome = run("hub", "push", "mine", "me/mine")
    assert (outcome.kind, "is a link out of the folder" in outcome.err) == ("ArtefactError", True)
    assert not hub.created


@pytest.mark.slow
def test_a_folder_that_is_itself_a_link_is_pushed(hub, run, parted_folder):
    Path("near").symlink_to(parted_folder)
    assert run("hub", "push", "near", "me/mine").code == 0


def test_a_run_that_lists_another_file_is_not_pushed(hub, run, recipes_folder):
    shutil.copytree(recipes_folder, "mine")
    record = json.loads(Path("mine/run.json").read_text())
    record["outputs"]["../private.json"] = hashlib.sha256(b"private").hexdigest()
    Path("private.json").write_text("private")
    Path("mine/run.json").write_text(json.dumps(record))
    outcome = run("hub", "push", "mine", "me/mine")
    assert (outcome.kind, "'../private.json', which is no file of a model" in outcome.err) == (
        "ArtefactError",
        True,
    )


def test_all_files_that_trainings_record_can_be_shared():
    outputs = {*agents.OUTPUTS, *links.OUTPUTS, *recipes.OUTPUTS, *FOLD_OUTPUTS, links.CHOICE}
    assert outputs | {*INPUTS, CONFIG_FILE} == set(folders._RUN_FILES)
