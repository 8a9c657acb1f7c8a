"""Kinds of players for the benchmark.

A kind plays all games of a track, and returns the decisions with facts about the player. Other
packages add kinds by the entry point group ``wordcraft_kg.bench_players``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from wordcraft_kg.agents.discovery import Discoverer, RandomDiscoverer, make_discoverers
from wordcraft_kg.apps.text_agents.benchmark import Track, open_track, read_manifest
from wordcraft_kg.apps.text_agents.games import Picks
from wordcraft_kg.apps.text_agents.results import (
    GAMES_FILE,
    GameRecord,
    GamesHeader,
    play_all,
    read_games,
)
from wordcraft_kg.apps.text_agents.settings import TIMEOUT, LookUps
from wordcraft_kg.apps.text_agents.submission import (
    LONGEST_NAME,
    LONGEST_TEXT,
    MOST_DOLLARS,
    MOST_TOKENS,
    Submission,
    acceptable,
    check_declared,
    read_submission_file,
    replay,
)
from wordcraft_kg.apps.text_agents.text_players import ChatServer, LinePlayer, TextPlayer
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    as_lines,
    check_file,
    number_in,
    sha256_of,
    whole,
)
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.draws import EVALUATION_SEED
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.discovery import open_guide
from wordcraft_kg.graphs import Ids, OpenedGraph, RecipeGraph, TaskSet, padded

if TYPE_CHECKING:
    from wordcraft_kg.agents.players import Player
    from wordcraft_kg.models.model import Model

# Submissions hold these texts, and verification compares bytes: a new wording needs a new scoring.
_TRAINED_ON = {
    "none": "no recipe of this book",
    "partial": "train recipes of this book",
    "full": "all recipes of this book, including the test tasks",
}
_SCRIPTED = {
    "random": ("random", "random"),
    "nearest-words": ("nearest words (glove)", "nearest-words"),
    "votes": ("partial KG, votes", ""),
    "graph": ("partial KG, u+v", ""),
    "oracle": ("recipe oracle", "greedy"),
    "planner": ("partial KG, planner", ""),
}
"""Names of scripted players, and of the discoverers that play open-ended games for them."""
_KNOWS = {
    "random": _TRAINED_ON["none"],
    "nearest-words": f"{_TRAINED_ON['none']}, words",
    "votes": _TRAINED_ON["partial"],
    "graph": _TRAINED_ON["partial"],
    "oracle": _TRAINED_ON["full"],
}
"""What scripted players declare as training data."""
_BEST_PAIR = ("w, best pair", "u+v, self edges dropped")
_OWN_LICENCE = "Apache-2.0"
_POLICY = "policy.safetensors"


@dataclass(frozen=True)
class RunSettings:
    """Settings for text players; other players need none of them.

    Attributes:
        messages: folder for a program's prompts and answers.
        look_ups: source of look-ups: none, or partial (the train recipes).
        timeout: seconds for an answer of a program.
        is_replacing: whether complete or other games in ``messages`` are played anew.
        base_url: address of a chat completions API; None for other players.
        parallel: games that a model behind an address plays at a time.
    """

    messages: Path
    look_ups: LookUps = "none"
    timeout: float = TIMEOUT
    is_replacing: bool = False
    base_url: str | None = None
    parallel: int = 1


@dataclass(frozen=True)
class Entrant:
    """A player's decisions in all games of a track, and facts for the submission.

    Attributes:
        name: name in tables.
        games: decisions by game, in the order of the track.
        training_data: data on which the player was trained, as its folder declares.
        licence: licence, as the player's folder declares.
        prompt_hash: hash of the prompts that were read; None for a player without text.
        weights: SHA-256 by file name; empty without weights.
        tokens: numbers of tokens by kind (input, output); None if not counted.
    """

    name: str
    games: Sequence[GameRecord]
    training_data: str = "not declared"
    licence: str = "not declared"
    prompt_hash: str | None = None
    weights: Mapping[str, str] = field(default_factory=dict)
    tokens: Mapping[str, int] | None = None

    def facts(self) -> dict[str, Any]:
        """Return the submission's fields about the player, as the player itself knows them."""
        prompts = "custom"
        if self.prompt_hash is None:
            prompts = "none"
        elif self.prompt_hash in read_manifest()[0].prompts.values():
            prompts = "standard"
        return {
            "player": acceptable(self.name, LONGEST_NAME),
            "weights": dict(self.weights),
            "prompts": prompts,
            "prompt_hash": self.prompt_hash,
            "training_data": acceptable(self.training_data),
            "tokens": None if self.tokens is None else dict(self.tokens),
            "price": None,
            "licence": acceptable(self.licence, LONGEST_NAME),
        }


