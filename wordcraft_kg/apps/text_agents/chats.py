"""Conversations to fine-tune language models on: games of a player, as messages.

A conversation is what a language model would have said and read, had it played as a scripted player
or a trained model did. Games of the part train alone are written: there held-out pairs make
nothing, so whoever learns from them has seen no test recipe.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from wordcraft_kg.apps.text_agents.benchmark import read_manifest
from wordcraft_kg.apps.text_agents.benchmark_players import check_graph, decided_pairs
from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.games import Picks, TaskGame
from wordcraft_kg.apps.text_agents.plays import Play, chosen_tasks
from wordcraft_kg.base import (
    MAX_SIZE,
    ConfigError,
    LeakError,
    json_text,
    sha256_of,
    staged_file,
    steps,
    write_atomically,
)
from wordcraft_kg.envs.words import combined
from wordcraft_kg.graphs import Ids, OpenedGraph, padded

if TYPE_CHECKING:
    from wordcraft_kg.agents.players import Player
    from wordcraft_kg.models.scorers.recipes import RecipeScorer

Style = Literal["tools", "text"]
"""Attempts as calls of the tool ``combine``, or as answers ``first + second``."""
Kept = Literal["made", "shortest", "all"]
"""Games that made the goal, that made it with one of the shortest plans, or all games."""
Message = dict[str, Any]
"""A message of a conversation: its role, and its content or calls."""
_INVALID = 0.3
"""Share of mistakes that name an item that is not on the table; the others make nothing."""
_REASONS = 3
"""Most recipes in a reason."""
AT_ONCE = 2_000
"""Games that a player plays together."""
CLOSING = "Done."
"""The last message of a player with tools: it calls none any more, which ends a rollout."""
COMBINE: dict[str, Any] = {
    "type": "function",
    "function": {
        "name": "combine",
        "description": "Combine two items on the table. This takes an attempt.",
        "parameters": {
            "type": "object",
            "properties": {
                "first": {
                    "type": "string",
                    "description": "name or number of an item on the table.",
                },
                "second": {
                    "type": "string",
                    "description": "name or number of an item on the table; it can be the first "
                    "item again.",
                },
            },
            "required": ["first", "second"],
        },
        "return": {
            "type": "string",
            "description": "What the pair makes, and the new state of the game.",
        },
    },
}
"""The tool's schema, as transformers makes it of ``CraftingEnvironment.combine``."""
COMBINE_SET: dict[str, Any] = {
    "type": "function",
    "function": {
        "name": "combine",
        "description": "Combine items on the table. This takes an attempt.",
        "parameters": {
            "type": "object",
            "properties": {
                "items": {
                    "type": "array",
                    "items": {"type": "string"},
                    "description": "names or numbers of items on the table, each as often as it is "
                    "needed.",
                },
            },
            "required": ["items"],
        },
        "return": {
            "type": "string",
            "description": "What the items make, and the new state of the game.",
        },
    },
}
"""The same of ``SetCraftingEnvironment.combine``."""
_PICKS = {
    False: "two items, or one item twice",
    True: "between one and {most} items, repeats included",
}
"""Items of an attempt, for pairs and for sets."""
_FORM = {False: "water + earth", True: "water + earth + fire"}
"""Example of an answer, for pairs and for sets."""
WORDINGS = (
    (
        "Here is a puzzle about crafting. Pick {picks} in every attempt. Items are never consumed, "
        "and a new item joins the table. Most picks lead nowhere. Reach the goal in time; the "
        "table always allows it.",
        "End your answer with a line such as: {form}. Use listed items only.",
    ),
    (
        "You stand at a crafting table. An attempt joins {picks}. Few combinations work. Items "
        "stay after use, and results can be used again. Your task is the goal item, which this "
        "table can produce.",
        "Write the items of the attempt with plus signs in the last line, as in {form}.",
    ),
    (
        "Craft the goal. To try something, combine {picks}. Items that you make are added to the "
        "list, nothing is used up, and a wrong combination makes nothing. There is always a way.",
        "Reply with the names or numbers of listed items, joined by plus signs: {form}",
    ),
    (
        "Game: make a wanted item out of those on a table. One attempt = {picks}. A combination "
        "without a recipe costs the attempt and makes nothing. Ingredients remain available.",
        "Format of the last line: {form} (items from the table only).",
    ),
    (
        "The table below holds some items. Among them are all that the goal needs. In an attempt "
        "you put together {picks}; if a recipe exists, its result comes to the table. Your items "
        "do not run out, but your attempts do.",
        "Give your choice in the last line like this: {form}.",
    ),
    (
        "Which items make the goal? You may test {picks} at a time, as long as attempts are left. "
        "Results are kept, used items too. Expect most tests to yield nothing.",
        "Answer in the form {form}, with items that are on the table.",
    ),
    (
        "Think of an alchemist who joins things to get new things. Each attempt takes {picks}. "
        "Nothing that you own is lost. Create the goal item before the attempts are over. It is "
        "possible with this table.",
        "State the items to join, for example {form}, as the last line.",
    ),
    (
        "Rules: (1) an attempt combines {picks}; (2) what you make can be used afterwards; "
        "(3) ingredients are not consumed; (4) most attempts make nothing; (5) the goal can be "
        "made from the table.",
        "Output: one line with listed items and plus signs, such as {form}.",
    ),
    (
        "I give you a goal and a table with items. Tell me what to combine: {picks} for each "
        "attempt. I add whatever comes out to the table and tell you how many attempts are left. "
        "Items can be used any number of times.",
        "Say it as {form} in your last line, and name only items that I list.",
    ),
)
"""Rules and form of an answer in nine wordings beside the benchmark's.

They are templates with two slots, the items of an attempt and the form of an answer, so that a
language model learns the game and not its prompt.
"""


