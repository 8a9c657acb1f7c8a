"""Games as text, and results: the tables, rules and counts of the agents, to the last digit."""

from itertools import product

import pytest

from tests.apps.text_agents.scripted import PLAYERS, assert_same, picks_of
from wordcraft_kg import RecipeGraph, SplitConfig, WordCraftConfig, World, make_split
from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import recipe_oracle
from wordcraft_kg.apps.text_agents.conversation import (
    Conversation,
    hidden_pairs,
    known_recipes,
)
from wordcraft_kg.apps.text_agents.likely_links import LikelyLinks
from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, GameList, TaskGames, open_play
from wordcraft_kg.apps.text_agents.results import evaluation_of, mean_known, record_of
from wordcraft_kg.apps.text_agents.settings import MAX_INVALID
from wordcraft_kg.apps.text_agents.text_env import TextEnv
from wordcraft_kg.apps.text_agents.trl import SetCraftingEnvironment, crafting_rows
from wordcraft_kg.base.answers import read_set
from wordcraft_kg.base.errors import ActionError, EpisodeError, GraphMismatchError, LeakError
from wordcraft_kg.graphs import OpenedGraph
from wordcraft_kg.models.scorers.baselines import FrequencyScorer


def play_all(games, distractor_seeds, player):
    """Let a player, by task and draw, play all tasks."""
    played = []
    for task, distractor_seed in product(range(len(games.world.tasks)), range(distractor_seeds)):
        talk = Conversation(games.game(task, distractor_seed))
        answer = player(task, distractor_seed)
        while not talk.is_over:
            talk.hear(answer(talk.messages[-1]))
        played.append(record_of(talk))
    return played


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        *(pytest.param(name, {}, id=f"depth 1-{name}") for name in PLAYERS),
        *(
            pytest.param(
                name,
                {"depth": 2, "num_tasks": 12, "max_attempts": 3},
                id=f"depth 2-{name}",
                marks=[] if name == "oracle" else pytest.mark.slow,
            )
            for name in PLAYERS
        ),
    ],
)
def test_a_text_player_like_a_scripted_one_has_its_evaluation(opened_kitchen, name, settings):
    """A text player that plays like a scripted one has its evaluation to the last digit."""
    world = World(opened_kitchen, WordCraftConfig(part="test", num_distractors=3, **settings))
    player = PLAYERS[name](opened_kitchen)
    slots = picks_of(player, world, 2)
    expected = Evaluator(world, distractor_seeds=2)(player)

    def speaker(task, distractor_seed):
        actions = iter(slots[task, distractor_seed])
        return lambda _: f"{next(actions) + 1} + {next(actions) + 1}"

    played = play_all(TaskGames(world), 2, speaker)
    assert_same(evaluation_of(played, world.groups), expected)
    assert 0 < expected.success.mean() < 1 or name == "oracle"


def test_a_player_of_the_texts_alone_makes_every_goal(games, opened_kitchen):
    def answer(prompt):
        lines = dict(line.split(": ", 1) for line in prompt.splitlines() if ": " in line)
        table = {thing.split(" ", 1)[1] for thing in lines["Table"].split(", ")}
        recipes = opened_kitchen.graph.recipe_labels()
        return next(
            f"{a} + {b}" for a, b, result in recipes if result == lines["Goal"] and {a, b} <= table
        )

    played = play_all(games, 1, lambda task, distractor_seed: answer)
    assert all(one.success for one in played)
    assert played[0].messages[-1].endswith(f"You made the goal: {played[0].goal}.")


def test_an_invalid_message_costs_nothing_until_there_are_too_many(games):
    talk = Conversation(games.game(0))
    before = talk.game.state
    for _ in range(MAX_INVALID):
        reply = talk.hear("unicorn + dragon")
        assert reply.startswith("Invalid answer: unknown item 'unicorn': expected 1 to 5")
        assert reply.endswith(before)
    assert "This used up an attempt." in talk.hear("unicorn + dragon")
    assert (talk.invalid_actions, talk.lost_attempts) == (MAX_INVALID + 1, 1)
    assert (talk.is_over, talk.game.is_made) == (True, False)
    with pytest.raises(EpisodeError):
        talk.hear("1 2")


def test_a_game_that_is_given_up_takes_no_attempt_more(games):
    game = games.game(0)
    game.end()
    assert (game.is_over, game.state, game.is_made) == (True, "The game was ended early.", False)
    with pytest.raises(EpisodeError):
        game.combine(0, 1)