@dataclass(frozen=True)
class Kind:
    """A kind of player.

    Attributes:
        about: description for `bench list`.
        argument: meaning of the argument in capitals, such as MODEL; empty without one.
        enter: function that plays, given the track, the argument and the settings.
    """

    about: str
    argument: str
    enter: Callable[[Track, str, RunSettings], Entrant]

    def usage(self, name: str) -> str:
        """Return how users name a player of this kind, such as ``scorer:MODEL``."""
        return f"{name}:{self.argument}" if self.argument else name


def decisions(track: Track, player: "Player") -> list[GameRecord]:
    """Return the decisions of a scripted player or policy in all tasks of a track.

    Raises:
        ConfigError: if the track is open-ended and has no tasks.
    """
    tables = padded([task.table for task in track.frozen.tasks], track.world.nothing)
    # The generator of agent evaluation: a player has the same chance there and here.
    rng = np.random.default_rng([EVALUATION_SEED, 0])
    pairs = decided_pairs(track.world, range(len(track)), tables, player, rng)
    return [GameRecord(pairs=tuple(game_pairs)) for game_pairs in pairs]


def decided_pairs(
    world: World, tasks: Sequence[int], tables: Ids, player: "Player", rng: np.random.Generator
) -> list[list[Picks | None]]:
    """Return the pairs that a scripted player or policy combines in N tasks, played together.

    Args:
        world: graph, tasks and settings.
        tasks: N task indices.
        tables: shape (N, W): ids on each starting table in slot order, padded with nothing.
        player: the player.
        rng: the player's generator.

    Returns:
        For each task the labels of the pairs in turn; None for a pair with an empty slot, which is
        a lost attempt.
    """
    engine = BatchEngine(world, len(tasks))
    state = engine.pose(np.array(tasks), tables=tables)
    pairs: list[list[Picks | None]] = [[] for _ in tasks]
    while (running := state.attempts_left > 0).any():
        slots = player(state, rng)
        before = state
        state, _ = engine.step_once(before, slots)
        # An attempt is over where the selection has gone; an empty slot loses it.
        is_attempt = running & before.has_selection() & ~state.has_selection()
        picks = before.picked(slots)
        is_lost = ~before.action_masks()[engine.rows, slots]
        for row in np.flatnonzero(is_attempt).tolist():
            ids = picks[row][picks[row] != engine.nothing]
            pairs[row].append(None if is_lost[row] else world.graph.labels(ids))
    return pairs


def discoveries(track: Track, player: Discoverer) -> list[GameRecord]:
    """Return the decisions of a player in all open-ended games of a track."""
    graph = track.opened.graph
    games = []
    for number, order in enumerate(track.frozen.orders):
        world = Discovery(graph)
        pairs: list[Picks | None] = []
        # A generator for each game: a change in one game leaves the others as they were.
        player.begin(order, np.random.default_rng([EVALUATION_SEED, number]))
        while len(pairs) < track.frozen.attempts and not world.is_complete:
            first, second = player.choose()
            new, _ = world.combine(first, second)
            player.observe((first, second), new)
            pairs.append((graph.entities[first], graph.entities[second]))
        games.append(GameRecord(pairs=tuple(pairs)))
    return games


def _scripted(track: Track, argument: str, settings: RunSettings, *, kind: str) -> Entrant:
    name, in_world = _SCRIPTED[kind]
    if track.is_open_ended and in_world:
        player: Discoverer = RandomDiscoverer()
        if kind != "random":
            (player,) = make_discoverers([in_world], track.opened.graph).values()
        return Entrant(name, discoveries(track, player), _KNOWS[kind], _OWN_LICENCE)
    name, chooser = named_player(kind, track.opened, track.world.tasks)
    return Entrant(name, decisions(track, chooser), _KNOWS[kind], _OWN_LICENCE)


def _words(track: Track, vectors: str, settings: RunSettings) -> Entrant:
    """Let the items with the nearest words play, with vectors as for ``--features``."""
    from wordcraft_kg.agents.players import nearest_words  # these load torch
    from wordcraft_kg.models.scorers.features import glove_features, make_features

    labels = track.world.graph.entities
    # Made-up words have no vector.
    features = glove_features(labels) if vectors == "glove" else make_features(vectors, labels)
    # Another name than that of `nearest-words`, which may have these vectors on another track.
    name = f"nearest words by {vectors}"
    chooser = nearest_words(features.unit_vectors)
    return Entrant(name, decisions(track, chooser), _KNOWS["nearest-words"], _OWN_LICENCE)


