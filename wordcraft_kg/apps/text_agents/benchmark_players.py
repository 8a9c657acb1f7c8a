"""Kinds of players for the benchmark; other packages add kinds by the entry point group ``wordcraft_kg.bench_players``.

A kind plays all games of a track, and returns the decisions with facts about the player.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from wordcraft_kg.agents.discovery import Discoverer, make_discoverers
from wordcraft_kg.apps.text_agents.benchmark import Track, open_track
from wordcraft_kg.apps.text_agents.games import Pair
from wordcraft_kg.apps.text_agents.inspect_log import read_logged_games
from wordcraft_kg.apps.text_agents.line_player import LinePlayer
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    GamesHeader,
    PlayedSettings,
    PlayedTask,
    PlayedWorld,
)
from wordcraft_kg.apps.text_agents.results import play_all, read_games, replaced_games
from wordcraft_kg.apps.text_agents.settings import TIMEOUT, LookUps
from wordcraft_kg.apps.text_agents.submission import Played, Submission, replay
from wordcraft_kg.base.artefacts import check_file, sha256_of
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.records import as_lines
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.evaluation_tables import EVALUATION_SEED
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.evaluation.discovery import open_guides
from wordcraft_kg.graphs.arrays import padded

if TYPE_CHECKING:
    from wordcraft_kg.agents.players import Player
    from wordcraft_kg.models.model import Model

_TRAINED_ON = {
    "none": "no recipe of this book",
    "partial": "train recipes of this book",
    "full": "all recipes of this book, including the test tasks",
}
_SCRIPTED = {
    "random": ("random", "random"),
    "nearest-words": ("nearest words", "nearest-words"),
    "votes": ("partial KG, votes", ""),
    "graph": ("partial KG, u+v", ""),
    "oracle": ("recipe oracle", "greedy"),
}
"""Names of scripted players by kind, and of the discoverers that play open-ended games for them."""
_USES = {"votes": "partial", "graph": "partial", "oracle": "full"}
_BEST_PAIR = ("w, best pair", "u+v, self edges dropped")
_OWN_LICENCE = "Apache-2.0"


@dataclass(frozen=True)
class RunSettings:
    """Settings for text players.

    Attributes:
        messages: folder for a program's prompts and answers.
        look_ups: look-up source.
        timeout: seconds for an answer of a program.
        weights: file with the player's weights, for the hash; None without weights.
        is_replacing: whether earlier games stay in ``messages`` until the new games are complete.
    """

    messages: Path
    look_ups: LookUps = "none"
    timeout: float = TIMEOUT
    weights: Path | None = None
    is_replacing: bool = False


@dataclass(frozen=True)
class Entrant:
    """A player's decisions in all games of a track, in order, and facts for the submission.

    Attributes:
        name: name in tables.
        games: decisions by game.
        training_data, licence: as the player's folder declares.
        prompt_hash: hash of the prompts that were read; None for a player without text.
        weights: SHA-256 by file name.
        tokens: numbers of tokens by kind; None if not counted.
        answers: for each game the player's messages; empty if they were not recorded.
    """

    name: str
    games: Sequence[Played]
    training_data: str = "not declared"
    licence: str = "not declared"
    prompt_hash: str | None = None
    weights: Mapping[str, str] = field(default_factory=dict)
    tokens: Mapping[str, int] | None = None
    answers: Sequence[Sequence[str]] = ()


@dataclass(frozen=True)
class Kind:
    """A kind of player: description, the argument's meaning (empty without one), and the function that plays."""

    about: str
    argument: str
    enter: Callable[[Track, str, RunSettings], Entrant]


def decisions(track: Track, player: "Player") -> list[Played]:
    """Return the decisions of a scripted player or policy in all tasks of a track, played together."""
    world, size = track.world, len(track)
    engine = BatchEngine(world, size)
    tables = padded([task.table for task in track.frozen.tasks], world.nothing)
    state = engine.pose(np.arange(size), tables=tables)
    rng, rows = np.random.default_rng([EVALUATION_SEED, 0]), np.arange(size)
    pairs: list[list[Pair | None]] = [[] for _ in rows]
    names = (*track.opened.graph.entities, None)
    while (running := state.attempts_left > 0).any():
        slots = player(state, rng)
        first, second = state.selection, state.table[rows, slots]
        for row in np.flatnonzero(running & (first != engine.nothing)).tolist():
            one, other = names[first[row]], names[second[row]]
            pairs[row].append((one, other) if one and other else None)
        state, _ = engine.step_once(state, slots)
    return [Played(own) for own in pairs]


