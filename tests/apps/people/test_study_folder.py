"""The folder of a study: assignment, stored answers, and damage that is refused
without a change."""

import hashlib
import json
import math
import shutil
import sqlite3
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from helpers import refuses

from tests.apps.people.stored import (
    at_once,
    contents,
    go_on,
    lines_of,
    other_world,
    posed,
    unchanged,
)
from wordcraft_kg.apps.people.answers_database import ANSWERS_FILE, AnswersDatabase, Cell
from wordcraft_kg.apps.people.protocol import HumanProtocol, episode_seed, schedule
from wordcraft_kg.apps.people.study import (
    HumanStudy,
    check_study_folder,
    kept_answers,
    read_study,
    read_study_record,
)
from wordcraft_kg.apps.people.study_config import (
    MOST_CONDITIONS,
    MOST_FORMS,
    MOST_TASKS,
    StudyConfig,
)
from wordcraft_kg.apps.people.web_app import ALPHABET, code_hash, new_code, read_code
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    OutputExistsError,
    as_values,
)
from wordcraft_kg.graphs import SplitConfig, make_split

SMALL = StudyConfig(tasks=3, distractors=(1, 8), forms=2, seed=5)

FILES = [ANSWERS_FILE, "study.json"]


@pytest.fixture(scope="module")
def study(kitchen):
    return HumanStudy(kitchen, SMALL)


@pytest.fixture
def folder(study, tmp_path):
    """A study that has been begun; its name has what addresses of databases treat specially."""
    path = tmp_path / "a study #1 100%?"
    with kept_answers(path, study):
        return path


@pytest.fixture
def answers(folder):
    with closing(opened(folder)) as answers:
        yield answers


def opened(folder):
    return AnswersDatabase(folder / ANSWERS_FILE, read_study_record(folder)[1], 6)


def begin(answers, study):
    return answers.begin(code_hash(new_code()), study.cells)


def take_part(folder, study, count=6):
    """Begin a session and answer so many tasks."""
    with closing(opened(folder)) as answers:
        go_on(answers, study, begin(answers, study), count)


def test_codes_are_read_as_people_type_them():
    code = new_code()
    assert len(set(code)) > 4
    for typed in (
        code,
        code.upper(),
        code.replace("-", ""),
        f"  {code.replace('-', ' ')}\n",
        code.replace("-", "–"),
    ):
        assert read_code(typed) == code


@pytest.mark.parametrize(
    "typed",
    [
        "",
        "-",
        "abcd",
        "k7qm-2xwd-9hr",
        "k7qm-2xwd-9hrtt",
        "k7qm-2xwd-9hr0",
        "k7qm-2xwd-9hrï",
        "x" * 10_000,
    ],
)
def test_what_is_no_code_is_empty(typed):
    assert read_code(typed) == ""


def test_codes_differ_and_have_nothing_that_looks_alike():
    codes = {new_code() for _ in range(1_000)}
    assert len(codes) == 1_000
    assert set("".join(codes)) == {*ALPHABET, "-"}
    assert not set("01ilo") & set(ALPHABET)
    assert 12 * math.log2(len(ALPHABET)) > 59


def test_the_tasks_of_a_form_are_those_of_the_protocol(study, kitchen):
    """The tasks of a form and condition are those of the protocol with its seed."""
    for cell in study.cells:
        protocol = HumanProtocol(kitchen, cell.distractors)
        expected = tuple(protocol.task(5 + cell.form, *turn) for turn in schedule(3))
        assert study.tasks(cell) == expected


@pytest.mark.parametrize(
    ("changes", "setting"),
    [
        ({"tasks": 0}, "tasks"),
        ({"tasks": MOST_TASKS + 1}, "tasks"),
        ({"forms": 0}, "forms"),
        ({"forms": MOST_FORMS + 1}, "forms"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**63 - 1}, "seed"),
        *(
            ({"distractors": amounts}, "num_distractors")
            for amounts in ((), (1, 1), (1, -1), (1, 10_000))
        ),
        ({"distractors": tuple(range(MOST_CONDITIONS + 1))}, "num_distractors"),
        ({"consent": " \n"}, "consent"),
        ({"consent": "x" * 20_001}, "consent"),
    ],
)
def test_settings_that_cannot_be_are_refused(kitchen, changes, setting):
    with refuses(setting):
        HumanStudy(kitchen, replace(SMALL, **changes))


def test_people_are_assigned_to_the_cell_that_fewest_have_begun(study, answers):
    people = [begin(answers, study) for _ in range(8)]
    assert [person.number for person in people] == list(range(1, 9))
    assert [person.cell for person in people] == [
        Cell(0, 1),
        Cell(0, 8),
        Cell(1, 1),
        Cell(1, 8),
    ] * 2