def _with_model(
    track: Track, folder: str, settings: RunSettings, names: Sequence[str] = ("planner",)
) -> Entrant:
    """Let a model play: the first of the scorer's players in ``names`` that the model has."""
    from wordcraft_kg.models.model_folder import open_model  # these load torch
    from wordcraft_kg.models.scorers.scorer_folder import WEIGHTS

    model = open_model(folder)
    graph = track.opened.graph
    name = Path(folder).name
    # A model of another book has seen none of these recipes, so its split does not matter.
    if model.opened.graph.hash == graph.hash:
        check_graph(folder, model.opened, track.opened)
    about: dict[str, Any] = {
        "training_data": _learned_from(model, track, model.kg),
        "weights": {WEIGHTS: model.run.outputs[WEIGHTS]},
    }
    if track.is_open_ended:
        learner = open_guide(folder, graph).learner()
        return Entrant(f"{name}, recipe-learner", discoveries(track, learner), **about)
    best, chooser = best_player(model, graph, names)
    return Entrant(f"{name}, {best}", decisions(track, chooser), **about)


def best_player(
    model: "Model", graph: RecipeGraph, names: Sequence[str], tasks: TaskSet | None = None
) -> tuple[str, "Player"]:
    """Return name and function of the first of a scorer's players in ``names`` that a model has.

    Args:
        model: the model.
        graph: the graph.
        names: names among :func:`~wordcraft_kg.agents.players.scorer_players`.
        tasks: tasks to play, if they are train tasks: a cross-fitted model then answers by its part
            that has not seen a task's recipes. None for other tasks.

    Raises:
        ConfigError: if it has none of them: then a planner was asked for.
        GraphMismatchError: if the model's scorer belongs to another graph.
    """
    from wordcraft_kg.agents.players import scorer_players  # loads torch

    players = scorer_players(graph, model.scorer, model.triples, tasks, plans=True)
    best = next((name for name in names if name in players), None)
    if best is None:
        raise ConfigError("this model cannot plan; expected a model of train-recipes.")
    return best, players[best]


def named_player(name: str, opened: OpenedGraph, tasks: TaskSet) -> tuple[str, "Player"]:
    """Return a player of train tasks by its name.

    Args:
        name: ``random``, ``nearest-words``, ``votes``, ``graph``, ``oracle``, ``planner`` (by the
            train recipes), ``planner:MODEL``, ``scorer:MODEL`` or ``agent:RUN``.
        opened: the graph and its split.
        tasks: train tasks to begin with; a model's player follows to other tasks of the part.

    Returns:
        The player's name in tables, and the player. A cross-fitted model plays a task by its part
        that has not seen the task's recipes, as in training.

    Raises:
        ConfigError: for an unknown name, a missing or needless argument, or a player of pairs on a
            book with recipes of other sizes.
        GraphMismatchError: for a model or an agent of another graph or split.
    """
    from wordcraft_kg.agents.players import knowledge_players, words_player  # these load torch

    kind, colon, folder = name.partition(":")
    if not colon and kind == "nearest-words":
        ((title, player),) = words_player(opened.graph).items()
        return title, player
    if not colon and kind in _SCRIPTED:
        players = knowledge_players(opened.split)
        title, _ = _SCRIPTED[kind]
        if title not in players:
            raise ConfigError(
                f"`player` '{kind}': expected a book of pairs, but {opened.graph.name} has recipes "
                "of other sizes. Choose random, nearest-words, graph or oracle."
            )
        return title, players[title]
    if not folder or kind not in ("agent", "planner", "scorer"):
        raise ConfigError(
            f"`player` '{name[:100]}': expected one of {', '.join(_SCRIPTED)}, planner:MODEL, "
            "scorer:MODEL, agent:RUN."
        )
    if kind == "agent":
        from wordcraft_kg.agents.agent_folder import open_agent
        from wordcraft_kg.agents.evaluation import PolicyPlayer

        agent = open_agent(folder)
        check_graph(folder, agent.opened, opened)
        return agent.name, PolicyPlayer(agent.policy)
    from wordcraft_kg.models.model_folder import open_model

    model = open_model(folder)
    check_graph(folder, model.opened, opened)
    names = ("planner",) if kind == "planner" else _BEST_PAIR
    best, player = best_player(model, opened.graph, names, tasks)
    return f"{Path(folder).name}, {best}", player


