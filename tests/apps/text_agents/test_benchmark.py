import json
import re
import runpy
import shlex
import sys
import zipfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import jsonschema
import msgspec
import numpy as np
import pytest
from short_fits import short_fits

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    RecipesConfig,
    RecipeScorerConfig,
    SplitConfig,
    TaskConfig,
    WordCraftConfig,
    World,
    load_scorer,
    open_agent,
    open_book,
    open_graph,
    open_model,
    train_agent,
    train_recipes,
)
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.players import knowledge_players, nearest_words, scorer_players
from wordcraft_kg.apps.text_agents import benchmark, benchmark_players, submission
from wordcraft_kg.apps.text_agents.benchmark import (
    BOARD,
    FrozenTask,
    FrozenTrack,
    Track,
    open_track,
    rank_text,
    read_manifest,
)
from wordcraft_kg.apps.text_agents.benchmark_players import RunSettings, enter, reproduce
from wordcraft_kg.apps.text_agents.commands.bench import bench_run, bench_verify
from wordcraft_kg.apps.text_agents.mcp_server import tools_hash
from wordcraft_kg.apps.text_agents.plays import chosen_tasks
from wordcraft_kg.apps.text_agents.submission import SCHEMA, acceptable, verify
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    OutputExistsError,
    sha256_of,
)
from wordcraft_kg.envs.draws import EvaluationTables
from wordcraft_kg.envs.words import prompt_hash
from wordcraft_kg.models.scorers.features import make_features

sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))
write_leaderboard = import_module("leaderboard_page").write_leaderboard
board_text = import_module("leaderboard_page").board_text
FIRST_TWO = "import sys\nfor line in sys.stdin: print('1 + 2', flush=True)"
PYTHON = shlex.quote(sys.executable)
PROGRAM = f"program:{PYTHON} -c {shlex.quote(FIRST_TWO)}"
LITE = [name for name in read_manifest()[0].names if "-lite" in name]
FAST = ("depth-2-lite", "discover-500-lite")
OTHER = "0" * 64


@pytest.fixture(scope="module")
def submitted(tmp_path_factory):
    """Return a function from track and player to the folder of its submission, played once."""
    made = {}

    def submit(track="craft-8-lite", player="votes"):
        if (track, player) not in made:
            made[track, player] = tmp_path_factory.mktemp("bench") / "out"
            bench_run(track, player=player, out=made[track, player])
        return made[track, player]

    return submit


@pytest.fixture
def copied(submitted, tmp_path):
    """Return a function that copies a submission."""

    def copy(*track_and_player):
        folder = tmp_path / "copy"
        folder.mkdir(exist_ok=True)
        for file in submitted(*track_and_player).glob("*.json*"):
            (folder / file.name).write_bytes(file.read_bytes())
        return folder

    return copy


def edit(folder, **values):
    path = folder / "submission.json"
    record = json.loads(path.read_text()) | values
    path.write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n")
    return record


def seal(folder):
    """Write the hash of the games into the submission, as someone who edits games would."""
    edit(folder, games_hash=sha256_of(folder / "games.jsonl"))


def lines_in(folder):
    return (folder / "games.jsonl").read_bytes().splitlines(keepends=True)


def test_the_manifest_is_the_published_one_with_the_present_prompts(monkeypatch):
    """Another wording is another experiment, and needs another edition of the benchmark."""
    monkeypatch.setattr(sys, "argv", ["make_benchmark.py", "--check"])
    root = Path(__file__).parents[3]
    runpy.run_path(str(root / "data" / "make_benchmark.py"), run_name="__main__")
    manifest, _ = read_manifest()
    assert manifest.prompts == {"text": prompt_hash(), "mcp": tools_hash()}
    assert manifest.canary in (root / "docs/benchmark-rules.md").read_text()


def test_no_table_of_several_attempts_tells_its_plan_by_its_size():
    tasks = read_manifest()[0].tracks["depth-2"].tasks
    assert {len(task.table) for task in tasks} == {7}
    world = open_track("depth-2").world
    assert (world.tasks.starts == world.nothing).any(), "some plans use an item twice"