def test_the_open_ended_world_is_played_by_pairs_and_counts_known_entities(opened_kitchen):
    games = DiscoveryGames(opened_kitchen, attempts=4)
    base = len(games.discovery.base)
    talk, other = Conversation(games.game()), Conversation(games.game())
    pair = next(
        pair for pair in opened_kitchen.graph.outcomes if {*pair} <= {*games.discovery.base}
    )
    words = " with ".join(opened_kitchen.graph.labels(pair))
    assert " -> " in talk.hear(words)
    assert "nothing new (already tried)" in talk.hear(words)
    for _ in range(MAX_INVALID + 1):
        talk.hear("?")
    talk.hear("1 1")
    assert talk.is_over
    known = base + len(opened_kitchen.graph.outcomes[pair])
    played = record_of(talk)
    assert played.known_after[:3] == (known,) * 3
    assert (played.lost_attempts, len(other.game.labels)) == (1, base)
    curves = [(base, *played.known_after), (base,)]
    final = played.known_after[-1]
    assert mean_known(curves, 4) == {1: (known + base) / 2, 4: (final + base) / 2}


@pytest.mark.parametrize(
    ("distractors", "depth", "attempts", "part"),
    [
        (2, 1, 1, "train"),
        (8, 1, 1, "test"),
        (4, 2, 3, "train"),
        pytest.param(2, 1, 1, "test", marks=pytest.mark.slow),
        pytest.param(8, 1, 1, "train", marks=pytest.mark.slow),
        pytest.param(4, 2, 3, "test", marks=pytest.mark.slow),
    ],
)
def test_look_ups_reveal_no_way_to_the_goal_and_all_other_train_recipes(
    opened_kitchen, part, distractors, depth, attempts
):
    graph = opened_kitchen.graph
    is_train = opened_kitchen.split.is_in("train")
    world = World(
        opened_kitchen,
        WordCraftConfig(part, depth, num_distractors=distractors, max_attempts=attempts),
    )
    games, recipes = TaskGames(world), graph.recipe_labels()
    line_of = [f"{a} + {b} -> {result}" for a, b, result in recipes]
    for task in range(0, len(world.tasks), 30 * depth):
        game = games.game(task)
        table = {graph.id_of(label) for label in game.labels}
        facts = {
            fact for entity in range(graph.num_entities) for fact in known_recipes(game, entity)
        }
        told = {
            int(pair)
            for pair, line in zip(graph.pair_of_recipe, line_of, strict=True)
            if line in facts
        }
        assert not [
            way
            for way in world.search._ways(
                graph.id_of(game.goal),
                [frozenset(table), *[None] * attempts],
                attempts,
                frozenset(),
            )
            if way <= told
        ]
        solving = {recipes[row][:2] for plan in world.tasks.plans[task] for row in plan}
        others = [
            row
            for row, (*pair, result) in enumerate(recipes)
            if result != game.goal and (*pair,) not in solving
        ]
        hidden = [line_of[row] for row in others if is_train[row] and line_of[row] not in facts]
        assert all(line.split(" -> ")[0] + f" -> {game.goal}" in line_of for line in hidden)


def test_a_pair_that_solves_the_task_is_not_revealed_by_its_other_result():
    pairs = {
        "mud": ("water", "earth"),
        "plant": ("water", "earth"),
        "lava": ("fire", "earth"),
        "pot": ("fire", "mud"),
    }
    graph = RecipeGraph.from_recipes([(*pair, result) for result, pair in pairs.items()])
    opened = OpenedGraph(graph, make_split(graph, SplitConfig("none")), "")
    games = TaskGames(World(opened, WordCraftConfig(part="all", num_distractors=0)))
    facts = {}
    for task, one in enumerate(games.world.tasks):
        game = games.game(task)
        facts[one.goal] = {
            fact for entity in range(graph.num_entities) for fact in known_recipes(game, entity)
        }
    both = {"earth + water -> mud", "earth + water -> plant"}
    assert both.isdisjoint(facts["mud"] | facts["plant"])
    assert both < facts["lava"]