def discoveries(track: Track, player: Discoverer) -> list[Played]:
    """Return the decisions of a player in all open-ended games of a track."""
    graph, games = track.opened.graph, []
    for number, order in enumerate(track.frozen.orders):
        world, pairs = Discovery(graph), list[Pair | None]()
        player.begin(order, np.random.default_rng([EVALUATION_SEED, number]))
        while len(pairs) < track.frozen.attempts and not world.is_complete:
            one, other = player.choose()
            player.observe((one, other), world.combine(one, other)[0])
            pairs.append((graph.entities[one], graph.entities[other]))
        games.append(Played(pairs))
    return games


def _scripted(kind: str) -> Callable[[Track, str, RunSettings], Entrant]:
    def enter(track: Track, argument: str, settings: RunSettings) -> Entrant:
        on_tasks, name = _SCRIPTED[kind]
        knows = _TRAINED_ON[_USES.get(kind, "none")] + ", glove words" * (kind == "nearest-words")
        if track.is_open_ended and name:
            (player,) = make_discoverers([name], track.opened.graph).values()
            return Entrant(on_tasks, discoveries(track, player), knows, _OWN_LICENCE)
        from wordcraft_kg.agents.players import knowledge_players  # loads torch

        players = knowledge_players(track.world.split)
        return Entrant(on_tasks, decisions(track, players[on_tasks]), knows, _OWN_LICENCE)

    return enter


def _with_model(
    track: Track, folder: str, settings: RunSettings, names: Sequence[str] = ("planner",)
) -> Entrant:
    from wordcraft_kg.agents.players import scorer_players  # these load torch
    from wordcraft_kg.agents.recipe_discovery import RecipeDiscoverer
    from wordcraft_kg.models.folder import open_model
    from wordcraft_kg.models.scorers.folder import WEIGHTS

    model, graph = open_model(folder), track.opened.graph
    own, name = model.opened, Path(folder).name
    if own.graph.hash == graph.hash:
        _check_split(folder, own.split.hash, track)
    about: dict[str, Any] = {
        "training_data": _learned_from(model, track, model.kg),
        "weights": {WEIGHTS: model.run.outputs[WEIGHTS]},
    }
    if track.is_open_ended:
        guides = open_guides(folder, graph)
        learner = None if guides.recipes is None else RecipeDiscoverer(guides.recipes)
        (kind,) = guides.players[-1:]
        (player,) = make_discoverers([kind], graph, guides.links, learner).values()
        return Entrant(f"{name}, {kind}", discoveries(track, player), **about)
    players = scorer_players(graph, model.scorer, model.triples, plans=True)
    best = next((each for each in names if each in players), None)
    if best is None:
        raise ConfigError(f"'{folder}' cannot plan; expected a model of train-recipes.")
    return Entrant(f"{name}, {best}", decisions(track, players[best]), **about)


def _learned_from(model: "Model", track: Track, kg: str) -> str:
    """Return a model's training recipes, word vectors and outside knowledge, as its folder records them."""
    book, words = model.opened.graph, getattr(model.metrics, "features", "")
    known = [_TRAINED_ON[kg] if book.hash == track.opened.graph.hash else f"recipes of {book.name}"]
    known += [f"{Path(words).name} words"] * (words not in ("", "one-hot"))
    if outside := model.history.facts.get("outside knowledge"):
        known.append(f"outside knowledge: {outside}")
    return ", ".join(known)