@pytest.mark.parametrize("name", ["craft-8", pytest.param("goal-8", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "player",
    [
        "nearest-words",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("words:glove", "oracle")),
    ],
)
def test_a_scripted_player_has_the_success_of_the_evaluation(submitted, name, player):
    track = open_track(name)
    config = WordCraftConfig("test", track.frozen.depth, track.frozen.distractors)
    lines = [json.loads(line) for line in lines_in(submitted(name, player))]
    world = World(track.opened, config)
    scripted = knowledge_players(track.opened.split)["recipe oracle"]
    if player != "oracle":
        vectors = "glove" if player == "words:glove" else "minilm"
        features = make_features(vectors, track.opened.graph.entities)
        scripted = nearest_words(features.unit_vectors)
    expected = Evaluator(world, distractor_seeds=1)(scripted)
    chosen = chosen_tasks(world, 500)
    for values in ("success", "by_plan"):
        assert np.array_equal(
            [line[values] for line in lines], getattr(expected, values)[chosen, 0]
        ), values


@pytest.mark.parametrize(
    ("track", "player"),
    [
        ("craft-8-lite", "random"),
        *(
            pytest.param(track, "oracle", marks=[] if track in FAST else pytest.mark.slow)
            for track in LITE
        ),
    ],
)
def test_every_lite_track_can_be_played_and_verified(submitted, track, player):
    submission = verify(submitted(track, player))
    assert submission.figures.games == len(open_track(track)) == (5 if "discover" in track else 100)
    if player == "oracle" and "discover" not in track:
        assert submission.figures.by_plan == submission.figures.mean == 1
    record = json.loads((submitted(track, player) / "submission.json").read_text())
    jsonschema.validate(record, json.loads(SCHEMA.read_text()))


def test_the_tasks_with_made_up_words_are_the_same_tasks(submitted):
    known, unknown = (
        verify(submitted(f"depth-2-lite{words}", "votes")) for words in ("", "-made-up")
    )
    assert known.figures == unknown.figures
    assert known.games_hash != unknown.games_hash


@pytest.mark.parametrize(
    "player", ["random", "votes", pytest.param(PROGRAM, marks=pytest.mark.slow)]
)
def test_the_same_player_writes_the_same_bytes_and_is_reproduced(
    submitted, tmp_path, player, capsys
):
    first = submitted(player=player)
    bench_run("craft-8-lite", player=player, out=tmp_path / "again")
    for name in ("games.jsonl", "submission.json"):
        assert (tmp_path / "again" / name).read_bytes() == (first / name).read_bytes()
    assert bench_verify(first, player=player) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("reproduced  craft-8-lite")


@pytest.mark.slow
def test_a_program_keeps_its_messages_and_look_ups_are_offered_and_counted(tmp_path):
    asks = FIRST_TWO.replace("'1 + 2'", "'look up air' if '\"new\": true' in line else '1 + 2'")
    player = f"program:{PYTHON} -c {shlex.quote(asks)}"
    bench_run(
        "craft-1-lite",
        player=player,
        out=tmp_path / "out",
        look_ups="partial",
        price=0.5,
        tokens=(9, 3),
        measured=True,
    )
    submission = verify(tmp_path / "out")
    assert (submission.look_ups, submission.knowledge, submission.prompts) == (
        100,
        "partial",
        "standard",
    )
    assert (submission.price, submission.tokens) == (0.5, {"input": 9, "output": 3})
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", submission.date)
    assert len(lines_in(tmp_path / "out" / "messages")) == 101
    edit(tmp_path / "out", knowledge="none")
    with pytest.raises(ArtefactError, match="line 1: the game has 1 look-up; expected at most 0"):
        verify(tmp_path / "out")


def test_declared_weights_are_hashed_and_compared(tmp_path, capsys):
    """Declared weights are hashed before the games and compared in reproduction."""
    weights, out = tmp_path / "model.gguf", tmp_path / "out"
    with pytest.raises(ArtefactError, match=r"model.gguf is missing"):
        bench_run("craft-1-lite", player=PROGRAM, out=out, weights=weights)
    weights.write_text("weights")
    with pytest.raises(
        ConfigError,
        match=r"`weights`: expected a player by text \(program, openai, inspect, mcp, openenv\), but got random",
    ):
        bench_run("craft-1-lite", player="random", out=out, weights=weights)
    assert not out.exists()
    bench_run("craft-1-lite", player=PROGRAM, out=out, weights=weights)
    assert verify(out).weights == {"model.gguf": sha256_of(weights)}
    assert bench_verify(out, player=PROGRAM, weights=weights) == 0
    assert bench_verify(out, player=PROGRAM) == 1
    assert "'weights' is {'model.gguf'" in capsys.readouterr().out


@pytest.mark.parametrize(
    "values",
    [
        {"player": "A language model"},
        {"prompts": "custom", "prompt_hash": OTHER},
        *(
            pytest.param(values, marks=pytest.mark.slow)
            for values in (
                {"training_data": "no recipe of this book"},
                {"licence": "MIT"},
                {"prompts": "standard", "prompt_hash": prompt_hash()},
                {"tokens": {"input": 1}},
            )
        ),
    ],
)
def test_other_facts_are_replayed_but_not_reproduced(copied, values):
    """Other facts about a player that plays here are replayed but not reproduced."""
    folder = copied()
    edit(folder, **values)
    with pytest.raises(ArtefactError, match="but the given player has"):
        reproduce(folder, verify(folder), "votes")


def test_another_player_does_not_reproduce_a_submission(submitted, tmp_path):
    folder = submitted()
    with pytest.raises(ArtefactError, match="'kind' is votes, but the given player has random"):
        reproduce(folder, verify(folder), "random")
    first = submitted(player=PROGRAM)
    with pytest.raises(ArtefactError, match="line 1: the given player plays another game here"):
        reproduce(first, verify(first), PROGRAM.replace("1 + 2", "3 + 4"))


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (
            {"benchmark": "everyday-v2"},
            "'benchmark' is everyday-v2; expected everyday-v3.*play the track again",
        ),
        ({"benchmark_hash": OTHER}, "'benchmark_hash' is 0000"),
        ({"scoring": 1}, "'scoring' is 1; expected 2"),
        ({"graph_hash": OTHER}, "'graph_hash' is \"0000"),
        ({"track": "craft-9"}, "unknown track 'craft-9'"),
        ({"track": "craft-8"}, "100 games, a line each; expected 500"),
        (
            {"prompts": "standard", "prompt_hash": OTHER},
            "'prompt_hash' is 0000.*declare custom prompts",
        ),
        ({"prompts": "standard"}, "'prompt_hash' is None"),
        ({"prompt_hash": OTHER}, "'prompts' is none"),
        ({"prompts": "custom"}, "'prompts' is custom"),
        ({"look_ups": 1}, "'look_ups' is 1; expected 0"),
        ({"answers_read": 0.5}, "'answers_read' is 0.5; expected 1.0"),
        ({"games_hash": OTHER}, "'games_hash' is"),
        ({"price": float("nan")}, "submission.json is damaged"),
        ({"price": -1.0}, r"Expected `float` >= 0.0|'float' >= 0.0"),
        ({"notes": ""}, "unknown field"),
        ({"player": "a\n\n## b"}, "player.*expected 1 to 500 characters on one line"),
        ({"player": "x" * 101}, "length <= 100"),
        ({"player": "<img src=x>"}, "player.*a text without < >"),
        ({"player": "me †"}, "player.*a text without"),
        ({"player": "mine \u202erekram"}, "player.*on one line"),
        ({"player": "hidden\u3164filler"}, "player.*invisible characters"),
        ({"player": "mine\U000e0100"}, "player.*invisible characters"),
        ({"player": "e" + "\u0301" * 9}, "player.*at most two accents"),
        ({"kind": "a\nb"}, "kind.*on one line"),
        ({"kind": "people"}, "'kind' is people; expected the kind of a program"),
        ({"kind": "P\u0435ople "}, "'kind' is P.ople ; expected the kind of a program"),
        ({"kind": "p.e0p1e"}, "'kind' is p.e0p1e; expected the kind of a program"),
        ({"kind": "people:mine"}, "'kind' is people:mine; expected the kind of a program"),
        ({"training_data": "javascript:alert(1)"}, "training_data.*http or https only"),
        ({"training_data": "ftp://example.org"}, "training_data.*http or https only"),
        ({"licence": "`a` | b"}, "licence.*a text without"),
        ({"licence": "data:text/html,x"}, "licence.*http or https only"),
        ({"date": "2026-01-01\n\n## verified"}, "damaged"),
        ({"date": "2026-01-01\n"}, "damaged"),
        ({"date": "[x](javascript:0)"}, "damaged"),
        ({"price": 1e308}, "damaged"),
        ({"price": 1_000_001.0}, "damaged"),
        ({"seconds": 1e308}, "damaged"),
        ({"tokens": {"in\nput": 1}}, "a name in weights or tokens.*on one line"),
        ({"tokens": {"input": 2**62}}, "damaged"),
        ({"weights": {"a\n## b": OTHER}}, "a name in weights or tokens.*on one line"),
        ({"weights": {"a": OTHER + "\n"}}, "damaged"),
    ],
)
def test_a_submission_that_the_benchmark_contradicts_is_refused(copied, values, reason):
    folder = copied()
    edit(folder, **values)
    with pytest.raises((ArtefactError, ConfigError), match=reason):
        verify(folder)