def test_people_who_begin_at_once_are_spread_evenly(study, answers):
    people = []
    at_once(lambda: people.append(begin(answers, study)), 40)
    assert Counter(person.cell for person in people) == dict.fromkeys(study.cells, 10)
    assert sorted(person.number for person in people) == list(range(1, 41))


def test_a_code_begins_one_session(study, folder, answers):
    code = code_hash(new_code())
    person = answers.begin(code, study.cells)
    assert answers.begin(code, study.cells) == person == answers.find(code)
    assert answers.find(code_hash(new_code())) is None
    assert len(read_study(folder)) == 1


def test_the_first_answer_to_a_task_stays(study, folder, answers):
    person = begin(answers, study)
    task, protocol = study.tasks(person.cell)[0], study.protocol(person.cell)
    first, second = protocol.answer(task, (0, 1), 1.0), protocol.answer(task, (1, 1), 2.0)
    assert not answers.add(person, first)  # nobody has seen the task
    answers.show(person, task.part, task.number, 10.0)
    assert answers.add(person, first)
    assert not answers.add(person, second)
    answers.show(person, task.part, task.number, 20.0)  # a page that was loaded late
    assert answers.shown(person, task.part, task.number) is None
    assert not answers.add(person, second)
    assert answers.answers_of(person) == (msgspec.structs.replace(first, loads=1),)
    assert [line.actions for line in lines_of(folder)] == [first.actions]


def test_no_time_of_day_stays_with_an_answer(study, folder, answers):
    go_on(answers, study, begin(answers, study), 2)
    with sqlite3.connect(folder / ANSWERS_FILE) as connection:
        assert connection.execute("SELECT COUNT(*) FROM showings").fetchone() == (0,)
        (names,) = zip(
            *connection.execute("SELECT name FROM pragma_table_info('answers')"), strict=True
        )
    assert names == (
        *(
            "session",
            "part",
            "number",
            "goal",
            "slots",
            "actions",
            "made",
            "success",
            "seconds",
            "loads",
        ),
    )


def test_answers_are_read_while_they_are_served_and_afterwards(study, folder, answers):
    people = [begin(answers, study) for _ in range(3)]
    go_on(answers, study, people[1], 4)
    go_on(answers, study, people[0])
    given = {person.number: answers.answers_of(person) for person in people}
    served = read_study(folder)
    answers.close()
    with unchanged(folder):
        read = read_study(folder)
    assert sorted(contents(folder)) == FILES
    for found in (served, read):
        assert [len(session.answers) for session in found] == [6, 4, 0]
        assert [session.is_finished for session in found] == [True, False, False]
        for person, session in zip(people, found, strict=True):
            assert session.answers == given[person.number]
            assert (session.record, session.person) == (study.record, person)
        assert [line.session for line in lines_of(folder)] == [1] * 6 + [2] * 4
        assert [line.part for line in lines_of(folder)] == ["train"] * 3 + ["test"] * 3 + [
            "train"
        ] * 3 + ["test"]


@pytest.fixture
def killed(study, folder, answers, tmp_path):
    """The folder that a kill leaves after four answers and a task that was shown."""
    person = answers.begin("0" * 64, study.cells)
    go_on(answers, study, person, 4)
    answers.show(person, "test", 2, 200.0)
    return Path(shutil.copytree(folder, tmp_path / "killed"))


@pytest.mark.parametrize("has_index", [True, False])
def test_what_was_stored_is_there_after_a_kill(study, killed, has_index):
    if not has_index:
        (killed / f"{ANSWERS_FILE}-shm").unlink()
    stored = (killed / ANSWERS_FILE).read_bytes()
    assert [len(session.answers) for session in read_study(killed)] == [4]
    assert (killed / ANSWERS_FILE).read_bytes() == stored
    with closing(opened(killed)) as answers:
        person = answers.find("0" * 64)
        assert answers.shown(person, "test", 2) == 200.0
        go_on(answers, study, person)
    assert sorted(contents(killed)) == FILES
    assert read_study(killed)[0].is_finished


def test_a_withdrawn_answer_is_in_no_file_while_the_study_goes_on(study, folder, answers):
    leaves, stays = (answers.begin(code, study.cells) for code in ("0" * 64, "1" * 64))
    for person in (leaves, stays):
        go_on(answers, study, person)
    tables = {
        person: [task.table for task in study.tasks(person.cell)] for person in (leaves, stays)
    }
    private = [
        json.dumps(table, ensure_ascii=False)
        for table in tables[leaves]
        if table not in tables[stays]
    ]

    def found():
        return {
            text.encode() in b"".join(contents(folder).values()) for text in (*private, "0" * 64)
        }

    assert (len(private), found()) == (6, {True})
    answers.withdraw(leaves)
    assert found() == {False}