def _agent(track: Track, argument: str, settings: RunSettings) -> Entrant:
    from wordcraft_kg.agents.agent_folder import open_agent  # these load torch
    from wordcraft_kg.agents.evaluation import PolicyPlayer
    from wordcraft_kg.models.folder import open_model
    from wordcraft_kg.models.scorers.folder import WEIGHTS

    agent = open_agent(argument)
    _check_split(argument, agent.opened.split.hash, track)
    weights = {
        name: agent.run.outputs[name]
        for name in ("policy.safetensors",)
        if name in agent.run.outputs
    }
    if not weights:
        raise ConfigError(f"'{argument}' is unfinished; expected a finished run of train-agent.")
    kg = "full" if agent.run.kg == "full" else "partial"  # agents train on the train tasks
    knows = _TRAINED_ON[kg]
    if agent.config.scorer is not None:
        model = open_model(agent.config.scorer)
        if model.run.outputs[WEIGHTS] != agent.run.inputs["scorer"]:
            raise ArtefactError(
                f"'{agent.config.scorer}' is not the scorer of '{argument}'. Restore a copy."
            )
        knows = _learned_from(model, track, kg)
    words = f", {Path(agent.config.policy.features).name} words"
    knows += words * (
        words not in knows and agent.config.policy.features not in ("learned", "one-hot", "random")
    )
    return Entrant(agent.name, decisions(track, PolicyPlayer(agent.policy)), knows, weights=weights)


def _check_split(folder: str, split: str, track: Track) -> None:
    if split != track.opened.split.hash:
        raise GraphMismatchError(
            f"'{folder}' was trained on split {split[:12]}; {track.name} has the {track.frozen.split} split "
            f"{track.opened.split.hash[:12]} of {track.book}. Build this graph with build-graph, and train on it."
        )


def _program(track: Track, argument: str, settings: RunSettings) -> Entrant:
    play = track.play(settings.look_ups)
    with LinePlayer(argument, timeout=settings.timeout) as program:
        header = GamesHeader(player=program.name, settings=play.settings)
        folder = settings.messages
        replaced = replaced_games(folder, header) if settings.is_replacing else nullcontext(folder)
        with replaced as games:
            play_all(program.name, program.speaker, play, games)
    played = read_games(settings.messages / GAMES_FILE)[1]
    answers = [one.messages[1::2] for one in played]
    return _recorded(track, settings, program.name, play.settings, played, answers)


def _inspect(track: Track, argument: str, settings: RunSettings) -> Entrant:
    logged = read_logged_games(Path(argument), with_answers=True)
    entrant = _recorded(
        track, settings, logged.model, logged.settings, logged.games, logged.answers
    )
    return replace(entrant, tokens=logged.tokens)


def _mcp(track: Track, argument: str, settings: RunSettings) -> Entrant:
    header, played, _ = read_games(Path(argument))
    return _recorded(track, settings, header.player, header.settings, played)


def _recorded(
    track: Track,
    run: RunSettings,
    name: str,
    settings: PlayedSettings,
    played: Sequence[PlayedTask | PlayedWorld],
    answers: Sequence[Sequence[str]] = (),
) -> Entrant:
    """Return the decisions in recorded games, in the order of the track; the first game of a task counts.

    Args:
        track: the track that was played.
        run: the settings of this command.
        name: the player's name.
        settings: the recorded settings.
        played: the recorded games in any order, some perhaps several times.
        answers: for each recorded game the player's messages; empty if they were not recorded.

    Raises:
        ConfigError: for games of another track, with other look-ups, or if a game is missing.
    """
    if settings.track != track.full_name:
        raise ConfigError(
            f"the games of '{name}' are of {settings.track or 'no track'}; expected {track.full_name}. Play the track "
            f"with `inspect eval wordcraft_kg/crafting -T track={track.name}` or `mcp --track {track.name}`."
        )
    if settings.knowledge != run.look_ups:
        raise ConfigError(
            f"`look_ups` {run.look_ups}: the games have {settings.knowledge}; give the same."
        )
    numbers = [one.task if isinstance(one, PlayedTask) else one.game for one in played]
    first = {numbers[place]: place for place in reversed(range(len(played)))}
    if missing := set(range(len(track))) - first.keys():
        raise ConfigError(
            f"{len(track) - len(missing)} of {len(track)} games of {track.name} were played; play game {min(missing)}."
        )
    order = [first[number] for number in range(len(track))]
    games = [
        Played(one.pairs, one.look_ups, one.invalid_actions)
        for one in map(played.__getitem__, order)
    ]
    messages = [answers[place] for place in order] if answers else []
    return Entrant(name, games, prompt_hash=settings.prompt_hash, answers=messages)


