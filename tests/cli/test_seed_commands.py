"""Several seeds of one training as a user runs them: folders, resuming, and comparing."""

import json
import shutil
from pathlib import Path

import pytest
from graph_folders import write_graph
from quick import SMALL, TINY, contents, same, succeed

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import read_seeds

AGENT = (*SMALL, "--distractors", 2)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0-4", [0, 1, 2, 3, 4]),
        ("7", [7]),
        ("0,3,7", [0, 3, 7]),
        ("2-3, 0-2", [2, 3, 0, 1]),
        ("5-5,5", [5]),
    ],
)
def test_seeds_are_numbers_and_ranges_each_once(text, expected):
    assert read_seeds(text) == expected


@pytest.mark.parametrize(
    "text", ["", "a", "4-0", "-1", "1-", "0,,1", "1.5", "0-1000", "0-999,2000", "9" * 30]
)
def test_what_is_no_list_of_seeds_is_refused(text):
    with pytest.raises(ConfigError) as error:
        read_seeds(text)
    assert error.value.setting == "seeds"


@pytest.mark.parametrize(
    ("command", "weights"),
    [
        (("train-agent", *AGENT, "--seed", 1), ("policy.safetensors", "plain/seed-1")),
        pytest.param(
            ("train-complex", *TINY, "--seed", 3),
            ("model.safetensors", "links/seed-3"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_each_seed_is_an_ordinary_run(run, world, trained, tmp_path, command, weights):
    name, *options = command
    assert run(name, world / "graph", *options, "--out", tmp_path / "single").code == 0
    assert same(
        weights[0], (trained if "links" in weights[1] else world) / weights[1], tmp_path / "single"
    )


@pytest.mark.parametrize(
    ("command", "options"),
    [("train-agent", AGENT), pytest.param("train-complex", TINY, marks=pytest.mark.slow)],
)
def test_seeds_that_are_done_are_kept_and_others_are_added(
    printed, world, trained, tmp_path, command, options
):
    source = trained / "links" if command == "train-complex" else world / "plain"
    shutil.copytree(source, tmp_path / "seeds")
    values = printed(
        command, world / "graph", *options, "--seeds", "0,4", "--out", tmp_path / "seeds"
    )
    assert values["out"] == str(tmp_path / "seeds")
    assert values["seeds"].keys() == {"0", "4"}
    assert all(Path(one["out"]).is_dir() for one in values["seeds"].values())
    assert contents(source).items() <= contents(tmp_path / "seeds").items()
    assert (tmp_path / "seeds/seed-4/run.json").is_file()
    if command == "train-complex":
        forced = ("--n3", "0.2", "--seeds", "0,3", "--out", tmp_path / "seeds", "--force")
        assert printed(command, trained / "graph", *options, *forced)["seeds"].keys() == {"0", "3"}
        for seed in ("seed-0", "seed-3"):
            assert not same("model.safetensors", tmp_path / "seeds" / seed, source / seed)


@pytest.mark.slow
def test_a_killed_seed_begins_again_and_its_report_is_written(world, tmp_path):
    """A seed that was killed at once begins again and a missing report is written."""
    shutil.copytree(world / "plain", tmp_path / "plain")
    shutil.rmtree(tmp_path / "plain/seed-0/report")
    killed = tmp_path / "plain/seed-1"
    record = json.loads((killed / "run.json").read_text())
    (killed / "run.json").write_text(
        json.dumps(record | {"status": "running", "ended": None, "outputs": {}})
    )
    succeed(("train-agent", world / "graph", *AGENT, "--seeds", "0-1", "--out", tmp_path / "plain"))
    assert same("policy.safetensors", killed, world / "plain/seed-1")
    assert (tmp_path / "plain/seed-0/report/index.html").is_file()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--scorer-cost 0.1", "was trained with --scorer-cost "),
        ("--max-attempts 2", "--max-attempts None, and this command has 2"),
        ("--scorer {trained}/one", "another scorer"),
        ("{other}", "another split"),
        ("everyday", "another graph"),
    ],
)
def test_a_seed_with_other_settings_or_data_is_not_taken_for_the_same(
    refused, world, trained, tmp_path, options, says
):
    write_graph(tmp_path / "other", seed=1)
    words = options.format(trained=trained, other=tmp_path / "other").split()
    graph = [] if words[0].startswith("--") else [words.pop()]
    command = (
        "train-agent",
        *(graph or [world / "graph"]),
        *AGENT,
        *words,
        "--seeds",
        "0-1",
        "--out",
    )
    before = contents(world / "plain")
    refused(*command, world / "plain", says=says, kind="ConfigError")
    assert contents(world / "plain") == before


def test_the_same_graph_by_another_name_keeps_the_seeds(run, refused, world, trained):
    """The same graph by another name keeps the seeds and another trainer does not."""
    before = contents(world / "plain")
    assert (
        run("train-agent", "kitchen", *AGENT, "--seeds", "0-1", "--out", world / "plain").code == 0
    )
    links = ("train-complex", trained / "graph", *TINY, "--seeds", "0", "--out")
    refused(*links, world / "plain", kind="OutputExistsError")
    refused(
        *links, trained / "links", "--n3", "0.2", says="this command has 0.2", kind="ConfigError"
    )
    single = (
        "train-agent",
        world / "graph",
        *AGENT,
        "--seeds",
        "0-1",
        "--out",
        world / "plain/seed-0",
    )
    refused(*single, says="is a single run", kind="OutputExistsError")
    assert contents(world / "plain") == before


@pytest.mark.parametrize(
    "command",
    [
        "evaluate-agent {world}/plain",
        "explain {world}/plain",
        "evaluate-links {trained}/links",
        "score {trained}/links flour combinesWith",
        "train-agent kitchen --out {trained}/links/never --scorer {trained}/links",
    ],
)
def test_a_folder_of_seeds_is_refused_where_one_run_is_needed(refused, world, trained, command):
    """Where one run is needed a folder of seeds is refused with one of them."""
    message = refused(*command.format(world=world, trained=trained).split(), kind="ArtefactError")
    folder = world / "plain" if "{world}" in command else trained / "links"
    assert f"holds a run for each of 2 seeds; give one run, such as {folder / 'seed-0'}." in message
    assert not (trained / "links/never").exists()