def test_a_look_up_costs_no_attempt_and_there_are_only_so_many(games):
    talk = Conversation(games.game(0), look_ups=2, max_invalid=1)
    unknown = (
        "Invalid answer: unknown item 'unicorn': expected an item name, or the start of a name."
    )
    assert (talk.hear("look up unicorn").startswith(unknown), talk.look_ups) == (True, 0)
    assert (
        "look up water. A look-up does not use up an attempt. You have 2 look-ups." in talk.opening
    )
    assert talk.hear("Look up: the Bread").startswith("Known recipes with bread:\n")
    talk.hear("look up bread")
    assert (talk.look_ups, talk.game.attempts_left, talk.invalid_actions) == (2, 1, 1)
    replies = [talk.hear("look up bread") for _ in range(2)]
    assert (all("You have no look-ups left" in reply for reply in replies), talk.is_over) == (
        True,
        True,
    )


def test_answers_with_names_make_all_goals_of_numbers():
    """A player that answers with names makes all goals of a book of numbers."""
    recipes = [
        (str(a), str(b), str(a + b)) for a in range(1, 12) for b in range(a, 12) if a + b < 19
    ]
    graph = RecipeGraph.from_recipes([row for row in recipes if int(row[0]) * int(row[1]) % 3 == 0])
    games = TaskGames(World.open(graph, WordCraftConfig(part="all", num_distractors=3)))
    ways = {}
    for one, other, result in graph.recipe_labels():
        ways.setdefault(result, []).append((one, other))
    made = []
    for task in range(len(games.world.tasks)):
        talk = Conversation(games.game(task))
        table = talk.game.labels
        pair = next(pair for pair in ways[talk.game.goal] if {*pair} <= {*table})
        talk.hear(" + ".join(pair))
        made.append(talk.game.is_made)
    assert len(made) > 20
    assert all(made)


def test_a_scorer_tells_its_best_links_and_never_what_it_remembers(games, opened_kitchen):
    scorer = FrequencyScorer(opened_kitchen.graph, opened_kitchen.split.partial)
    links = LikelyLinks(scorer, opened_kitchen.graph, games.world.tasks)
    game = games.game(0)
    entity = opened_kitchen.graph.id_of(game.labels[0])
    partners, parts_of, made_of = links(game, entity)
    assert partners.startswith("on this table, most likely combines with: ")
    assert all(label in partners for label in game.labels[1:])
    assert f" {game.labels[0]} (" not in partners
    best = scorer.top(None, "componentOf", entity)[0]
    assert made_of.startswith(f"most likely ingredients: {best[0]} (")
    assert parts_of.count("(") == 10
    talk = Conversation(game, look_ups=1, knowledge=links)
    assert talk.hear(f"look up {game.labels[0]}").startswith("Likely links of ")
    train = World(opened_kitchen, WordCraftConfig(part="train")).tasks
    with pytest.raises(LeakError):
        LikelyLinks(scorer, opened_kitchen.graph, train)


@pytest.mark.slow
def test_a_model_folder_answers_look_ups_on_its_own_split_alone(recipes_folder):
    asked = {"knowledge": "scorer", "scorer": recipes_folder, "look_ups": 1}
    for part in ("test", "train"):
        play = open_play("kitchen", part, 1, 3, **asked)
        talk = play.begin()
        talk.hear(f"look up {talk.game.labels[0]}")
        assert (talk.look_ups, play.settings.kg) == (1, "partial")
    with pytest.raises(GraphMismatchError):
        open_play("everyday", "test", 1, 3, **asked)


BOOK = "examples/kitchen-sets.csv"
TABLE = ("water", "earth", "fire", "egg", "salt and pepper", "2")


@pytest.fixture(scope="module")
def world():
    return World.open(BOOK, WordCraftConfig(part="test", num_distractors=2))


def ingredients(game):
    return game.tasks[game.task].plans[0][0].ingredients


@pytest.mark.parametrize(
    ("message", "places"),
    [
        ("water + earth + fire", (0, 1, 2)),
        ("I think of mud.\n\nAnswer: 1 + egg + egg + fire = cake", (0, 3, 3, 2)),
        ("combine Water, earth and the fire.", (0, 1, 2)),
        (r"\boxed{water + salt and pepper}", (0, 4)),
        ("salt and pepper", (4,)),
        ("<think>fire</think>eggs", (3,)),
        ('So:\n["water", "earth",\n"egg"]', (0, 1, 3)),
        ('{"items": ["water", "salt and pepper", 2]}', (0, 4, 5)),
        ('{"name": "combine", "arguments": {"items": ["egg", "egg", "fire"]}}', (3, 3, 2)),
        ('combine("water", "egg", "fire")', (0, 3, 2)),
        ('combine(items=["water", "egg", "fire"])', (0, 3, 2)),
        ("I combine **water** and **egg** and **salt and pepper** now.", (0, 3, 4)),
        ("1 4 3", (0, 3, 2)),
    ],
)
def test_an_answer_names_a_set(message, places):
    assert read_set(message, TABLE, 4) == places