def new_counts() -> dict[str, Any]:
    """Return counts of games, all 0.

    These are all games (``played``), those that made the goal (``made``), those that were not to be
    kept (``left_out``) or whose conversation was written before (``repeated``), and conversations:
    all ``written``, those that do not make the goal (``lost``), those that make it after a mistake
    (``recovered``), by depth, and by wording of the rules.
    """
    names = ("played", "made", "left_out", "repeated", "written", "lost", "recovered")
    return {**dict.fromkeys(names, 0), "by_depth": Counter(), "by_wording": Counter()}


def worded_rules(talk: Conversation, wording: int, *, by_tool: bool) -> str:
    """Return the rules of a game in a wording.

    Args:
        talk: the conversation, without look-ups.
        wording: 0 for the benchmark's wording, else a number up to the size of ``WORDINGS``.
        by_tool: whether the tool's schema says how to answer, and the rules need not.
    """
    game = talk.game
    call = "Use the tool `combine` for each attempt."
    if not wording:
        return f"{game.rules}\n{call}" if by_tool else talk.rules
    rules, form = WORDINGS[wording - 1]
    is_set = game.most_picks > 0
    text = rules.format(picks=_PICKS[is_set].format(most=game.most_picks))
    return f"{text}\n{call if by_tool else form.format(form=_FORM[is_set])}"