KINDS: Registry[Kind] = Registry(
    "wordcraft_kg.bench_players",
    {
        "random": Kind("chance", "", _scripted("random")),
        "nearest-words": Kind(
            "the items with the words nearest to the goal", "", _scripted("nearest-words")
        ),
        "votes": Kind("votes of the train recipes on pairs", "", _scripted("votes")),
        "graph": Kind("links of the train recipes, without learning", "", _scripted("graph")),
        "oracle": Kind("knows all recipes", "", _scripted("oracle")),
        "scorer": Kind(
            "the best pair by a model's scores", "MODEL", partial(_with_model, names=_BEST_PAIR)
        ),
        "planner": Kind("the first pair of a model's best plan", "MODEL", _with_model),
        "agent": Kind("a trained agent", "RUN", _agent),
        "program": Kind("a program that plays by the line protocol", "COMMAND", _program),
        "inspect": Kind("a language model in Inspect AI, by its log", "LOG", _inspect),
        "mcp": Kind("MCP clients, by the games of `mcp --track`", "GAMES", _mcp),
    },
)
"""Kinds of players by name."""


def enter(track: Track, player: str, settings: RunSettings) -> tuple[str, Entrant]:
    """Let a player, ``KIND`` or ``KIND:ARGUMENT`` (else ConfigError), play; return kind and decisions."""
    name, _, argument = player.partition(":")
    if name not in KINDS:
        raise ConfigError(f"`player` '{name[:100]}': expected one of {', '.join(KINDS)}.")
    kind = KINDS[name]
    if bool(argument) != bool(kind.argument):
        raise ConfigError(
            f"`player` '{player[:100]}': expected {name}{':' * bool(kind.argument)}{kind.argument}."
        )
    if name not in TEXT_PLAYERS and (settings.look_ups != "none" or settings.weights):
        raise ConfigError(
            f"`look_ups` or `weights`: expected a player by text ({', '.join(TEXT_PLAYERS)}), but got {name}."
        )
    if not settings.weights:
        return name, kind.enter(track, argument, settings)
    check_file(settings.weights)
    weights = {settings.weights.name: sha256_of(settings.weights)}
    return name, replace(kind.enter(track, argument, settings), weights=weights)


def reproduce(
    folder: Path,
    submission: Submission,
    player: str,
    timeout: float = TIMEOUT,
    weights: Path | None = None,
) -> None:
    """Let a submission's player play again; ArtefactError for a difference, ConfigError for a record."""
    if player.partition(":")[0] in ("inspect", "mcp"):
        raise ConfigError(
            "expected a player that plays here; a record of games (inspect, mcp) cannot play."
        )
    track = open_track(submission.track)
    with TemporaryDirectory() as messages:
        kind, entrant = enter(
            track, player, RunSettings(Path(messages), submission.knowledge, timeout, weights)
        )
    path, play = folder / GAMES_FILE, track.play(submission.knowledge)
    facts: dict[str, Any] = {"kind": kind, "weights": dict(entrant.weights)}
    if entrant.training_data != Entrant.training_data:
        facts["training_data"] = entrant.training_data
    if not KINDS[kind].argument:
        facts |= {"player": entrant.name, "licence": entrant.licence, "tokens": None, "price": None}
    if entrant.prompt_hash is None or submission.prompts != "custom":
        facts["prompt_hash"] = entrant.prompt_hash
    for name, value in facts.items():
        if (given := getattr(submission, name)) != value:
            raise ArtefactError(
                f"{folder}: '{name}' is {given}, but the given player has {value}. Play as before."
            )
    lines = path.read_bytes().splitlines(keepends=True)
    for number, (line, played) in enumerate(zip(lines, entrant.games, strict=True)):
        if [line.decode()] != as_lines([replay(play, number, played)]):
            raise ArtefactError(
                f"{path}, line {number + 1}: the given player plays another game here."
            )


TEXT_PLAYERS = ("program", "inspect", "mcp")
"""Kinds that read prompts."""
