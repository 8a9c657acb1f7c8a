"""Scripted players (chance, symbolic knowledge graphs, scorers, an oracle) and their success rates.

A player is a function ``(state, rng) -> slots``: from a batched state and a random generator to the
chosen slot in each environment, shape (N,).

If recipes have other sizes than two, the last slot is the action to combine. Players without
knowledge of recipes combine as many entities as most train recipes have. A player of scores
combines once no entity on the table has a score above 0, the mean of all, and picks none twice,
unless a source scores the action to combine.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.agents.states import ROWS, bind_tasks, states_of
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.envs.batch import State
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, Ids, RecipeGraph, Split, TaskSet
from wordcraft_kg.models.policies.sources import with_letters
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.policies.sources.source import ScoreView
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import SymbolicScorer, VoteScorer
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.features import glove_features, make_features, named
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.score_limits import SelfEdges, has_table
from wordcraft_kg.models.scorers.sets.scorer import SetScorer
from wordcraft_kg.planning.source import BestPlan

Player = Callable[[State, np.random.Generator], Ids]
SlotScores = Callable[[States], Tensor]
"""A function that scores the slots of states: shape (B, A), for example a source."""
RecipeFunction = Callable[[Tensor, Tensor, Tensor], Tensor]
"""A function that scores recipes ``a + b -> c``, for tensors of ids a, b and c that broadcast."""
NEAREST_WORDS = "nearest words"
"""Name of the player :func:`nearest_words`, before the name of its vectors in brackets."""
FEWEST_USES = "fewest uses"
"""Name of the player :func:`fewest_uses`."""
BEST_PAIR = "w, best pair"
"""Name of the player of the pair with the highest recipe score, among :func:`scorer_players`."""
PLANNER = "planner"
"""Name of the player by plans, among :func:`scorer_players`."""
BEST_IN_TABLE = "t, best pair"
"""Name of the player of the pair with the highest score in a table, in :func:`scorer_players`."""
BEST_SET = "best set"
"""Name of the player of the set with the highest score, among :func:`scorer_players`."""
RANDOM = "random"
"""Name of the player :func:`random_entity`."""
ORACLE = "recipe oracle"
"""Name of the player :func:`recipe_oracle`."""
PLAYERS: Registry[Callable[[Split], Player]] = Registry(
    "wordcraft_kg.players", reserved=(RANDOM, FEWEST_USES, PLANNER, BEST_SET, ORACLE)
)
"""Player constructors that plugins and other packages register, by name."""
CELLS = 200_000
"""Maximum number of slot pairs to score at once: a state with A slots has A² pairs."""


def random_entity(state: State, rng: np.random.Generator) -> Ids:
    """Choose uniformly among the slots with an entity."""
    return np.asarray(state.random_actions(rng.random(state.num_envs)))


def random_distinct(state: State, rng: np.random.Generator) -> Ids:
    """Choose uniformly among the slots, without repeating the selected entity if possible."""
    # Without another entity, repeat the selection.
    return _best(state, np.where(_is_selected(state), 0.0, 1.0), rng)


def recipe_oracle(state: State, rng: np.random.Generator) -> Ids:
    """Choose the ingredients in the task's first plan, recipe by recipe."""
    world = state.world
    slots = np.zeros(state.num_envs, dtype=np.int64)
    for i in range(state.num_envs):
        if not state.attempts_left[i]:
            continue
        table = state.table[i].tolist()
        # The next recipe of the plan is the first whose result is not on the table; after the last
        # one, for an episode that goes on, the last is repeated.
        plan = [world.search.rows[row] for row in world.tasks.plans[state.task[i]][0]]
        missing_recipes = (recipe for recipe in plan if recipe[-1] not in table)
        *targets, _ = next(missing_recipes, plan[-1])
        for pick in np.atleast_1d(state.selection[i]).tolist():
            if pick in targets:
                targets.remove(pick)
        targets = [target for target in targets if target != world.nothing]
        # Only a larger set is complete before it is combined.
        slots[i] = table.index(targets[0]) if targets else world.num_slots - 1
    return slots


def knowledge_player(sources: Sequence[SlotScores]) -> Player:
    """Return a player of the slot with the highest summed score, as in Jiang et al. 2020.

    Ties are broken at random. The player raises LeakError if a source would score a task by a model
    trained on the task's recipes, and GraphMismatchError if the tasks belong to another graph or
    split than a cross-fitted scorer.
    """
    has_combine_score = any(getattr(source, "scores_combine", False) for source in sources)

    def choose(state: State, rng: np.random.Generator) -> Ids:
        bind_tasks(sources, state.world)
        inputs = states_of(state)
        scores = np.zeros(state.table.shape)
        for start in range(0, state.num_envs, ROWS):
            end = start + ROWS
            rows = inputs.rows(start, end)
            for source in sources:
                scores[start:end] += source(rows).numpy()
        if state.world.has_combine and not has_combine_score:
            # None twice, and of equal scores to combine comes first.
            scores[_is_selected(state)] = -np.inf
            scores[:, -1] = np.finfo(float).tiny
        return _best(state, scores, rng)

    return choose