def check_graph(folder: str, model_graph: OpenedGraph, opened: OpenedGraph) -> None:
    """Check that a model's folder is of a graph and split.

    Args:
        folder: the model's folder, for the error.
        model_graph: graph and split of the model.
        opened: the expected graph and split.

    Raises:
        GraphMismatchError: if they differ.
    """
    hashes = (model_graph.graph.hash, model_graph.split.hash)
    expected = (opened.graph.hash, opened.split.hash)
    if hashes != expected:
        raise GraphMismatchError(
            f"'{folder}' was trained on graph {hashes[0][:12]} and split {hashes[1][:12]}; "
            f"expected {expected[0][:12]} and {expected[1][:12]}, a split of {opened.graph.name}. "
            "Train on this graph and split, or choose another folder."
        )


def _learned_from(model: "Model", track: Track, kg: str) -> str:
    """Return what a model was trained on, as its folder records it.

    Args:
        model: the model.
        track: the track; a model of its book is described by the part of the recipes that it knows.
        kg: which recipes of the track's book the player knows: none, partial or full.

    Returns:
        Training recipes, word vectors and outside knowledge, separated by commas.
    """
    book = model.opened.graph
    if book.hash == track.opened.graph.hash:
        sources = [_TRAINED_ON[kg]]
    else:
        sources = [f"recipes of {book.name}"]
    words = getattr(model.metrics, "features", "")
    if words not in ("", "one-hot"):
        sources.append(f"{Path(words).name} words")
    if outside := model.history.facts.get("outside knowledge"):
        sources.append(f"outside knowledge: {outside}")
    return ", ".join(sources)


def _agent(track: Track, argument: str, settings: RunSettings) -> Entrant:
    from wordcraft_kg.agents.agent_folder import open_agent  # these load torch
    from wordcraft_kg.agents.evaluation import PolicyPlayer
    from wordcraft_kg.models.model_folder import open_model
    from wordcraft_kg.models.scorers.scorer_folder import WEIGHTS
    from wordcraft_kg.runs.record import check_done

    agent = open_agent(argument)
    check_graph(argument, agent.opened, track.opened)
    check_done(Path(argument), agent.run)
    weights = {_POLICY: agent.run.outputs[_POLICY]}
    # Even an agent without a knowledge graph has met the train recipes: its tasks are made of them.
    kg = "full" if agent.run.kg == "full" else "partial"
    knows = _TRAINED_ON[kg]
    if agent.config.scorer is not None:
        model = open_model(agent.config.scorer)
        # The folder may hold another scorer by now; the declaration is for the one that was used.
        if model.run.outputs[WEIGHTS] != agent.run.inputs["scorer"]:
            raise ArtefactError(
                f"'{agent.config.scorer}' is not the scorer of '{argument}'. Restore a copy."
            )
        knows = _learned_from(model, track, kg)
    features = agent.config.policy.features
    words = f", {Path(features).name} words"
    # The other kinds of features come from no words, or are in the scorer's list already.
    if features not in ("one-hot", "random") and words not in knows:
        knows += words
    return Entrant(agent.name, decisions(track, PolicyPlayer(agent.policy)), knows, weights=weights)


def _program(track: Track, argument: str, settings: RunSettings) -> Entrant:
    with LinePlayer(argument, timeout=settings.timeout) as program:
        return _played(track, settings, program)


def _openai(track: Track, argument: str, settings: RunSettings) -> Entrant:
    # No address is none of HTTP either: the server refuses it.
    server = ChatServer(argument, settings.base_url or "", settings.timeout)
    parallel = whole("parallel", settings.parallel, 1, 256)
    return _played(track, settings, server, parallel)


def _played(track: Track, settings: RunSettings, player: TextPlayer, parallel: int = 1) -> Entrant:
    """Let a player by text play all games of a track, ``parallel`` of them at a time."""
    play = track.play(settings.look_ups)
    played = play_all(
        player,
        play,
        settings.messages,
        parallel=parallel,
        is_replacing=settings.is_replacing,
    )
    return _recorded(
        track, settings, GamesHeader(player=player.name, settings=play.settings), played
    )


def _inspect(track: Track, argument: str, settings: RunSettings) -> Entrant:
    from wordcraft_kg.apps.text_agents.inspect_tasks import read_inspect_log  # loads Inspect AI

    header, played, tokens = read_inspect_log(argument)
    return replace(_recorded(track, settings, header, played), tokens=tokens)