def chat_rows(  # noqa: PLR0913 - each argument is an option of the command
    plays: Sequence[Play],
    player: "Player",
    counts: dict[str, Any],
    *,
    style: Style = "tools",
    keep: Kept = "made",
    tables: int = 1,
    tasks: int | None = None,
    mistakes: float = 0.0,
    seed: int = 0,
    difficulty: tuple[float, float] | None = None,
    scorer: "RecipeScorer | None" = None,
) -> Iterator[dict[str, Any]]:
    """Let a player play the train tasks, and yield the conversations.

    Args:
        plays: games of the part train, for each depth and number of distractors.
        player: a scripted player or a policy.
        counts: counts of :func:`new_counts`, which this function adds to.
        style: calls of a tool, or text.
        keep: games to keep.
        tables: tables for each task, each with distractors of its own.
        tasks: most tasks of each depth and number of distractors, evenly spaced; None for all.
        mistakes: probability of a mistake before each attempt of the player, from 0 to below 1.
        seed: seed of the player, the tables, the wordings and the orders.
        difficulty: least and largest measured difficulty of the tasks; None for all.
        scorer: scorer of recipes whose evidence is the reason of each attempt; None for answers
            without reasons.

    Yields:
        Rows with ``id`` (the game's name), ``messages``, ``tools`` in this style, ``part``,
        ``depth``, ``distractors``, ``goal``, ``attempts`` (those taken), ``made``, ``wording``,
        ``mistakes`` (places of the messages that a learner should not imitate) and ``canary``.

    Raises:
        ConfigError: for games of another part than train.
    """
    # A mark by which large collections of texts can recognise and leave out such data: the
    # benchmark's canary without its request not to train. These conversations are there to train
    # on, knowingly.
    canary = read_manifest()[0].canary.partition(":")[0]
    digests: set[bytes] = set()
    for play in plays:
        if play.settings.part != "train" or play.settings.track:
            raise ConfigError(
                f"`part` {play.settings.part}: expected train; conversations of other tasks would "
                "tell a language model what the benchmark asks it."
            )
        # A generator for each depth and number of distractors: others do not change its games.
        key = [seed, play.settings.depth or 0, play.settings.distractors or 0]
        rng = np.random.default_rng(key)
        words = np.random.default_rng([*key, 1])
        numbers = np.tile(chosen_tasks(play.world, tasks, difficulty), tables)
        for talk, pairs in _played(play, player, numbers, rng):
            game = talk.game
            assert isinstance(game, TaskGame)
            wording = int(words.integers(len(WORDINGS) + 1))
            rules = worded_rules(talk, wording, by_tool=style == "tools")
            messages, places = _said(talk, game, pairs, rules, style, mistakes, words, scorer)
            counts["played"] += 1
            counts["made"] += game.is_made
            if not _is_kept(game, keep, places):
                counts["left_out"] += 1
            elif (digest := hashlib.sha256(json.dumps(messages).encode()).digest()) in digests:
                counts["repeated"] += 1
            else:
                digests.add(digest)
                counts["written"] += 1
                counts["lost"] += not game.is_made
                counts["recovered"] += game.is_made and bool(places)
                counts["by_depth"][play.settings.depth] += 1
                counts["by_wording"][wording] += 1
                schema = COMBINE_SET if game.most_picks else COMBINE
                tools = {"tools": [schema]} if style == "tools" else {}
                yield {
                    "id": talk.name,
                    "messages": messages,
                    **tools,
                    "part": play.settings.part,
                    "depth": play.settings.depth,
                    "distractors": play.settings.distractors,
                    "goal": game.goal,
                    "attempts": len(game.pairs),
                    "made": game.is_made,
                    "wording": wording,
                    "mistakes": places,
                    "canary": canary,
                }


def _played(
    play: Play, player: "Player", tasks: Ids, rng: np.random.Generator
) -> Iterator[tuple[Conversation, Sequence[Picks | None]]]:
    """Yield the conversation of a game on each task at its beginning, and the player's pairs."""
    world = play.world
    graph = world.graph
    # Each game has a seed of its own: with a seed for each table, a task would meet the same
    # distractors at every depth and number of distractors.
    seeds = rng.integers(MAX_SIZE, size=len(tasks))
    for start in steps("playing", range(0, len(tasks), AT_ONCE)):
        block = slice(start, start + AT_ONCE)
        numbers = tasks[block].tolist()
        talks = [
            play.begin(task, seed)
            for task, seed in zip(numbers, seeds[block].tolist(), strict=True)
        ]
        ids = [[graph.id_of(label) for label in talk.game.labels] for talk in talks]
        tables = padded(ids, world.nothing)
        yield from zip(talks, decided_pairs(world, numbers, tables, player, rng), strict=True)


def _said(
    talk: Conversation,
    game: TaskGame,
    pairs: Sequence[Picks | None],
    rules: str,
    style: Style,
    share: float,
    rng: np.random.Generator,
    scorer: "RecipeScorer | None",
) -> tuple[list[Message], list[int]]:
    """Play a game again in words, with mistakes before a share of the attempts.

    Returns:
        All messages, and the places of mistakes among them.
    """
    by_tool = style == "tools"
    messages: list[Message] = [
        {"role": "system", "content": rules},
        {"role": "user", "content": game.state},
    ]
    if by_tool:
        messages = [{"role": "user", "content": f"{rules}\n\n{game.state}"}]
    mistakes: list[int] = []
    for pair in pairs:
        if not talk.is_over and rng.random() < share:
            mistakes.append(len(messages))
            messages += _turn(talk, _mistake(game, rng), by_tool)
        # A mistake may have taken the last attempt.
        if talk.is_over:
            break
        # An empty slot: there is no answer in words for it.
        if pair is None:
            game.lose_attempt()
            continue
        reason = "" if scorer is None else _reason(game, pair, scorer)
        messages += _turn(talk, rng.permutation(pair).tolist(), by_tool, reason)
    if by_tool:
        messages.append({"role": "assistant", "content": CLOSING})
    else:
        # After the last answer nobody is asked any more.
        messages.pop()
    return messages, mistakes


