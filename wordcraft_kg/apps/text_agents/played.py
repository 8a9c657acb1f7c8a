"""What is recorded of a game that is over."""

from collections.abc import Sequence

from wordcraft_kg.agents.outcomes import Ending
from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.games import DiscoveryGame, TaskGame
from wordcraft_kg.apps.text_agents.records import PlayedTask, PlayedWorld


def ending_of(game: TaskGame) -> Ending:
    """Return how a game that is over ended, as the evaluation of agents tells it."""
    if game.is_made:
        return "goal"
    if game.last is None:
        return "no_recipe"
    one, other = map(game.graph.id_of, game.last)
    parts = {part for plan in game.tasks.plans[game.task] for part in game.graph.recipes[plan[-1], :2].tolist()}
    if one == other:
        return "same_twice"
    if {one, other} & parts:
        return "one_right_part"
    return "no_right_part" if (min(one, other), max(one, other)) in game.graph.outcomes else "no_recipe"


def played_task(talk: Conversation, messages: Sequence[str]) -> PlayedTask:
    """Return what is recorded of a task that is over."""
    game = talk.game
    assert isinstance(game, TaskGame)
    return PlayedTask(
        task=game.task,
        draw=game.draw,
        goal=game.goal,
        table=game.start,
        success=game.is_made,
        by_plan=game.by_plan,
        picks=game.picks,
        ending=ending_of(game),
        last=game.last,
        refused=talk.refused,
        lost=talk.lost,
        look_ups=talk.look_ups,
        messages=tuple(messages),
    )


def played_world(talk: Conversation, number: int, messages: Sequence[str]) -> PlayedWorld:
    """Return what is recorded of a game in the open-ended world that is over."""
    game = talk.game
    assert isinstance(game, DiscoveryGame)
    return PlayedWorld(
        game=number,
        known_after=tuple(game.known_after),
        repeated=game.repeated,
        refused=talk.refused,
        lost=talk.lost,
        look_ups=talk.look_ups,
        messages=tuple(messages),
    )