def _games(track: Track, argument: str, settings: RunSettings) -> Entrant:
    header, played, _ = read_games(Path(argument))
    return _recorded(track, settings, header, played)


def _recorded(
    track: Track, run: RunSettings, header: GamesHeader, played: Sequence[GameRecord]
) -> Entrant:
    """Return the decisions in recorded games, in the order of the track.

    Of a task that was played several times, the first game counts.

    Args:
        track: the track that was played.
        run: the settings of this command.
        header: the player's name, and the recorded settings.
        played: the recorded games in any order, some perhaps several times.

    Raises:
        ConfigError: for games of another track, with other look-ups, or if a game is missing:
            a selection of games is no result for the track.
    """
    settings = header.settings
    if settings.track != track.full_name:
        raise ConfigError(
            f"the games of '{header.player}' are of {settings.track or 'no track'}; expected "
            f"{track.full_name}. Play the track "
            f"with `inspect eval wordcraft_kg/crafting -T track={track.name}` or `mcp --track "
            f"{track.name}`."
        )
    if settings.knowledge != run.look_ups:
        raise ConfigError(
            f"`look_ups` {run.look_ups}: the games have {settings.knowledge}; give the same."
        )
    games: dict[int, GameRecord] = {}
    for game in played:
        # The first game of a task stays, so that nobody plays again until the result is good.
        games.setdefault(game.distractor_seed if track.is_open_ended else game.task, game)
    if missing := set(range(len(track))) - games.keys():
        raise ConfigError(
            f"{len(track) - len(missing)} of {len(track)} games of {track.name} were played; play "
            f"game {min(missing)}."
        )
    records = [games[number] for number in range(len(track))]
    return Entrant(header.player, records, prompt_hash=settings.prompt_hash)


KINDS: Registry[Kind] = Registry(
    "wordcraft_kg.bench_players",
    {
        "random": Kind("chance", "", partial(_scripted, kind="random")),
        "nearest-words": Kind(
            "the items with the words nearest to the goal, by the best built-in vectors",
            "",
            partial(_scripted, kind="nearest-words"),
        ),
        "words": Kind("the same by other vectors, such as words:glove", "VECTORS", _words),
        "votes": Kind("votes of the train recipes on pairs", "", partial(_scripted, kind="votes")),
        "graph": Kind(
            "links of the train recipes, without learning", "", partial(_scripted, kind="graph")
        ),
        "oracle": Kind("knows all recipes", "", partial(_scripted, kind="oracle")),
        "scorer": Kind(
            "the best pair by a model's scores", "MODEL", partial(_with_model, names=_BEST_PAIR)
        ),
        "planner": Kind("the first pair of a model's best plan", "MODEL", _with_model),
        "agent": Kind("a trained agent", "RUN", _agent),
        "program": Kind("a program that plays by the line protocol", "COMMAND", _program),
        "openai": Kind("a model behind a chat completions API, at --base-url", "MODEL", _openai),
        "inspect": Kind("a language model in Inspect AI, by its log", "LOG", _inspect),
        "mcp": Kind("MCP clients, by the games of `mcp --track`", "GAMES", _games),
        "openenv": Kind(
            "OpenEnv clients, by the games of `serve openenv --track`", "GAMES", _games
        ),
    },
)
"""Kinds of players by name."""


def enter(
    track: Track, player: str, settings: RunSettings, weights: Path | None = None
) -> tuple[str, Entrant]:
    """Let a player play all games of a track.

    Args:
        track: the track.
        player: ``KIND`` or ``KIND:ARGUMENT``, see :data:`KINDS`.
        settings: settings for text players.
        weights: file with a text player's weights, for the hash; None without weights.

    Returns:
        The name of the kind, and the player's decisions.

    Raises:
        ConfigError: for an unknown kind, a missing or needless argument, settings for text players
            with another player, or recorded games of other settings.
        ArtefactError: if a model, a run or a record of games is missing or damaged.
        GraphMismatchError: if a model or a run is of another split.
        PlayerError: if a program does not start, ends early or does not answer in time.
    """
    name, _, argument = player.partition(":")
    if name not in KINDS:
        raise ConfigError(f"`player` '{name[:100]}': expected one of {', '.join(KINDS)}.")
    kind = KINDS[name]
    if bool(argument) != bool(kind.argument):
        raise ConfigError(f"`player` '{player[:100]}': expected {kind.usage(name)}.")
    if name not in TEXT_PLAYERS and (settings.look_ups != "none" or weights):
        raise ConfigError(
            f"`look_ups` or `weights`: expected a player by text ({', '.join(TEXT_PLAYERS)}), but "
            f"got {name}."
        )
    if not weights:
        return name, kind.enter(track, argument, settings)
    check_file(weights)
    hashes = {weights.name: sha256_of(weights)}
    return name, replace(kind.enter(track, argument, settings), weights=hashes)


