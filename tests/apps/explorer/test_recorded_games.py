"""Recorded games of people and programs beside an agent's, at the same tables."""

from pathlib import Path

import pytest

from tests.apps.explorer.shown import view_of
from tests.apps.people.stored import go_on
from wordcraft_kg import WordCraftConfig, World, open_graph
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages.episode import EpisodeState
from wordcraft_kg.apps.explorer.pages.games import GamesState
from wordcraft_kg.apps.people.config import StudyConfig
from wordcraft_kg.apps.people.study import HumanStudy, kept_answers, read_study
from wordcraft_kg.apps.text_agents.conversation import Play
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.records import PlayedSettings
from wordcraft_kg.apps.text_agents.results import play_all
from wordcraft_kg.apps.text_agents.submission import Submission, read_submission_file
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.records import parse_record
from wordcraft_kg.evaluation.reference import read_table_games


@pytest.fixture(scope="module")
def played(kitchen_folder, agents, tmp_path_factory):
    """The kitchen with two agents, and two people and a program at four tables each."""
    home, opened = tmp_path_factory.mktemp("games"), open_graph(kitchen_folder)
    study = HumanStudy(opened, StudyConfig(tasks=2, distractors=(8,), forms=1))
    with kept_answers(home / "study", study) as answers:
        for name in ("one", "other"):
            go_on(answers, study, answers.begin(name, study.cells), 4)
    world = World(opened, WordCraftConfig(part="test", num_distractors=8, max_attempts=2))
    settings = PlayedSettings.of(world, opened.split, tasks=4)
    play_all(
        "program",
        lambda talk: lambda prompt: "1 + 2",
        Play(TaskGames(world), settings, None),
        home / "program",
    )
    runs = [agents.runs["guided"], agents.runs["plain"]]
    return Explored.open(kitchen_folder, [], runs, [home / "study", home / "program"]), read_study(
        home / "study"
    )


def test_a_game_at_a_table_of_the_evaluation_is_shown_there_too(played):
    row = next(
        row
        for row in view_of(played[0], GamesState()).tables
        if "program" in row.solved + row.not_solved
    )
    drawn, other = (
        EpisodeState(part="test", task=row.settings["task"], distractor_seed=seed)
        for seed in (0, 1)
    )
    players = view_of(played[0], drawn).players
    assert players == view_of(played[0], EpisodeState(**row.settings)).players
    assert all(
        pick.probability is not None for attempt in players[-1].attempts for pick in attempt.picks
    )
    assert view_of(played[0], other).players == ()


def test_games_of_a_submission_are_never_shown_as_those_of_people(tmp_path):
    folder = (
        Path(__file__).parents[3] / "leaderboard/everyday-v3/submissions.zip/craft-1-lite/graph"
    )
    for name in ("submission.json", "games.jsonl"):
        data = read_submission_file(folder, name)
        (tmp_path / name).write_bytes(data.replace(b'"kind": "graph"', b'"kind": "people"'))
    with pytest.raises(ArtefactError, match="'kind' is people"):
        read_table_games(open_graph("everyday"), tmp_path)


def test_the_games_of_a_benchmark_are_those_of_its_submission():
    folder = (
        Path(__file__).parents[3] / "leaderboard/everyday-v3/submissions.zip/craft-1-lite/graph"
    )
    games = read_table_games(open_graph("everyday"), folder)
    data = read_submission_file(folder, "submission.json")
    mean = parse_record(data, Submission, folder).figures.mean
    assert sum(game.success for game in games) / len(games) == pytest.approx(mean)
    with pytest.raises(GraphMismatchError, match="was played on graph"):
        read_table_games(open_graph("kitchen"), folder)
    with pytest.raises(ConfigError, match="expected a folder of 'people serve'"):
        read_table_games(open_graph("kitchen"), folder.parents[2])
