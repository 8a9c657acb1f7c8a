"""Sound artefacts of every kind, as small as they can be; the cases spoil copies of them."""

import json
import os
import shutil
import signal
from contextlib import suppress
from pathlib import Path

from tests.helpers import write_graph
from wordcraft_kg.base.artefacts import sha256_of

from .harness import call


def make_home(home):
    """Make a graph, and on it models and agents, finished and interrupted, and a
    study with people."""
    from wordcraft_kg.agents.agent_config import AgentConfig, ImpalaConfig, TaskConfig
    from wordcraft_kg.agents.agent_training import train_agent
    from wordcraft_kg.models.links.link_config import ComplExConfig, LinkModelConfig, LinksConfig
    from wordcraft_kg.models.links.link_training import train_links

    graph = str(write_graph(home / "graph", train_ratio=0.6, valid_ratio=0.1))
    links = LinksConfig(graph, ComplExConfig(dim=4, epochs=3, n3=0.1, folds=2, checkpoint_every=1))
    other = LinksConfig(graph, LinkModelConfig(model="distmult", dim=4, epochs=2))
    trainer = ImpalaConfig(
        steps=320, batch_size=16, log_every=64, eval_every=160, checkpoint_every=64
    )
    agent = AgentConfig(graph, str(home / "model"), TaskConfig(distractors=1), trainer=trainer)

    def press(done, *_):
        if done in (1, 64):
            signal.raise_signal(signal.SIGINT)

    train_links(links, home / "model")
    train_links(other, home / "model-table")
    with suppress(KeyboardInterrupt):
        train_links(links, home / "model-interrupted", progress=press)
    train_agent(agent, home / "agent")
    (home / "agent" / "report").mkdir()
    with suppress(KeyboardInterrupt):
        train_agent(agent, home / "agent-interrupted", progress=press)
    played = (
        "evaluate-agent",
        "graph",
        "--player",
        "program:cat",
        "--distractors",
        "2",
        "--limit",
        "4",
        "--out",
        "text",
    )
    assert call((*played, "--quiet"), home).code == 0
    _make_study(home)
    return home


def _make_study(home):
    """Make a study that two people have begun."""
    from wordcraft_kg.apps.people.study import HumanStudy, kept_answers
    from wordcraft_kg.apps.people.study_config import StudyConfig

    study = HumanStudy(home / "graph", StudyConfig(tasks=3, distractors=(1, 2), forms=2))
    with kept_answers(home / "study", study) as answers:
        for person in [answers.begin(str(number), study.cells) for number in range(2)]:
            for task in study.tasks(person.cell)[: 2 + 4 * person.number]:
                answers.show(person, task.part, task.number, 1.0)
                answers.add(person, study.protocol(person.cell).answer(task, (0, 1), 1.0))


def linked(home, kind, to):
    """Give an artefact, which is not to be changed, a second place."""
    return Path(shutil.copytree(home / kind, to, copy_function=os.link))


def copied(home, kind, to):
    """Copy an artefact to a new place, replacing what is there."""
    shutil.rmtree(to, ignore_errors=True)
    return Path(shutil.copytree(home / kind, to, symlinks=True))


def records_of(folder, name):
    """Return a run's file, and the files with its hash."""
    path = folder / name
    is_checkpoint = path.parent.name == "checkpoints" and path.suffix == ".safetensors"
    return {path, path.with_suffix(".json") if is_checkpoint else folder / "run.json"}


def mended(folder, name):
    """Record the hash that a run's file has now, wherever it is on record, as somebody would who
    hides a change."""
    path = folder / name
    record = path.with_suffix(".json")
    if path.parent.name == "checkpoints" and path.suffix == ".safetensors":
        record.write_text(json.dumps({**json.loads(record.read_text()), "sha256": sha256_of(path)}))
    elif name != "run.json":
        run = json.loads((folder / "run.json").read_text())
        for hashes in (run["inputs"], run["outputs"]):
            if name in hashes:
                hashes[name] = sha256_of(path)
        (folder / "run.json").write_text(json.dumps(run))