def _turn(
    talk: Conversation, picks: Sequence[str], by_tool: bool, reason: str = ""
) -> list[Message]:
    """Make an attempt; return the player's message, with a reason, and the reply."""
    if not by_tool:
        answer = " + ".join(picks)
        if reason:
            answer = f"{reason}\n{answer}"
        reply = {"role": "user", "content": talk.hear(answer)}
        return [{"role": "assistant", "content": answer}, reply]
    arguments: dict[str, Any] = {"items": list(picks)}
    if not talk.game.most_picks:
        arguments = dict(zip(("first", "second"), picks, strict=True))
    call = {"type": "function", "function": {"name": "combine", "arguments": arguments}}
    # Without a content, data sets fill in None, which chat templates may print.
    message: Message = {"role": "assistant", "content": reason, "tool_calls": [call]}
    return [message, {"role": "tool", "name": "combine", "content": talk.combine(*picks)}]


def recipe_scorer(folder: Path, opened: OpenedGraph) -> "RecipeScorer":
    """Open the scorer of recipes in a model folder.

    Raises:
        ConfigError: if the model scores no recipes, so it has no evidence.
        LeakError: if it has learned the test recipes, which would be among the reasons.
        GraphMismatchError: if it is of another graph or split.
        ArtefactError: if the folder is missing or damaged.
    """
    from wordcraft_kg.models.model_folder import open_model
    from wordcraft_kg.models.scorers.cross_fitting import whole_of
    from wordcraft_kg.models.scorers.recipes import RecipeScorer

    model = open_model(folder)
    scorer = whole_of(model.scorer)
    check_graph(str(folder), model.opened, opened)
    if not isinstance(scorer, RecipeScorer):
        raise ConfigError(f"`reasons` '{folder}': expected a model of train-recipes.")
    if model.kg == "full":
        raise LeakError(
            f"`reasons` '{folder}': this model has learned all recipes, and its reasons would name "
            "test recipes; expected a model of the train recipes (`kg` partial)."
        )
    return scorer


def _reason(game: TaskGame, pair: Picks, scorer: "RecipeScorer") -> str:
    """Return the train recipes that make a scorer expect a pair's result; empty without any.

    The pair's own recipe is not among them: it would be the answer, not a reason for it.
    """
    graph = game.graph
    ids = tuple(sorted(map(graph.id_of, pair)))
    results = graph.labels(game.world.outcomes.get(ids, ()))
    result = game.goal if game.goal in results or not results else results[0]
    lines = []
    for support in scorer.supporting_recipes(pair[0], pair[-1], result, limit=_REASONS + 1):
        ingredients = (support.ingredient_a, support.ingredient_b)
        if sorted(ingredients) != sorted(pair):
            lines.append(combined(ingredients, (support.result,)))
    if not lines:
        return ""
    return f"Similar recipes: {', '.join(lines[:_REASONS])}. So {result} may need {pair[0]}."


def _mistake(game: TaskGame, rng: np.random.Generator) -> list[str]:
    """Return two items of which one is not on the table, or that make nothing by train recipes."""
    table = game.labels
    if rng.random() < _INVALID:
        absent = sorted({*game.graph.entities} - {*table})
        return [str(rng.choice(table)), str(rng.choice(absent))]
    ids = {label: game.graph.id_of(label) for label in table}
    outcomes = game.world.outcomes
    pairs = [
        pair
        for pair in combinations(sorted(table, key=ids.__getitem__), 2)
        if not outcomes.get((ids[pair[0]], ids[pair[1]]))
    ]
    return list(pairs[rng.integers(len(pairs))]) if pairs else [table[0], table[0]]


def _is_kept(game: TaskGame, choice: Kept, mistakes: Sequence[int]) -> bool:
    if choice == "shortest":
        return game.is_made and not mistakes and len(game.pairs) == game.tasks.depth
    return None not in game.pairs and (choice == "all" or game.is_made)


def write_chats(out: Path, rows: Iterator[dict[str, Any]], *, force: bool = False) -> str:
    """Write conversations as JSON lines, complete or not at all.

    Args:
        out: file to write.
        rows: conversations.
        force: whether an existing file is replaced.

    Returns:
        The SHA-256 of the file.

    Raises:
        OutputExistsError: if the file exists, without ``force``.
        ConfigError: if there is no conversation.
    """
    with staged_file(out, force=force) as staged:
        write_atomically(staged, (json_text(row) + "\n" for row in rows))
        if not staged.stat().st_size:
            raise ConfigError(
                "no conversation is left: the player made no goal; expected a better player, or "
                "`keep` all."
            )
    return sha256_of(out)