def test_a_folder_that_cannot_be_written_is_refused_at_the_start(folder, monkeypatch):
    connect = sqlite3.connect

    def read_only(path, **options):
        return connect(
            path if "uri" in options else f"{Path(str(path)).as_uri()}?mode=ro",
            **options | {"uri": True},
        )

    monkeypatch.setattr(sqlite3, "connect", read_only)
    with pytest.raises(ArtefactError, match="cannot be read or written"):
        opened(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tasks": 4}, "tasks_per_part 3, but this command has 4"),
        ({"distractors": (8, 1)}, r"distractors \[1, 8\], but this command has \[8, 1\]"),
        ({"forms": 3}, "forms 2, but"),
        ({"seed": 6}, "seed 5, but"),
        ({"consent": "Do you?"}, "another text"),
    ],
)
def test_a_study_with_other_settings_is_refused(kitchen, folder, changes, message):
    with unchanged(folder), pytest.raises(ConfigError, match=message):
        check_study_folder(folder, HumanStudy(kitchen, replace(SMALL, **changes)).record)


@pytest.mark.slow
def test_a_study_of_another_graph_or_split_is_refused(kitchen, folder):
    for other in ("everyday", other_world(kitchen, "split")):
        with pytest.raises(GraphMismatchError):
            check_study_folder(folder, HumanStudy(other, SMALL).record)


def test_what_is_no_study_is_refused_and_an_empty_folder_is_not(study, tmp_path):
    (tmp_path / "empty").mkdir()
    assert not check_study_folder(tmp_path / "empty", study.record)
    (tmp_path / "notes").write_text("mine")
    for path in (tmp_path / "notes", tmp_path):
        with pytest.raises(OutputExistsError):
            check_study_folder(path, study.record)
    for path in (tmp_path, tmp_path / "notes", tmp_path / "nowhere"):
        with pytest.raises(ArtefactError, match="expected the folder"):
            read_study(path)


RECORDS: dict[str, Any] = {
    "another format": lambda record: record | {"format": "wordcraft-kg study 1"},
    "a key more": lambda record: record | {"name": "somebody"},
    "a key less": lambda record: {key: value for key, value in record.items() if key != "seed"},
    "a negative seed": lambda record: record | {"seed": -1},
    "a hash that is none": lambda record: record | {"graph_hash": "x"},
    "no number of tasks": lambda record: record | {"settings": {}},
    "too many tasks": lambda record: (
        record | {"settings": record["settings"] | {"tasks_per_part": 10**9}}
    ),
    "a list": lambda record: [record],
}


def refuses_all(folder, *uses, match, kind=ArtefactError):
    """Check that each use of a folder is refused, and that nothing is changed."""
    for use in uses:
        with unchanged(folder), pytest.raises(kind, match=match):
            use(folder)


@pytest.mark.parametrize("change", RECORDS)
def test_a_damaged_record_is_refused(study, folder, change):
    path = folder / "study.json"
    path.write_text(json.dumps(RECORDS[change](json.loads(path.read_text()))))
    refuses_all(
        folder,
        read_study,
        lambda path: check_study_folder(path, study.record),
        match=r"study\.json is damaged",
    )


def spoil(data):
    middle = len(data) // 2
    return {
        "empty": b"",
        "a text": b"my notes\n" * 1_000,
        "cut off": data[: len(data) - 5_000],
        "half": data[:middle],
        "zeros within": data[:4_096] + bytes(4_096) + data[8_192:],
        "noise within": data[:200] + bytes(range(256)) * 15 + data[200 + 256 * 15 :],
        "no header": bytes(100) + data[100:],
    }


@pytest.mark.parametrize("damage", spoil(b""))
def test_a_damaged_database_is_refused_and_stays(study, folder, damage):
    take_part(folder, study)
    path = folder / ANSWERS_FILE
    path.write_bytes(spoil(path.read_bytes())[damage])
    refuses_all(folder, read_study, opened, match=r"sqlite is (damaged|not an answers database)")


def test_another_database_or_one_of_another_study_is_refused_and_stays(kitchen, folder):
    path, record = folder / ANSWERS_FILE, folder / "study.json"
    own = path.read_bytes()
    path.unlink()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE mine (thing TEXT)")
    refuses_all(folder, opened, match="not an answers database")
    path.write_bytes(own)
    record.write_text(record.read_text().replace('"seed": 5', '"seed": 6'))
    refuses_all(folder, opened, read_study, match="belongs to another study")