@pytest.mark.parametrize(
    ("message", "says"),
    [
        ("", "0 items: expected 1 to 4"),
        ("water + earth + fire + egg + egg", "5 items: expected 1 to 4"),
        ("water + unicorn", "unknown item 'unicorn'"),
        ("water + + earth", "no answer"),
        ("1 " * 1000, "1,999 characters: expected 1 to 4 items"),
        ("I combine water, earth and unicorn now.", "unknown item 'unicorn now'"),
        ("I never combine **water** and **earth** today.", "unknown item"),
        ("combine(water, egg) or combine(fire, egg)", "2 different sets: expected one"),
    ],
)
def test_an_answer_that_names_no_set_is_refused(message, says):
    with pytest.raises(ActionError, match=says):
        read_set(message, TABLE, 4)


@pytest.mark.parametrize(
    ("message", "places"),
    [
        ("salt and pepper and oil", (0, 2)),
        ("oil, salt and pepper, pepper", (2, 0, 1)),
        ("salt and pepper + oil + C++ code", (0, 2, 3)),
        ("salt", (0,)),
    ],
)
def test_labels_that_hold_a_separator_are_read_whole(message, places):
    assert read_set(message, ("salt and pepper", "pepper", "oil", "C++ code"), 4) == places


def test_a_piece_of_a_list_is_no_beginning_of_a_label_with_a_separator():
    with pytest.raises(ActionError, match="only the beginning of 'salt and pepper'"):
        read_set("salt, pepper, oil", ("salt and pepper", "pepper", "oil"), 4)


def test_a_player_by_text_has_the_evaluation_of_a_player_by_slots(world):
    games = TaskGames(world)
    records = []
    for seed in range(2):
        for task in range(len(world.tasks)):
            talk = Conversation(games.game(task, seed))
            answer = " + ".join(ingredients(talk.game))
            # One task in three gets an answer that lacks an ingredient.
            talk.hear(answer if task % 3 else answer.partition(" + ")[2])
            records.append(record_of(talk))
    found = evaluation_of(records, world.groups)
    oracle = Evaluator(world, distractor_seeds=2)(recipe_oracle)
    is_right = [task % 3 > 0 for task in range(len(world.tasks))]
    assert found.success.all(axis=1).tolist() == is_right
    assert (found.actions[is_right] == oracle.actions[is_right]).all()
    assert oracle.success.all()


def test_every_interface_makes_a_goal_with_a_set(world):
    play = open_play(BOOK, "test", 1, 2, None)
    game = play.begin().game
    items = list(ingredients(game))
    assert "from one to 6 of them" in game.rules

    env = TextEnv(world)
    env.reset(seed=0, options={"task": 0, "distractor_seed": 0})
    _, reward, is_over, _, info = env.step(" + ".join(items))
    assert (reward, is_over, info["is_success"]) == (1, True, True)

    rows = crafting_rows(BOOK, part="test", depth=1, distractors=2)
    environment = SetCraftingEnvironment()
    environment.reset(**rows[0])
    assert "7 items: expected 1 to 6" in environment.combine(7 * items[:1])
    environment.combine(items)
    assert environment.get_reward() == 1

    pytest.importorskip("starlette")
    from wordcraft_kg.apps.text_agents.openenv_server import CraftingSession

    session = CraftingSession(GameList({"test": [play]}))
    session.reset({"index": 0})
    assert session.step({"items": items})["reward"] == 1


def test_look_ups_show_no_set_that_solves_the_task(world):
    games = TaskGames(world.variant(part="train"))
    for task in range(len(games.world.tasks)):
        game = games.game(task)
        assert hidden_pairs(game)
        recipe = game.tasks[game.task].plans[0][0]
        for label in recipe.ingredients:
            facts = known_recipes(game, world.graph.id_of(label))
            assert str(recipe) not in facts
