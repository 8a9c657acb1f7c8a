"""Own ideas: an own policy, source, reward, split or player, each below a decorator.

A file with them is a plugin: ``wordcraft-kg --plugin ideas.py train-agent ...``, or in Python
:func:`load_plugin`. Another package names a module with them as an entry point in the group
``wordcraft_kg.plugins``. The guide docs/own-ideas.md has an example of each.

What a run is made with is recorded by name, and for a plugin file by its hash: to open the run,
name the same file again.
"""

from collections.abc import Callable, MutableMapping
from dataclasses import replace
from inspect import getdoc, signature
from typing import Any, TypeVar

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.registry import load_plugin as load_plugin

T = TypeVar("T", bound=Callable[..., Any])


def policy(name: str) -> Callable[[T], T]:
    """Register a network for ``PolicyConfig(policy=name)`` and ``train-agent --policy``.

    A class ``Network(dim)`` of :class:`torch.nn.Module`, for entity vectors of length ``dim``, with
    ``forward(states, vectors) -> (logits, value)``; shapes are those of
    :class:`~wordcraft_kg.models.policies.networks.NetworkPolicy`, which takes no dropout.
    """
    from wordcraft_kg.models.policies.policy_config import POLICIES

    return _adding(POLICIES, name, lambda thing: _called(name, thing, "dim"))


def source(name: str) -> Callable[[T], T]:
    """Register scores of slots for ``PolicyConfig(use=name)`` and ``train-agent --use``.

    A function ``(labels) -> scores`` of the E entities' labels: how well each entity serves each
    goal, shape (goals, entities), on any scale, NaN where unknown. Or a subclass of
    :class:`~wordcraft_kg.models.policies.sources.source.Source` for all else.
    """
    from wordcraft_kg.models.policies.sources import SOURCES, Label
    from wordcraft_kg.models.policies.sources.pairs import GoalTable

    def made(thing: Any) -> Any:
        label = Label(name, name, name, meaning=_first_line(thing))
        if not isinstance(thing, type):
            scores_of = staticmethod(_called(name, thing, "labels"))
            return type(name, (GoalTable,), {"label": label, "scores_of": scores_of})
        # A class may have a label with a symbol of its own.
        kind: Any = thing
        kind.label = replace(getattr(thing, "label", label), name=name)
        return kind

    return _adding(SOURCES, name, made)


def reward(name: str) -> Callable[[T], T]:
    """Register rewards of training for ``TaskConfig(reward=name)`` and ``train-agent --reward``.

    A function ``(before, after, step) -> rewards`` of the batched states before and after a step,
    :class:`~wordcraft_kg.envs.batch.State`, and its :class:`~wordcraft_kg.envs.batch.Step`, whose
    own reward is 1 for the goal; shape (N,). Evaluations count goals, whatever the reward.
    """
    from wordcraft_kg.envs.world_config import REWARDS

    arguments = ("before", "after", "step")
    return _adding(REWARDS, name, lambda thing: _called(name, thing, *arguments))


def split(name: str) -> Callable[[T], T]:
    """Register a way to split recipes for ``SplitConfig(name)`` and ``build-graph --split``.

    A function ``(graph) -> groups`` that gives each recipe of a
    :class:`~wordcraft_kg.graphs.recipe_graph.RecipeGraph` the number of its group, shape
    (num_recipes,), int64. Whole groups are drawn for a part, and resampled together.
    """
    from wordcraft_kg.graphs.splits import SPLITS, SplitKind

    def made(groups: Any) -> SplitKind:
        return SplitKind(_called(name, groups, "graph"), _first_line(groups), unit="groups")

    return _adding(SPLITS, name, made)


def player(name: str) -> Callable[[T], T]:
    """Register a scripted player, which joins the table of ``evaluate-agent GRAPH``.

    A function ``(split) -> play`` that returns a function ``(state, rng) -> slots``, see
    :mod:`~wordcraft_kg.agents.players`.
    """
    from wordcraft_kg.agents.players import PLAYERS

    return _adding(PLAYERS, name, lambda thing: _called(name, thing, "split"))


def _adding(
    registry: MutableMapping[str, Any], name: str, made: Callable[[Any], Any]
) -> Callable[[T], T]:
    """Return a decorator that adds what ``made`` makes of an object to a registry."""

    def register(thing: T) -> T:
        registry[name] = made(thing)
        return thing

    return register


def _called(name: str, thing: Any, *arguments: str) -> Any:
    """Return an object that can be called with these arguments; refuse it before a training."""
    try:
        signature(thing).bind(*arguments)
    except TypeError as error:
        raise ConfigError(
            f"'{name}' cannot be called with ({', '.join(arguments)}): {error}. Correct its "
            "arguments."
        ) from None
    return thing


def _first_line(thing: Any) -> str:
    return (getdoc(thing) or "").partition("\n")[0]
