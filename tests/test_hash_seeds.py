"""All that is computed is the same in a process with another hash seed: one such process makes
everything."""

import contextlib
import hashlib
import io
import json
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

from wordcraft_kg.graphs import SPLITS, open_graph
from wordcraft_kg.graphs.export import EXPORTERS


def graph_folders_and_exports():
    from wordcraft_kg.cli import main

    for split in SPLITS:
        book = "everyday" if split == "by-kind" else "kitchen"
        assert main(["build-graph", book, "--split", split, "--seed", "3", "--out", split]) == 0
    for format in EXPORTERS:
        assert main(["export", "by-recipe", "--format", format, "--out", f"export.{format}"]) == 0


def tasks():
    from wordcraft_kg.graphs.tasks import make_tasks

    opened = open_graph("kitchen")
    for depth, part in product((1, 2, 3, 4), ("all", "train", "test")):
        made = make_tasks(opened.graph, depth, opened.split, part, limit=20, seed=5)
        print(*made, made.mixed, sep="\n")


def train_samples():
    from wordcraft_kg.graphs.train_samples import draw_train_sample

    print(draw_train_sample(open_graph("kitchen").split, 0.5, 0.2).hash)


def episodes():
    import gymnasium as gym

    import wordcraft_kg  # noqa: F401 - registers the environments

    env = gym.make("WordCraft-v0", graph="kitchen", depth=2, num_distractors=5)
    print(
        *(
            (seen["goal"], seen["table"].tolist())
            for seen in (env.reset(seed=3)[0], *(env.reset()[0] for _ in range(20)))
        )
    )


def discovery():
    from wordcraft_kg.agents.discovery import DISCOVERERS, make_discoverers, play_runs

    graph = open_graph("kitchen").graph
    players = make_discoverers(
        [name for name in DISCOVERERS if name != "recipe-learner"],
        graph,
        book=open_graph("everyday").graph,
    )
    curves = play_runs(graph, players, 20, 3)
    print({name: known.tolist() for name, known in curves.items()})


def link_models():
    from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
    from wordcraft_kg.models.links.link_training import train_links

    trained = train_links(
        LinksConfig("kitchen", ComplExConfig(dim=8, epochs=5, n3=0.1, folds=0)), Path("model")
    )
    for path in trained.folder.iterdir():
        if path.name not in ("model.safetensors", "vocabulary.json"):  # times
            path.unlink()


def reports():
    from wordcraft_kg.evaluation.links import view_links
    from wordcraft_kg.evaluation.ranked_links import rank_links
    from wordcraft_kg.models.scorers.baselines import FrequencyScorer
    from wordcraft_kg.reports.link_report import make_link_report
    from wordcraft_kg.reports.pages import write_report

    opened = open_graph("kitchen")
    scorer = FrequencyScorer(opened.graph, opened.split.partial)
    links = rank_links(scorer, opened)
    write_report(make_link_report(view_links(links), links.labelled_ranks), Path("report"))


MAKERS = {
    make.__name__: make
    for make in (
        graph_folders_and_exports,
        tasks,
        train_samples,
        episodes,
        discovery,
        link_models,
        reports,
    )
}
"""Functions that print, or write into the working folder."""


def made_by(make, folder):
    """Return the SHA-256 of the printed text and of each file that a function writes."""
    folder.mkdir()
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        make()
    files = {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    files["stdout"] = printed.getvalue().encode()
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    folder = tmp_path_factory.mktemp("elsewhere")
    environment = os.environ | {"PYTHONHASHSEED": "1"}
    done = subprocess.run(
        [sys.executable, __file__, folder],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", MAKERS)
def test_another_process_with_another_hash_seed_makes_the_same_bytes(name, elsewhere, tmp_path):
    here = made_by(MAKERS[name], tmp_path / "here")
    assert here == elsewhere[name]
    assert len(here) > 1 or here["stdout"] != hashlib.sha256(b"").hexdigest()


if __name__ == "__main__":
    import torch

    torch.set_num_threads(1)
    print(
        json.dumps({name: made_by(make, Path(sys.argv[1]) / name) for name, make in MAKERS.items()})
    )
