"""The package for verifiers: by the library if it is installed, else by a stand-in of what it uses.

The stand-in has the classes and signatures of verifiers 0.4 that the package needs, and no more.
"""

import asyncio
import importlib
import sys
from contextlib import asynccontextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from wordcraft_kg.apps.text_agents.trl import CraftingEnvironment

PACKAGE = Path(__file__).parents[3] / "publish" / "verifiers"


class Model:
    """A model of pydantic: annotated fields with defaults, and keyword arguments."""

    def __init_subclass__(cls):
        names = {name for base in cls.__mro__ for name in getattr(base, "__annotations__", ())}
        defaults = {name: getattr(cls, name) for name in names if hasattr(cls, name)}
        cls.model_fields = {name: SimpleNamespace(default=defaults.get(name)) for name in names}

    def __init__(self, **values):
        assert values.keys() <= self.model_fields.keys()
        for name, field in self.model_fields.items():
            setattr(self, name, values.get(name, field.default))


class TasksetConfig(Model):
    id: str = ""
    task: object = None


class TaskData(Model):
    name: str
    prompt: str


class EnvConfig(Model):
    taskset: object = None


class Parameterised:
    """A generic class whose parameters are kept: the library finds the types of settings so."""

    def __class_getitem__(cls, parameters):
        return type(cls.__name__, (cls,), {"parameters": parameters})


class Task(Parameterised):
    def __init__(self, data, config=None):
        self.data = data
        self.config = config


class Taskset(Parameterised):
    def __init__(self, config):
        self.config = config

    def __iter__(self):
        return iter(self.load())


class Env(Parameterised):
    def __init__(self, config):
        self.config = config
        self.taskset = exported(config.taskset.id, Taskset)(config.taskset)


def exported(module, base):
    """The one subclass that a module names in ``__all__``."""
    things = [getattr(sys.modules[module], name) for name in sys.modules[module].__all__]
    (kind,) = [thing for thing in things if isinstance(thing, type) and issubclass(thing, base)]
    return kind


def resolve_env_config(values):
    module = values["taskset"]["id"]
    _, settings = exported(module, Taskset).parameters
    taskset = settings(**values["taskset"])
    return exported(module, Env).parameters(**{**values, "taskset": taskset})


def load_environment(config):
    return exported(config.taskset.id, Env)(config)


def stand_in():
    module = ModuleType("verifiers.v1")
    parts = (TasksetConfig, TaskData, EnvConfig, Task, Taskset, Env)
    vars(module).update({kind.__name__: kind for kind in parts})
    for name in ("State", "TaskConfig", "AgentConfig", "HarnessConfig", "SubprocessConfig"):
        setattr(module, name, type(name, (SimpleNamespace,), {}))
    module.resolve_env_config = resolve_env_config
    module.load_environment = load_environment
    return {"verifiers": ModuleType("verifiers"), "verifiers.v1": module}


@pytest.fixture
def package(monkeypatch):
    if importlib.util.find_spec("verifiers") is None:
        for name, module in stand_in().items():
            monkeypatch.setitem(sys.modules, name, module)
        sys.modules["verifiers"].v1 = sys.modules["verifiers.v1"]
    monkeypatch.syspath_prepend(str(PACKAGE))
    monkeypatch.delitem(sys.modules, "crafting_games", raising=False)
    yield importlib.import_module("crafting_games")
    del sys.modules["crafting_games"]


class Player:
    """A model with answers that are known before; then it is cut off, as at a limit of tokens."""

    def __init__(self, answers):
        self.answers = [*answers]
        self.heard = []
        self.rewards = {}
        self.trace = self

    def record_reward(self, name, value, weight=1.0):
        self.rewards[name] = (value, weight)

    async def turn(self, message=None):
        self.heard.append(message)
        if not self.answers:
            return SimpleNamespace(terminated=True, last_reply="")
        return SimpleNamespace(terminated=False, last_reply=self.answers.pop(0))

    @asynccontextmanager
    async def interaction(self, task):
        self.heard.append(task.data.prompt)
        yield self


def played(env, task, answers):
    player = Player(answers)
    asyncio.run(env.run(task, SimpleNamespace(player=player)))
    return player


def plan_of(task):
    game = CraftingEnvironment()
    game.reset(**task.data.row)
    plan = game.talk.game.tasks[game.talk.game.task].plans[0]
    return [f"We need it.\n{' + '.join(recipe.ingredients)}" for recipe in plan]


def test_a_plan_earns_the_goal_and_the_form_at_each_depth(package):
    env = package.load_environment(graph="kitchen", distractors=2, depth=[1, 2], tasks=5)
    tasks = [*env.taskset]
    assert [task.data.row["depth"] for task in tasks[:4]] == [1, 2, 1, 2]
    assert len({task.key for task in tasks}) == len(tasks) == 10
    for task in tasks:
        player = played(env, task, plan_of(task))
        assert player.rewards == {"goal": (1, 1.0), "form": (1, 0.1)}
        assert f"Goal: {task.data.row['goal']}" in player.heard[0]
        assert "tool" not in player.heard[0]


def test_the_form_is_a_reward_of_its_own_and_a_game_that_is_cut_off_has_both(package):
    env = package.load_environment(graph="kitchen", part="test", depth=[1], tasks=1, form=0.5)
    (task,) = env.taskset
    late = played(env, task, ["I do not know.", *plan_of(task)])
    assert late.rewards == {"goal": (1, 1.0), "form": (0, 0.5)}
    assert late.heard[2].startswith("Invalid answer")
    assert played(env, task, []).rewards == {"goal": (0, 1.0), "form": (0, 0.5)}