def declarations(
    name: str | None,
    training_data: str | None,
    licence: str | None,
    tokens: tuple[int, int] | None,
    price: float | None,
    weights: Path | None,
) -> dict[str, Any]:
    """Return the fields of a submission that a user declares, by their names there.

    Args:
        name: name in tables; None as for all others if it is not declared.
        training_data: data on which the player was trained.
        licence: licence of the player or its weights.
        tokens: numbers of input and output tokens.
        price: price of the evaluation in US dollars.
        weights: file with the player's weights, whose name becomes part of the submission.

    Raises:
        ConfigError: for a text or a number that a submission may not hold.
    """
    for option, text, limit in (
        ("name", name, LONGEST_NAME),
        ("training_data", training_data, LONGEST_TEXT),
        ("licence", licence, LONGEST_NAME),
        ("weights", None if weights is None else weights.name, LONGEST_TEXT),
    ):
        if text is not None:
            check_declared(option, text, limit)
    for number in tokens or ():
        expected = f"two numbers of tokens, 0 to {MOST_TOKENS:,}"
        number_in("tokens", number, 0, MOST_TOKENS, expected)
    if price is not None:
        number_in("price", price, 0, MOST_DOLLARS, f"US dollars, 0 to {MOST_DOLLARS:,}")
    fields = {
        "player": name,
        "training_data": training_data,
        "licence": licence,
        "tokens": None if tokens is None else dict(zip(("input", "output"), tokens, strict=True)),
        "price": price,
    }
    return {key: value for key, value in fields.items() if value is not None}


def reproduce(
    folder: Path,
    submission: Submission,
    player: str,
    timeout: float = TIMEOUT,
    weights: Path | None = None,
) -> None:
    """Let a submission's player play again, and compare all games with the submission.

    Args:
        folder: folder or archive of the submission.
        submission: the submission, already verified.
        player: the player, as for :func:`enter`.
        timeout: seconds for an answer of a program.
        weights: file with a text player's weights; None without weights.

    Raises:
        ArtefactError: if a game or a declared fact differs.
        ConfigError: for a record of games, which cannot play.
        PlayerError: if a program does not start, ends early or does not answer in time.
    """
    records = [name for name in TEXT_PLAYERS if name != "program"]
    if player.partition(":")[0] in records:
        raise ConfigError(
            "expected a player that plays here; a record of games "
            f"({', '.join(records)}) cannot play."
        )
    track = open_track(submission.track)
    with TemporaryDirectory() as messages:
        kind, entrant = enter(
            track, player, RunSettings(Path(messages), submission.knowledge, timeout), weights
        )
    path = folder / GAMES_FILE
    play = track.play(submission.knowledge)
    facts = {"kind": kind, **entrant.facts()}
    # Only facts that the player itself knows are compared; users may declare the others.
    names = ["kind", "weights"]
    if entrant.training_data != Entrant.training_data:
        names.append("training_data")
    # A player of this package has nothing to declare: another name or licence would be a claim.
    if not KINDS[kind].argument:
        names += ["player", "licence", "tokens", "price"]
    if entrant.prompt_hash is None or submission.prompts != "custom":
        names.append("prompt_hash")
    for name in names:
        if (declared := getattr(submission, name)) != facts[name]:
            raise ArtefactError(
                f"{folder}: '{name}' is {declared}, but the given player has {facts[name]}. Play "
                "as before."
            )
    # `verify` has checked the file: a line for each game, in the canonical form.
    lines = read_submission_file(folder, GAMES_FILE).splitlines(keepends=True)
    for number, (line, played) in enumerate(zip(lines, entrant.games, strict=True)):
        if [line.decode()] != as_lines([replay(play, number, played)]):
            raise ArtefactError(
                f"{path}, line {number + 1}: the given player plays another game here."
            )


TEXT_PLAYERS = ("program", "openai", "inspect", "mcp", "openenv")
"""Kinds that read prompts."""