def pair_player(score_recipes: RecipeFunction) -> Player:
    """Return a player of the pair with the highest recipe score for the goal.

    Ties favour different entities, and are then broken at random.
    """

    def of_pairs(a: Tensor, b: Tensor, goal: Tensor, nothing: int) -> Tensor:
        """Return pair scores by broadcasting, float64.

        Args:
            a: id of the first entity; may be empty slots, whose scores are not used.
            b: id of the second entity.
            goal: id of the goal.
            nothing: id of an empty slot, one above the last entity.

        Returns:
            The scores, -inf where ``b`` is an empty slot.
        """
        # Empty slots get a valid id for the scorer, and their scores are replaced below.
        last = nothing - 1
        first = a.clamp(max=last)
        second = b.clamp(max=last)
        # float64, because in float32 so small a difference vanishes beside a score of 100.
        scores = score_recipes(first, second, goal).double()
        scores = scores - 1e-6 * (a == b)
        return scores.masked_fill(b == nothing, -torch.inf)

    def choose(state: State, rng: np.random.Generator) -> Ids:
        goal, selection, table, *_ = states_of(state)
        nothing = state.nothing
        # Second entity of an attempt: the selection with each slot.
        scores = of_pairs(selection[:, None], table, goal[:, None], nothing)
        # First entity of an attempt: nothing is selected, and all pairs of slots are scored.
        begins = torch.nonzero(selection == nothing).flatten()
        # In a large book, most slots may be empty, reserved for results.
        slots = torch.nonzero((table[begins] != nothing).any(0)).flatten()
        # Without slots there is no state to score, and no block to divide by.
        if len(slots):
            at_once = max(1, CELLS // len(slots) ** 2)
            for rows in begins.split(at_once):
                filled = table[rows][:, slots]
                # Shape (B, A, A): each slot as the first entity against each as the second.
                left_ids = filled[:, :, None]
                right_ids = filled[:, None, :]
                pairs = of_pairs(left_ids, right_ids, goal[rows, None, None], nothing)
                # The first entity of an attempt is worth what its best partner makes of it.
                scores[rows[:, None], slots] = pairs.amax(dim=2)
        return _best(state, scores.numpy(), rng)

    return choose


def words_player(graph: RecipeGraph, knowledge: RecipeKnowledge | None = None) -> dict[str, Player]:
    """Return the player by nearest words that is fair beside a scorer, by a name with its vectors.

    Args:
        graph: the recipe graph.
        knowledge: the recipe scorer beside it, whose word vectors the player has; None, or a scorer
            without words, for the best vectors that are built in for the labels.
    """
    name = named("auto", graph.entities)
    unit = _unit_vectors(name, graph)
    if knowledge is not None and knowledge.vectors.shape[1]:
        scorer_vectors = knowledge.vectors[: graph.num_entities].float().cpu().numpy()
        if not _are_equal(scorer_vectors, unit):
            is_glove = _are_equal(scorer_vectors, _unit_vectors("glove", graph))
            name = "glove" if is_glove else "the scorer's vectors"
        unit = scorer_vectors
    return {f"{NEAREST_WORDS} ({name})": nearest_words(unit)}


def knowledge_of(scorer: TripleScorer | None) -> RecipeKnowledge | None:
    """Return the knowledge of a recipe scorer on all train recipes; None for any other scorer."""
    main_model = None if scorer is None else whole_of(scorer)
    return main_model.knowledge if isinstance(main_model, RecipeScorer) else None


def _unit_vectors(name: str, graph: RecipeGraph) -> NDArray[np.float32]:
    """Return built-in vectors; without words, such as of a book of made-up words, all are 0."""
    if name == "glove":
        return glove_features(graph.entities).unit_vectors
    return make_features(name, graph.entities).unit_vectors


def _are_equal(rounded: NDArray[np.float32], unit: NDArray[np.float32]) -> bool:
    """Return whether unit vectors, shape (E, D), are these as a scorer stores them."""
    return rounded.shape == unit.shape and np.array_equal(
        rounded, unit.astype(np.float16).astype(np.float32)
    )


def nearest_words(vectors: NDArray[np.float32]) -> Player:
    """Return a player of the two labels nearest to the goal's label by cosine; it knows no recipe.

    Args:
        vectors: shape (E, D), unit vectors of the labels.
    """
    # The last row is for empty slots.
    unit = np.pad(vectors, ((0, 1), (0, 0)))

    def choose(state: State, rng: np.random.Generator) -> Ids:
        # Cosines differ by at most 2, so the selection is repeated only if alone on the table.
        cosines = np.einsum("nd,nsd->ns", unit[state.goal], unit[state.table])
        return _best_of_usual_size(state, cosines - 3.0 * _is_selected(state), rng)

    return choose


def fewest_uses(split: Split) -> Player:
    """Return a player of the two entities with the fewest train recipes as an ingredient.

    Ties are broken at random. The player knows neither goal nor meaning. Distractors are drawn by
    train uses, a task's ingredients are not, so rare entities on a table are more often ingredients
    than distractors. A method must beat this shortcut, too.
    """
    uses = np.append(split.train_uses, 0)  # the last is for empty slots, which are never chosen

    def choose(state: State, rng: np.random.Generator) -> Ids:
        # Any other entity comes before the selection, which is repeated only if alone on the table.
        rarity = -uses[state.table].astype(float)
        scores = np.where(_is_selected(state), -1.0 - uses.max(), rarity)
        return _best_of_usual_size(state, scores, rng)

    return choose


def scorer_alone(sources: Mapping[str, SlotScores]) -> dict[str, Player]:
    """Return players that follow an agent's score sources without learned weights.

    All sources are summed; w alone and p alone follow, if the agent has them, in this order. The
    keys name the sources for people, such as ``combines (u), component (v)``.
    """
    players = {}
    if sources:
        players[with_letters(sources)] = knowledge_player(list(sources.values()))
    for name in ("w", "p"):
        if name in sources:
            players[with_letters([name])] = knowledge_player([sources[name]])
    return players


def fact_sources(graph: RecipeGraph, triples: Ids) -> dict[str, SlotScores]:
    """Return the sources u and v for known triples, shape (T, 3).

    A score is 1 for a known triple, else 0.
    """
    facts = SymbolicScorer(graph, triples)
    nothing = graph.num_entities

    def linked(relation: int, key: Tensor, table: Tensor) -> Tensor:
        scores = torch.zeros(table.shape)
        keys = key[:, None].expand_as(table)
        # Without a selection, u knows nothing: all slots have score 0.
        has_both = (table != nothing) & (keys != nothing)
        scores[has_both] = facts.score(table[has_both], relation, keys[has_both])
        return scores

    return {
        "u": lambda states: states.mean_over_selection(
            lambda selected: linked(COMBINES_WITH, selected, states.table), nothing
        ),
        "v": lambda states: linked(COMPONENT_OF, states.goal, states.table),
    }


def fact_recipes(graph: RecipeGraph, triples: Ids) -> RecipeFunction:
    """Return a function that scores recipes ``a + b -> c`` by known triples.

    The score is the number of known triples between a, b and c, 0 to 3.

    Args:
        graph: names the entities.
        triples: known triples, ids of head, relation and tail, shape (T, 3).

    Returns:
        The function, which raises UnknownEntityError for an id out of range, also for that of an
        empty slot.
    """
    facts = SymbolicScorer(graph, triples)

    def score(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
        return (
            facts.score(a, COMBINES_WITH, b)
            + facts.score(a, COMPONENT_OF, c)
            + facts.score(b, COMPONENT_OF, c)
        )

    return score


def knowledge_players(split: Split, knowledge: RecipeKnowledge | None = None) -> dict[str, Player]:
    """Return scripted players by name.

    They are chance, shortcuts without a graph, triples as facts, votes, the players in
    :data:`PLAYERS`, and an oracle, which comes last.

    Args:
        split: the split.
        knowledge: the recipe scorer beside them, see :func:`words_player`; None without one.
    """
    graph = split.graph
    train_sources = fact_sources(graph, split.partial)
    everything = fact_sources(graph, graph.triples)
    heads, relations, tails = graph.triples.T
    is_self_pair = (relations == COMBINES_WITH) & (heads == tails)
    no_self = fact_sources(graph, graph.triples[~is_self_pair])
    # Players of pairs: votes, plans and the pair with the most known triples.
    pairs_by_train: dict[str, Player] = {}
    best_pair: dict[str, Player] = {}
    if graph.has_pairs_only:
        train = split.recipes("train")
        plans = BestPlan.of_recipes(graph.num_entities, train)
        pairs_by_train = {
            "partial KG, votes": pair_player(VoteScorer(graph, train).score_recipes),
            "partial KG, planner": knowledge_player([plans]),
        }
        best_pair = {"full KG, best pair": pair_player(fact_recipes(graph, graph.triples))}
    return {
        RANDOM: random_entity,
        "random, distinct": random_distinct,
        FEWEST_USES: fewest_uses(split),
        **words_player(graph, knowledge),
        "partial KG, v": knowledge_player([train_sources["v"]]),
        "partial KG, u+v": knowledge_player([train_sources["u"], train_sources["v"]]),
        **pairs_by_train,
        "full KG, v": knowledge_player([everything["v"]]),
        "full KG, u": knowledge_player([everything["u"]]),
        "full KG, u+v": knowledge_player([everything["u"], everything["v"]]),
        "full KG, u+v, no self edges": knowledge_player([no_self["u"], no_self["v"]]),
        **best_pair,
        **{name: make(split) for name, make in PLAYERS.items()},
        ORACLE: recipe_oracle,
    }


def scorer_players(
    graph: RecipeGraph,
    scorer: TripleScorer,
    observed: Ids,
    tasks: TaskSet | None = None,
    *,
    plans: bool = False,
) -> dict[str, Player]:
    """Return players that act by a scorer's standardised scores, by name.

    The source u scores a slot with the selection, v with the goal; self edges are scores for an
    entity with itself. There are v, u, and u + v with three settings for self edges. Recipe scorers
    add :data:`BEST_PAIR`, the pair with the highest recipe score, and scorers of sets
    :data:`BEST_SET`.

    Args:
        graph: the graph.
        scorer: a scorer of the graph.
        observed: the scorer's training triples, shape (T, 3).
        tasks: the tasks to play, if they are train tasks: a cross-fitted scorer then answers by the
            model that has not seen a task's recipes. None for other tasks.
        plans: add :data:`PLANNER`, the first pair of the most probable plan, if the scorer can
            plan.

    Returns:
        The players.

    Raises:
        GraphMismatchError: if the scorer belongs to another graph.
        ConfigError: if the graph is too large for score tables, and the scorer needs them.
        LeakError: if a model has seen all recipes of a task's plan.
    """
    check_scorer(scorer, graph)

    def of(*names: str, self_edges: SelfEdges = "keep") -> Player:
        view = ScoreView("standardise", self_edges, observed)
        return knowledge_player(make_sources(names, scorer, view, tasks=tasks))

    players: dict[str, Player] = {}
    # A scorer of sets needs tables for links, which a large graph has no room for.
    if not isinstance(whole_of(scorer), SetScorer) or has_table(graph.num_entities):
        players = {
            "v": of("v"),
            "u": of("u"),
            "u+v, self edges kept": of("u", "v"),
            "u+v, self edges observed": of("u", "v", self_edges="observed"),
            "u+v, self edges dropped": of("u", "v", self_edges="drop"),
        }
    sources = {BEST_PAIR if graph.has_pairs_only else BEST_SET: "w"}
    if graph.has_pairs_only:
        sources[BEST_IN_TABLE] = "t"
    if plans:
        sources[PLANNER] = "p"
    for name, source in sources.items():
        # Without the players of sources that the scorer cannot serve.
        with suppress(ConfigError):
            players[name] = of(source)
    return players


def _best(state: State, scores: NDArray[np.float64], rng: np.random.Generator) -> Ids:
    """Return a slot with the highest score among the slots with an entity, for each state."""
    masked_scores = np.where(state.action_masks(), scores, -np.inf)
    is_best = masked_scores == masked_scores.max(axis=1, keepdims=True)
    # Ties at random: the first slot would favour starting ingredients or distractors by position.
    order = np.where(is_best, rng.random(scores.shape), -1.0)
    return np.asarray(order.argmax(axis=1))


def _best_of_usual_size(state: State, scores: NDArray[np.float64], rng: np.random.Generator) -> Ids:
    """Return a best slot as :func:`_best`, or combine as many as most train recipes have."""
    world = state.world
    if world.has_combine:
        train_sizes = world.graph.sizes[world.split.is_in("train")]
        usual_size = np.bincount(train_sizes).argmax()
        num_selected = (state.selection != state.nothing).sum(axis=1)
        scores[:, -1] = np.where(num_selected >= usual_size, np.inf, -np.inf)
    return _best(state, scores, rng)


def _is_selected(state: State) -> NDArray[np.bool_]:
    """Return which slots hold a selected entity, shape (N, A); in empty slots it means nothing."""
    selected_ids = state.selection.reshape(state.num_envs, 1, -1)
    is_selected = (state.table[:, :, None] == selected_ids).any(axis=2)
    if state.world.has_combine:
        is_selected[:, -1] = False
    return np.asarray(is_selected)