@pytest.mark.parametrize("value", [0.9, float("nan"), 2.0])
def test_an_edited_figure_is_refused(copied, value):
    folder = copied()
    figures = json.loads((folder / "submission.json").read_text())["figures"]
    edit(folder, figures=figures | {"mean": value})
    with pytest.raises(ArtefactError, match=r"'figures' is|damaged"):
        verify(folder)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda lines: lines[:30], "30 games, a line each; expected 100"),
        (lambda lines: [lines[1], lines[0], *lines[2:]], "line 1: game 1; expected game 0"),
        (lambda lines: [*lines, lines[0]], "101 games, a line each; expected 100"),
        (lambda lines: [lines[0], lines[0], *lines[2:]], "line 2: game 0; expected game 1"),
        (
            lambda lines: [lines[0][:-2] + b', "invalid_actions": 1000001}\n', *lines[1:]],
            "line 1: the game has 1,000,001 invalid answers; expected at most 1,000,000",
        ),
        (
            lambda lines: [lines[0].replace(b'"success": false', b'"success": true'), *lines[1:]],
            "line 1: the replay",
        ),
        (
            lambda lines: [lines[0].replace(b'"goal": "', b'"goal": "x'), *lines[1:]],
            "line 1: the replay gives",
        ),
        (
            lambda lines: [re.sub(rb'\[\["\w+', b'[["unicorn', lines[0]), *lines[1:]],
            "line 1: attempt 1 .*unicorn",
        ),
        (
            lambda lines: [re.sub(rb'\[(\[".*?\])\]', rb"[\1, \1]", lines[0], count=1), *lines[1:]],
            "line 1: attempt 2 comes",
        ),
        (
            lambda lines: [re.sub(rb'\[\[".*?\]\]', b"[null]", lines[0], count=1), *lines[1:]],
            "line 1: 1 attempt were",
        ),
        (lambda lines: [lines[0][:-2] + b"\n", *lines[1:]], "line 1,.* is damaged"),
        (lambda lines: [*lines[:-1], lines[-1][:-1]], "99 games, a line each; expected 100"),
        (lambda lines: [b" " + lines[0], *lines[1:]], "line 1: the replay gives"),
    ],
)
def test_changed_games_are_refused_with_the_line_even_under_a_new_hash(copied, change, reason):
    folder = copied()
    (folder / "games.jsonl").write_bytes(b"".join(change(lines_in(folder))))
    seal(folder)
    with pytest.raises(ArtefactError, match=reason):
        verify(folder)