CHANGES = {
    "an answer is missing": "DELETE FROM answers WHERE part = 'train' AND number = 2",
    "a success that was none": "UPDATE answers SET success = 1 - success WHERE number = 1",
    "an action off the table": 'UPDATE answers SET actions = \'["gold", "gold"]\' WHERE number = 1',
    "no list": "UPDATE answers SET made = '3' WHERE number = 1",
    "no JSON": "UPDATE answers SET made = '[' WHERE number = 1",
    "negative seconds": "UPDATE answers SET seconds = -1 WHERE number = 1",
    "never loaded": "UPDATE answers SET loads = 0 WHERE number = 1",
    "another part": "UPDATE answers SET part = 'valid' WHERE number = 1 AND part = 'test'",
    "another condition": "UPDATE sessions SET distractors = 3",
    "nobody's answers": "PRAGMA foreign_keys = OFF; DELETE FROM sessions",
}


@pytest.mark.parametrize("change", CHANGES)
def test_answers_that_cannot_be_are_refused(study, folder, change):
    take_part(folder, study)
    with closing(sqlite3.connect(folder / ANSWERS_FILE)) as connection:
        connection.executescript(CHANGES[change])
    with pytest.raises(ArtefactError, match="is damaged"):
        read_study(folder)


def test_a_database_that_was_not_finished_is_made_again(study, folder):
    (folder / ANSWERS_FILE).unlink()
    (folder / f".{ANSWERS_FILE}.new").write_bytes(b"half")
    take_part(folder, study, 1)
    assert sorted(contents(folder)) == FILES


@pytest.fixture(scope="module")
def protocol(kitchen):
    return HumanProtocol(kitchen)


def test_a_session_is_40_train_tasks_and_then_40_test_tasks():
    assert schedule() == tuple(
        (part, number) for part in ("train", "test") for number in range(1, 41)
    )


def test_the_tasks_of_a_seed_stay_as_begun_studies_have_them(protocol):
    tasks = [protocol.task(0, *turn) for turn in schedule()]
    assert hashlib.sha256(repr(tasks).encode()).hexdigest()[:16] == "a6753666bfba1141"
    for task in tasks:
        world = protocol.world.variant(part=task.part)
        start = {*world.tasks[task.index].start}
        assert len({*task.table}) == len(task.table) == world.num_given
        assert start <= {*task.table} - {task.goal}


def test_an_answer_is_what_an_environment_says_of_the_same_picks(protocol):
    outcomes = set()
    for part, number in schedule():
        task = protocol.task(0, part, number)
        parts = [task.table.index(label) for label in task.plans[0][:2]]
        for slots in ((0, 1), (number % 10, 0), (4, 4), (parts[0], parts[1])):
            env, _ = posed(protocol, 0, part, number)
            env.step(slots[0])
            *_, info = env.step(slots[1])
            answer = protocol.answer(task, slots, 1.23456)
            assert (answer.part, answer.number, answer.goal, answer.table) == (
                part,
                number,
                task.goal,
                task.table,
            )
            assert answer.actions == tuple(task.table[slot] for slot in slots)
            assert answer.success == (info["outcome"] == "goal")
            assert set(answer.made) >= set(env.world.graph.labels(env.state.table[10:]))
            assert answer.seconds == 1.23
            outcomes.add((answer.success, bool(answer.made)))
    assert outcomes == {(True, True), (False, True), (False, False)}


def test_episode_seeds_differ_by_seed_part_and_number_and_never_change():
    keys = [
        (seed, part, number)
        for seed in (0, 1, 2**40)
        for part in ("train", "test")
        for number in range(1, 41)
    ]
    assert len({episode_seed(*key) for key in keys}) == len(keys)
    golden = {(0, "train", 1): 3613627650, (0, "test", 1): 1321936645, (1, "train", 40): 264182322}
    assert {key: episode_seed(*key) for key in golden} == golden


def test_the_record_and_an_answer_have_nothing_about_people(study, protocol, kitchen):
    settings = {"tasks_per_part": 3, "depth": 1, "attempts": 1, "distractor_weighting": "use"}
    assert study.record.settings == settings
    assert study.record.graph_hash == kitchen.hash
    assert study.record.split_hash == make_split(kitchen, SplitConfig()).hash
    answer = protocol.answer(protocol.task(0, "train", 1), (0, 1), 1.5)
    assert list(as_values(answer)) == [
        "part",
        "number",
        "goal",
        "table",
        "actions",
        "made",
        "success",
        "seconds",
        "loads",
    ]
