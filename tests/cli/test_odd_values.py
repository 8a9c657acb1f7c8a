"""Values that a command cannot take are refused at once, in a sentence."""

import sys

import pytest


@pytest.mark.parametrize("option", ["--seed=1.5", "--limit=0.0", "--depth=1e0"])
def test_a_fraction_is_refused_for_a_whole_number(run, option):
    outcome = run("tasks", "kitchen", option)
    assert (outcome.code, outcome.out) == (2, "")
    name, _, value = option.partition("=")
    assert f'Invalid value for {name}: unable to convert "{value}" into int.' in outcome.err


def test_a_fraction_in_a_file_is_refused_for_a_whole_number(refused, run, tmp_path):
    config = tmp_path / "odd.toml"
    config.write_text("[tasks]\nseed = 1.5\n")
    refused("tasks", "kitchen", "--config", config, says='unable to convert "1.5" into int', code=2)
    config.write_text("[tasks]\nseed = 1\nlimit = 0\n")
    assert run("tasks", "kitchen", "--config", config).code == 0


def test_whole_numbers_and_fractions_are_taken_where_they_belong(run, tmp_path):
    assert run("build-graph", "kitchen", "--train-ratio=0.5", "--seed=2", "--out", tmp_path / "graph").code == 0


@pytest.mark.parametrize("arguments", [("describe", "\udcff"), ("export", "kitchen", "--format=tsv", "--out=\udcff")])
def test_a_name_that_is_not_utf8_is_refused_before_anything_is_written(refused, arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(*arguments, says="\\udcff' is not UTF-8. Rename the file or folder")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("path", ["", ".", "/dev/zero"])
def test_a_base_file_that_is_none_is_refused(run, path, tmp_path):
    outcome = run("build-graph", "kitchen", "--base-file", path, "--out", tmp_path / "graph")
    assert outcome.code == 1
    assert outcome.err.startswith(f"error: --base-file '{path or '.'}': No such file.")


@pytest.mark.parametrize("path", ["", "/dev/zero"])
def test_a_config_that_is_no_file_is_refused(refused, path):
    refused("tasks", "kitchen", "--config", path, says=["--config", "no such file"])


@pytest.mark.parametrize("command", ["train-complex", "train-links", "train-agent"])
def test_an_output_that_exists_is_refused_before_torch_is_imported(refused, command, tmp_path, monkeypatch):
    for module in ("wordcraft_kg.models.links.training", "wordcraft_kg.agents.training"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / "something").touch()
    refused(command, "kitchen", "--out", tmp_path, says=str(tmp_path), kind="OutputExistsError")


def test_torch_without_memory_is_an_error_in_a_sentence(run, monkeypatch):
    def fail(*_):
        raise RuntimeError("[enforce fail at alloc_cpu.cpp:127] DefaultCPUAllocator: can't allocate memory: you tried")

    monkeypatch.setattr("wordcraft_kg.graphs.folder.open_graph", fail)
    outcome = run("describe", "kitchen")
    assert (outcome.code, outcome.err.count("\n")) == (1, 1)
    assert outcome.kind == "MemoryError"


def test_a_training_that_cannot_fit_says_what_it_would_cost(refused, tmp_path):
    sizes = ("--unroll=16777216", "--batch-size=16777216")
    command = ("train-agent", "kitchen", *sizes, "--out", tmp_path / "run")
    refused(*command, says="16,777,216: an update of 281,474,976,710,656 steps would take")
    assert not (tmp_path / "run").exists()