def mutated(rng, data):
    """Return games with a random change of a byte, or of the order or number of the lines."""
    lines = data.splitlines(keepends=True)
    one, other = rng.choice(len(lines), 2, replace=False)
    kind = rng.integers(5)
    if kind == 0:
        lines[one], lines[other] = lines[other], lines[one]
    elif kind == 1:
        del lines[one]
    elif kind == 2:
        lines.insert(one, lines[other])
    elif kind == 3:  # an invented game: the decisions of another game
        lines[one] = lines[other].replace(b'"number": %d,' % other, b'"number": %d,' % one)
    else:
        place = int(rng.integers(len(data)))
        changed = (data[place] + 1 + int(rng.integers(255))) % 256
        return data[:place] + bytes([changed]) + data[place + 1 :]
    return b"".join(lines)


@pytest.mark.slow
def test_every_mutation_of_the_games_is_refused(copied):
    folder = copied("craft-8-lite", "nearest-words")
    path, rng = folder / "games.jsonl", np.random.default_rng(0)
    original = path.read_bytes()
    for _ in range(60):
        changed = mutated(rng, original)
        assert changed != original
        path.write_bytes(changed)
        seal(folder)  # else the hash of the games alone refuses all
        with pytest.raises(ArtefactError):
            verify(folder)


