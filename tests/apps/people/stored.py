"""Helpers of study tests: stored answers, other graphs, threads, unchanged folders and refused
commands."""

import threading
from contextlib import contextmanager
from types import SimpleNamespace

from wordcraft_kg.apps.people.study import read_study
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split


def lines_of(folder):
    """Return the lines of a study's export as objects, with tuples for lists."""
    return [
        SimpleNamespace(
            **{
                name: tuple(value) if isinstance(value, list) else value
                for name, value in line.items()
            }
        )
        for session in read_study(folder)
        for line in session.lines()
    ]


def answered(protocol, task, is_right, seconds=1.0):
    """Return a right answer, or one of an entity with itself that is not in the plan."""
    one, other = (task.table.index(label) for label in task.plans[0][:2])
    wrong = next(slot for slot in range(len(task.table)) if slot not in (one, other))
    return protocol.answer(task, (one, other) if is_right else (wrong, wrong), seconds)


def posed(protocol, seed, part, number):
    """Return an environment with a task of a protocol, and its observation."""
    task = protocol.task(seed, part, number)
    env = WordCraftEnv(protocol.world.variant(part=part))
    observation, _ = env.reset(options={"task": task.index, "table": task.table})
    return env, observation


def go_on(answers, study, person, count=6):
    """Answer so many tasks more, every other one rightly."""
    begun = len(answers.answers_of(person))
    for place, task in list(enumerate(study.tasks(person.cell)))[begun : begun + count]:
        answers.show(person, task.part, task.number, 100.0)
        assert answers.add(person, answered(study.protocol(person.cell), task, place % 2 == 0, 3.5))


def other_world(kitchen, what):
    """Return the kitchen with another split, or with one more recipe."""
    more = [("bread", "sand", "kiln")] if what == "graph" else []
    graph = RecipeGraph.from_recipes([*kitchen.recipe_labels(), *more]) if more else kitchen
    return OpenedGraph(graph, make_split(graph, SplitConfig(seed=1)), "here")


def at_once(work, threads):
    """Do some work in several threads at once, and wait for them."""
    running = [threading.Thread(target=work) for _ in range(threads)]
    for thread in running:
        thread.start()
    for thread in running:
        thread.join()


def contents(folder):
    """Return the files of a folder by their names."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


@contextmanager
def unchanged(folder):
    """Check that a block changes no file of a folder."""
    before = contents(folder)
    yield
    assert contents(folder) == before


def refused(outcome, kind="ConfigError"):
    """Return the message of a command that was refused: one line, of this kind of error, without
    output."""
    assert (outcome.code, outcome.out, outcome.kind) == (1, "", kind)
    assert outcome.err.startswith("error: ")
    assert "Traceback" not in outcome.err
    return str(outcome.err)