def test_a_manifest_of_another_book_is_refused(monkeypatch):
    manifest, manifest_hash = read_manifest()
    books = {
        name: msgspec.structs.replace(book, hash=OTHER) for name, book in manifest.books.items()
    }
    monkeypatch.setattr(
        benchmark,
        "read_manifest",
        lambda: (msgspec.structs.replace(manifest, books=books), manifest_hash),
    )
    with pytest.raises(
        GraphMismatchError, match=r"the book 'everyday' has the hash 82dcde20aeb1.* made for 0000"
    ):
        open_track.__wrapped__("goal-8")


def test_players_and_tracks_that_do_not_fit_are_refused(submitted, tmp_path):
    settings = RunSettings(tmp_path)
    for track, player, reason in (
        ("craft-8-lite", "oracel", "expected one of random, nearest-words"),
        ("craft-8-lite", "random:1", "expected random."),
        ("craft-8-lite", "scorer", "expected scorer:MODEL"),
        ("discover-500-lite", "votes", "is open-ended and has no tasks"),
    ):
        with pytest.raises(ConfigError, match=reason):
            enter(open_track(track), player, settings)
    with pytest.raises(ConfigError, match="expected a player by text"):
        enter(open_track("craft-8-lite"), "random", RunSettings(tmp_path, "partial"))
    with pytest.raises(ArtefactError, match=r"prompts.txt is missing"):
        bench_run(
            "craft-8-lite", player="random", out=tmp_path / "out", prompts=tmp_path / "prompts.txt"
        )
    with pytest.raises(OutputExistsError, match="exists"):
        bench_run("craft-8-lite", player="votes", out=submitted())


@pytest.mark.parametrize(
    ("files", "force", "reason"),
    [
        (["games.jsonl", "messages/mail"], False, "does not look like an output"),
        (["messages/games.jsonl"], False, "does not look like an output"),
        (["run.json", "messages/mail"], True, "not a submission"),
        (["submission.json", "messages/mail"], True, "expected one of random"),
    ],
)
def test_no_other_file_is_changed(tmp_path, files, force, reason):
    (tmp_path / "messages").mkdir()
    for name in files:
        (tmp_path / name).write_text("mine")
    with pytest.raises((ConfigError, OutputExistsError), match=reason):
        bench_run("craft-8-lite", player="unknown", out=tmp_path, force=force)
    assert all((tmp_path / name).read_text() == "mine" for name in files)


def test_of_two_runs_into_one_folder_one_is_refused(tmp_path, monkeypatch):
    out = tmp_path / "out"

    def meanwhile(*arguments):
        with pytest.raises(ArtefactError, match="is being written by another process"):
            bench_run("craft-1-lite", player="random", out=out)
        return enter(*arguments)

    monkeypatch.setattr(benchmark_players, "enter", meanwhile)
    bench_run("craft-1-lite", player="votes", out=out)
    assert verify(out).kind == "votes"


def test_a_submission_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    whole = submission.write_atomically

    def full(path, content):
        if path.name == "submission.json":
            raise OSError(28, "No space left on device")
        whole(path, content)

    monkeypatch.setattr(submission, "write_atomically", full)
    with pytest.raises(OSError, match="No space"):
        bench_run("craft-1-lite", player="random", out=tmp_path / "new" / "out")
    assert not [*tmp_path.iterdir()]


@pytest.fixture
def kitchen_track(opened_kitchen, monkeypatch):
    """The kitchen's test tasks, in place of any track."""
    world = World(opened_kitchen, WordCraftConfig("test", 1, 3))
    tables = EvaluationTables(world)
    tasks = tuple(
        FrozenTask(plans, tuple(tables.table(task))) for task, plans in enumerate(world.tasks.plans)
    )
    track = Track(
        "craft-8",
        "everyday-v3",
        FrozenTrack("", "by-recipe", 1, 1, 3, tasks),
        opened_kitchen,
    )
    for module in (benchmark, benchmark_players, submission):
        monkeypatch.setattr(module, "open_track", lambda name: track)
    return track


@pytest.mark.slow
def test_models_and_agents_play_as_in_the_evaluation(
    kitchen_track, recipes_folder, tmp_path, capsys
):
    """Models and agents play as in the evaluation and only their weights reproduce."""
    trainer = ImpalaConfig(
        steps=64, batch_size=8, unroll=2, log_every=64, eval_every=64, checkpoint_every=64
    )
    tasks = TaskConfig(distractors=3)
    train_agent(
        AgentConfig("kitchen", str(recipes_folder), tasks, trainer=trainer), tmp_path / "run"
    )
    model = open_model(recipes_folder)
    scripted = scorer_players(
        model.opened.graph, load_scorer(recipes_folder), model.triples, plans=True
    )
    evaluate = Evaluator(kitchen_track.world, distractor_seeds=1)
    learned = r"train recipes of this book, \w+ words"
    for player, expected in (
        (f"scorer:{recipes_folder}", scripted["w, best pair"]),
        (f"planner:{recipes_folder}", scripted["planner"]),
        (f"agent:{tmp_path / 'run'}", PolicyPlayer(open_agent(tmp_path / "run").policy)),
    ):
        folder = tmp_path / player.partition(":")[0]
        bench_run("craft-8", player=player, out=folder)
        success = [json.loads(line)["success"] for line in lines_in(folder)]
        assert success == evaluate(expected).success[:, 0].tolist()
        assert bench_verify(folder, player=player) == 0
        record = edit(folder, weights=dict.fromkeys(verify(folder).weights, OTHER))
        assert re.match(learned, record["training_data"])
        assert (
            record["training_data"].endswith("glove words") or "agent" not in player
        )  # the policy has words too
        assert bench_verify(folder, player=player) == 1
        assert "'weights' is" in capsys.readouterr().out
        other_split = replace(kitchen_track, opened=open_graph("kitchen", SplitConfig("by-goal")))
        with pytest.raises(GraphMismatchError, match="was trained on graph"):
            enter(other_split, player, RunSettings(tmp_path))


def test_a_model_declares_the_knowledge_from_outside_its_recipes(kitchen_track, tmp_path):
    other = tmp_path / "other.csv"
    rows = (f"{a},{b},{result}\n" for a, b, result in open_book("kitchen").recipes[:100])
    other.write_text("ingredient_a,ingredient_b,result\n" + "".join(rows))
    settings = RecipeScorerConfig(kg="none", folds=2, with_=(str(other),))
    with short_fits():
        train_recipes(RecipesConfig("kitchen", settings), tmp_path / "model")
    _, entrant = enter(kitchen_track, f"scorer:{tmp_path / 'model'}", RunSettings(tmp_path))
    assert re.match(
        r"no recipe of this book, \w+ words, outside knowledge: other \(book\)",
        entrant.training_data,
    )


def test_the_leaderboard_has_tables_and_refuses_edits(submitted, copied, tmp_path):
    """The leaderboard has a table for each track and refuses edited submissions."""
    page = tmp_path / "page.md"
    for number, (track, player) in enumerate(
        [("craft-8-lite", "random"), ("craft-8-lite", PROGRAM)]
    ):
        (tmp_path / "all" / f"{number}").mkdir(parents=True)
        for file in submitted(track, player).glob("*.json*"):
            (tmp_path / "all" / f"{number}" / file.name).write_bytes(file.read_bytes())
    write_leaderboard(tmp_path / "all", page)
    text = page.read_text()
    rows = re.findall(r"^\| (\S) \| (\S+) \|.* \| (re\w+) \|$", text, re.MULTILINE)
    assert rows == [("1", "python", "replayed")], "chance has no rank"
    (chance,) = re.findall(
        r"^Lines of reference: chance (0\.\d+) \(random, reproduced\)", text, re.M
    )
    (bar,) = re.findall(r"(0\.\d+) \[(0\.\d+), (0\.\d+)\] <span class=\"bar\"(.*?)</span>", text)
    mean, low, high, style = bar
    places = [float(place) for place in re.findall(r"[\d.]+", style)]
    expected = [100 * float(figure) for figure in (low, mean, high, chance)]
    assert places == pytest.approx(expected, abs=0.06), "the last is the line of chance"
    assert re.findall(r"^## (\S+)", text, re.MULTILINE) == ["craft-8"]
    assert f"<summary>craft-8-lite: 1 player, best {mean}</summary>" in text
    write_leaderboard(tmp_path / "all", page, check=True)
    page.write_text(text + " ")
    with pytest.raises(ArtefactError, match="not up to date"):
        write_leaderboard(tmp_path / "all", page, check=True)
    edit(copied(), look_ups=1)
    with pytest.raises(ArtefactError, match="'look_ups' is 1"):
        write_leaderboard(tmp_path / "copy", page)
    with pytest.raises(ArtefactError, match=r"nothing/submission\.json is missing"):
        write_leaderboard(tmp_path / "nothing", page)


HOSTILE = {
    "player": "![x](//example.org/x.png) **bold** example.org",
    "training_data": "[x](https://example.org) _data_ www.example.org",
    "licence": "# {x} ~~y~~ &lt;b&gt;",
}


def test_declared_texts_are_plain_text_on_the_leaderboard(copied, tmp_path):
    pytest.importorskip("linkify_it")
    from markdown_it import MarkdownIt

    edit(copied(), kind="own", tokens={"input": 1_000, "output": 9}, seconds=12.3, **HOSTILE)
    write_leaderboard(tmp_path / "copy", tmp_path / "page.md")
    markdown = MarkdownIt("gfm-like")
    html = markdown.render((tmp_path / "page.md").read_text())
    (table,) = re.findall("<table>.*?</table>", html, re.DOTALL)
    (details,) = re.findall(r"<ul>\s*<li>!.*?</ul>", html, re.DOTALL)
    shown = {name: markdown.utils.escapeHtml(text) for name, text in HOSTILE.items()}
    assert f"<td>{shown['player']}</td>" in table
    assert shown["player"] in details
    assert f"<li>training data: {shown['training_data']}</li>" in details
    assert f"<li>licence: {shown['licence']}</li>" in details
    assert "<li>cost: 1,009 tokens, 12 s</li>" in details
    assert table.count("<td>") == table.count("<th>") == 5
    for part in (table, details):
        assert not [mark for mark in ("<a", "<img", "<strong", "<em", "<s>") if mark in part]


def test_names_that_look_alike_and_names_of_other_players_are_marked(submitted, tmp_path):
    names = {"random": "votes", "r\u0430ndom": "random", "Partial KG, votes": "votes", "mine": "x"}
    for number, (name, kind) in enumerate(names.items()):
        folder = tmp_path / "all" / f"{number}"
        folder.mkdir(parents=True)
        for file in submitted(player="votes").glob("*.json*"):
            (folder / file.name).write_bytes(file.read_bytes())
        edit(folder, player=name, kind=f"own-{kind}")
    write_leaderboard(tmp_path / "all", tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text()
    assert sorted(re.findall(r"^\| 1 \| (.*?) \| 0\.", page, re.MULTILINE)) == [
        "Partial KG, votes",
        "mine",
        "random ‡",
        "r\u0430ndom ‡",
    ]
    folder = tmp_path / "all" / "3"
    edit(folder, player="partial KG,  votes")
    write_leaderboard(tmp_path / "all", tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text()
    assert (
        len(re.findall(r"^\| 1 \| partial KG, +votes ‡", page, re.MULTILINE | re.IGNORECASE)) == 2
    )


@pytest.mark.parametrize(
    ("name", "shown"),
    [("my model", "my model"), ("a|b`c", "a-b-c"), ("a\nb", "a-b"), ("", "not declared")],
)
def test_a_name_from_a_folder_becomes_one_that_a_submission_may_hold(name, shown):
    assert acceptable(name, 100) == shown
    assert len(acceptable("x" * 300, 100)) == 100


READING = {
    "printed": ('f\'1 {m["table"][0]} + 2 {m["table"][1]}\'', "100.0%, 0 attempts lost", 1),
    "tags": ('f\'<answer>{m["table"][0]} and {m["table"][1]}</answer>\'', "100.0%", 1),
    "unread": ("'I would rather not.'", "0.0%, 100 attempts lost", 0),
}


@pytest.mark.parametrize(
    "name", ["printed", "unread", pytest.param("tags", marks=pytest.mark.slow)]
)
def test_a_run_prints_the_share_of_answers_that_are_read(submitted, tmp_path, capsys, name):
    written, shown, share = READING[name]
    code = f"import json, sys\nfor line in sys.stdin:\n m = json.loads(line)\n print({written}, flush=True)"
    bench_run("craft-8-lite", player=f"program:{PYTHON} -c {shlex.quote(code)}", out=tmp_path)
    assert capsys.readouterr().out.splitlines()[1].startswith(f"answers read  {shown}")
    record = verify(tmp_path)
    assert record.answers_read == share
    # The first two items, however they are written.
    pairs, by_place = (
        [json.loads(line)["pairs"] for line in lines_in(folder)]
        for folder in (tmp_path, submitted("craft-8-lite", PROGRAM))
    )
    assert (pairs == by_place) == bool(share)
    write_leaderboard(tmp_path, tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text()
    assert re.search(rf"\| answers read \| mark \|\n.*\n.* \| {share:.1%} \| replayed \|", page)


def archived(folder, path, names=("submission.json", "games.jsonl")):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.write(folder / name, name)
    return path


def test_an_archive_holds_a_submission_or_those_of_a_track(submitted, tmp_path, capsys):
    folder = submitted(player="votes")
    archive = archived(folder, tmp_path / "votes.zip")
    assert verify(archive) == verify(folder)
    several = tmp_path / "all" / "craft-8-lite.zip"
    several.parent.mkdir()
    with zipfile.ZipFile(several, "w") as packed:
        for player in ("votes", "random"):
            for file in submitted(player=player).glob("*.json*"):
                packed.write(file, f"{player}/{file.name}")
    assert verify(several / "votes") == verify(folder)
    with pytest.raises(ArtefactError, match=r"graph has no submission\.json"):
        verify(several / "graph")
    assert bench_verify(several.parent) == 0
    shown = capsys.readouterr().out.splitlines()[-2:]
    assert [Path(line.split()[-1]).name for line in shown] == ["random", "votes"]
    write_leaderboard(several.parent, tmp_path / "page.md")
    assert "| reproduced |" in (tmp_path / "page.md").read_text()


def test_an_archive_without_games_or_with_too_large_ones_is_refused(
    submitted, tmp_path, monkeypatch
):
    folder = submitted(player="votes")
    archive = archived(folder, tmp_path / "votes.zip", ["submission.json"])
    with pytest.raises(ArtefactError, match=r"has no games\.jsonl"):
        verify(archive)
    # An archive may unpack to a thousand times its size.
    bomb = archived(folder, tmp_path / "bomb.zip")
    monkeypatch.setattr(submission, "SMALL_FILE", bomb.stat().st_size + 1)
    with pytest.raises(ArtefactError, match=r"'games\.jsonl', has [0-9,]+ bytes; the limit"):
        verify(bomb)


def test_the_packages_board_is_that_of_the_leaderboard_and_ranks_a_result():
    assert BOARD.read_text(encoding="utf-8") == board_text(
        Path(__file__).parents[3] / "leaderboard" / "everyday-v3"
    )
    rows = json.loads(BOARD.read_text(encoding="utf-8"))["craft-8-lite"]
    assert rank_text("craft-8-lite", 1.0).startswith(f"rank 1 beside the {len(rows)} rows")
    assert rank_text("craft-8-lite", 0.0).startswith(f"rank {len(rows) + 1} ")
    second = rank_text("craft-8-lite", rows[0]["success"] - 1e-6)
    assert rows[0]["success"] > 0.5
    assert "below " in second
    assert rank_text("no-such-track", 1.0) == ""
