"""The command line as a whole: how it answers misuse and failure, what it shows meanwhile,
completion."""

import errno
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import in_file, write_graph

from wordcraft_kg.cli import ALL, CORE, command_in, make_app, manual_of
from wordcraft_kg.cli.console import aligned, lines_of
from wordcraft_kg.cli.failures import OPTIONS, with_options
from wordcraft_kg.cli.options import Force
from wordcraft_kg.runs.progress import ProgressBar, Stages
from wordcraft_kg.runs.record import end_run, start_run

HELPED = ["train-complex", "train-links", "train-agent", "score"]
"""Commands whose help has the settings of models."""


@pytest.mark.parametrize(
    ("arguments", "error", "usage"),
    [
        ("evaluate-links", "a value for MODEL is missing", "evaluate-links MODEL"),
        ("score", "a value for MODEL is missing", "score MODEL QUERY..."),
        (
            "export kitchen",
            "a value for --format is missing",
            "export GRAPH --format FORMAT --out OUT",
        ),
        (
            "build-graph kitchen --train-ratio",
            "a value for --train-ratio is missing",
            "build-graph [BOOK]",
        ),
        ("train-complex", "a value for GRAPH is missing", "train-complex GRAPH"),
        ("compare --no-such", "Unknown option: --no-such", "compare RUNS..."),
        (
            "train-complex kitchen --epoch 3",
            "Unknown option: --epoch. Did you mean --epochs?",
            "train-complex GRAPH",
        ),
        ("describe kitchen everyday", "unexpected argument 'everyday'", "describe GRAPH"),
    ],
)
def test_misuse_is_said_plainly_with_usage_and_an_example(refused, arguments, error, usage):
    message, *hints = refused(*arguments.split(), code=2).splitlines()
    assert message.startswith(f"error: {error}")
    example = manual_of(arguments.split()[0]).examples[0]
    assert hints == [f"usage:   wordcraft-kg {usage} [OPTIONS]", f"example: {example}"]


@pytest.mark.parametrize(
    "value", ["--epochs many", "--kg half", "--seed 1.5", "--folds 0.0", "--dim 1e0"]
)
def test_a_value_of_the_wrong_kind_is_misuse(refused, value):
    name, given = value.split()
    refused(
        "train-complex", "kitchen", name, given, says=["Invalid value", name, f'"{given}"'], code=2
    )


TRAININGS = '"train-recipes", "train-complex", "train-links", or "train-agent"'


@pytest.mark.parametrize(
    ("name", "nearest"), [("train", TRAININGS), ("build-grap", '"build-graph"')]
)
def test_an_unknown_command_is_refused_with_the_nearest_ones(refused, name, nearest):
    error, *hints = refused(name, "kitchen", code=2, kind="UnknownCommandError").splitlines()
    assert error.startswith(f'error: Unknown command "{name}". Did you mean {nearest}')
    assert hints == ["`wordcraft-kg --help` lists all commands."]


@pytest.mark.parametrize(
    ("arguments", "code", "kind"),
    [
        ("nowhere", 1, "RecipeFileError"),
        ("", 2, "MissingArgumentError"),
        ("kitchen --entity x -q", 1, "UnknownEntityError"),
    ],
)
def test_a_failure_with_json_is_one_object_on_stdout_that_names_its_kind(
    run, home, arguments, code, kind
):
    command = ("describe", *arguments.split(), "--json")
    outcome = run(*command)
    assert (outcome.code, outcome.out.count("\n")) == (code, 1)
    error = json.loads(outcome.out)["error"]
    assert error["kind"] == kind
    assert f"error: {error['message']}" in outcome.err
    assert not {kind, "Traceback"} & set(re.split(r"\W", outcome.err))
    verbose = run(*command, "-v").err
    assert verbose.startswith("Traceback") == (code == 1)
    assert f"error: {error['message']}" in verbose


def test_settings_in_errors_are_named_as_the_command_takes_them():
    message = "Give the right one as `graph`, or other `num_distractors`."
    assert with_options(message) == "Give the right one as --graph, or other --distractors."
    assert (
        with_options(message, manual_of("describe"))
        == "Give the right one as GRAPH, or other --distractors."
    )


def test_the_start_page_lists_every_command_and_help_imports_no_torch():
    code = """
import sys
from wordcraft_kg.cli import main
print(main(["--help"]))
for name in sys.argv[1:]:
    main([name, "--help"])
    print("imported:", name, "torch" in sys.modules)
"""
    command = [sys.executable, "-c", code, *HELPED]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    lines = done.stdout.splitlines()
    assert [f"imported: {name} False" in lines for name in HELPED] == [True] * len(HELPED)
    page = "\n".join(lines[: lines.index("0")])
    assert all(f" {name.split()[0]} " in page for name in ALL)


def test_every_help_has_usage_examples_and_at_most_thirty_options(run):
    """One test renders all helps: rendering costs most, and each check needs all of them."""
    option = re.compile(r"^│ (?:\*  |   )?(--[a-z0-9-]+)", re.MULTILINE)
    core = [name for names in CORE.values() for name in names]
    forced = set()
    for name in ALL:
        outcome = run(*name.split(), "--help")
        assert (outcome.code, outcome.err) == (0, ""), name
        usage = outcome.out.splitlines()[0]
        assert re.fullmatch(rf"Usage: wordcraft-kg {name}\b(?!.*ARGS).*\[OPTIONS\]", usage), name
        # Arguments are shown by their place alone.
        assert not re.search(r"│[ *]+[A-Z_]+ --", outcome.out), name
        assert len(manual_of(name).examples) >= 2, name
        # As a shell joins lines.
        text = " ".join(outcome.out.replace("\\\n", "").split())
        assert all(example in text for example in (*manual_of(name).examples, "--json")), name
        shown = option.findall(outcome.out)
        assert len(shown) <= 30, name
        assert not set(manual_of(name).file_only) & set(shown), name
        if "--force" in outcome.out:
            forced.add(name)
            if name in core or name.split()[0] in ("people", "explore"):
                meant = Force.__metadata__[-1].help
                assert meant in " ".join(outcome.out.split()), name
    assert forced >= {"build-graph", "train-agent", "compare", "score", "export"}


def test_options_that_no_guide_needs_are_named_for_the_file_alone(run):
    text = " ".join(run("train-agent", "--help").out.split())
    assert "Further settings, by --config FILE in a table [train-agent]: baseline_cost," in text
    assert " clip, " in text
    assert "--clip" not in text


EXAMPLES = [(name, example) for name in ALL for example in manual_of(name).examples]


@pytest.mark.parametrize(("name", "example"), EXAMPLES)
def test_every_example_is_one_of_our_commands_and_parses(name, example):
    program, *tokens = shlex.split(example)
    assert program == "wordcraft-kg"
    command, bound, _ = make_app().parse_args(tokens, exit_on_error=False, print_error=False)
    named = command_in(tokens)
    assert command is manual_of(named).function
    assert bound.args or bound.kwargs or tokens == named.split()
    assert named == name or any(other.startswith(f"wordcraft-kg {name}") for _, other in EXAMPLES)


def test_an_example_that_is_copied_from_a_narrow_terminal_is_one_command(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    help_text = run("evaluate-agent", "--help").out
    lines = help_text.partition("Examples:\n\n")[2].partition("\n\n")[0]
    assert "\\\n" in lines
    # As a shell joins lines.
    commands = lines.replace("\\\n", "").splitlines()
    examples = manual_of("evaluate-agent").examples
    assert list(map(shlex.split, commands)) == list(map(shlex.split, examples))


@pytest.mark.parametrize(
    ("rows", "numbers", "lines"),
    [
        ([("a", "1"), ("long", "22")], False, ["a     1", "long  22"]),
        ([("a", "1"), ("long", "22")], True, ["a      1", "long  22"]),
        ([("a", "", "x"), ("b", "", "y")], False, ["a  x", "b  y"]),
        ([("a",), ("b", "y")], False, ["a", "b  y"]),
        ([], False, []),
    ],
)
def test_tables_have_aligned_columns_and_no_empty_ones(rows, numbers, lines):
    assert aligned(rows, numbers=numbers) == lines


def test_a_file_sets_the_options_of_its_own_command_line_alone(refused, put):
    """The application is kept between command lines; the last file's options must not stay."""
    config = put("[describe]\nseed = 1.5\n", "odd.toml")
    refused("describe", "kitchen", "--config", config, says="unable to convert", code=2)
    _, bound, _ = make_app().parse_args(["describe", "kitchen"], exit_on_error=False)
    assert "seed" not in bound.arguments


@pytest.mark.parametrize(
    "name", ["train-complex", "bench run", "mcp", "describe", "build-graph", "people serve"]
)
def test_a_nul_character_in_an_option_or_a_config_file_is_refused(refused, tmp_path, name):
    refused(
        *name.split(),
        "kitchen",
        "--out",
        "\0",
        says=r"holds a NUL character. Remove this character.",
    )
    refused(
        *name.split(),
        "kitchen",
        "--config",
        "a\0b",
        says=r"holds a NUL character. Remove this character.",
    )
    for value in ('"\\u0000"', '["a", "b\\u0000"]', '{ c = "\\u0000" }'):
        (tmp_path / "nul.toml").write_text(f"[{name.replace(' ', '.')}]\nout = {value}\n")
        says = f"--config {tmp_path / 'nul.toml'}: "
        assert "NUL" in refused(
            *name.split(), "kitchen", "--config", tmp_path / "nul.toml", says=says
        )


def test_torch_without_memory_is_an_error_in_a_sentence(refused, monkeypatch):
    def fail(*_):
        raise RuntimeError(
            "[enforce fail at alloc_cpu.cpp:127] DefaultCPUAllocator: can't allocate memory: you "
            "tried"
        )

    monkeypatch.setattr("wordcraft_kg.cli.graphs.open_graph", fail)
    assert refused("describe", "kitchen", kind="MemoryError").count("\n") == 1


def test_a_command_of_two_words_runs_and_the_first_alone_lists_all(run):
    listed = run("people")
    assert (listed.code, listed.err) == (0, "")
    assert re.findall(r"(serve|summary)  +", listed.out) == ["serve", "summary"]
    examples = [example for name, example in EXAMPLES if name.startswith("people ")]
    assert all(example in listed.out for example in examples)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[people.summary]\nexport = 'answers'\n[describe]\n", "--export takes one folder"),
        ("[people.serve]\n", "no table [people.summary]; found people. Put the options"),
        *(
            (text, "no table [people.summary]; found people.")
            for text in (
                "[people.sew]\nrows = 4\n",
                "people = 1\n",
                "[people]\nrows = 4\n",
                "people.summary = 1\n",
            )
        ),
    ],
)
def test_a_command_of_two_words_takes_its_options_from_a_table_in_a_table(
    refused, tmp_path, text, says
):
    (tmp_path / "options.toml").write_text(text)
    refused(
        "people", "summary", "--config", tmp_path / "options.toml", says=says, kind="ConfigError"
    )


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A folder of each kind, by name; a run's has nothing but its record."""
    root = tmp_path_factory.mktemp("folders")
    write_graph(root / "graph")
    for name, kind in (("agent", "train-agent"), ("model", "train-complex")):
        (root / name).mkdir()
        end_run(root / name, start_run(root / name, kind), "done")
    files = {
        "report": "report.json",
        "words": "games.jsonl",
        "own": "chapter.tex",
        "damaged": "run.json",
    }
    for name, file in files.items():
        (root / name).mkdir()
        (root / name / file).write_text("{}")
    (root / "empty").mkdir()
    (root / "file").touch()
    return root


IS = {
    "graph": "is a graph folder",
    "agent": "was written by train-agent",
    "model": "was written by train-complex",
    "report": "is the folder of a report",
    "words": "is the folder of a text agent",
    "own": "has none of graph.json, run.json, report.json, sets.json, site.json, submission.json",
    "empty": "is an empty folder",
    "file": "is a file",
    "nothing": "does not exist",
}

RUN = "expected a run of train-agent"

MODEL = "expected a model folder from train-complex, train-links or train-recipes"


@pytest.mark.parametrize(
    ("command", "taken", "expected"),
    [
        ("explain {}", ["agent"], RUN),
        (
            "evaluate-agent {}",
            ["agent", "graph", "file", "nothing"],
            RUN,
        ),  # it takes a graph and a book too
        ("compare {}", ["agent", "model"], "expected a run of an agent or a link predictor"),
        ("score {} flour combinesWith water", ["model"], MODEL),
        ("evaluate-links {}", ["model"], MODEL),
        ("train-agent kitchen --scorer {}", ["model"], MODEL),
        ("evaluate-agent kitchen --scorer {}", ["model"], MODEL),
        ("discover kitchen --scorer {}", ["model"], MODEL),
    ],
)
def test_the_wrong_kind_of_folder_is_named(refused, folders, command, taken, expected):
    for name in IS.keys() - taken:
        path = str(folders / name)
        error = refused(*command.replace("{}", path).split(), kind="ArtefactError")
        assert error == f"error: '{path}' {IS[name]}; {expected}.\n"


@pytest.mark.parametrize("command", ["describe", "train-complex", "build-graph", "check-book"])
def test_other_folders_are_not_taken_for_graphs(refused, folders, command):
    for name in ("agent", "model", "report", "own", "empty"):
        refused(command, folders / name, says=f"error: '{folders / name}' {IS[name]}; expected a ")
    refused("explain", folders / "damaged", says="run.json is damaged")
    refused(command, folders / "damaged", says="whose run.json is damaged; expected a ")


@pytest.mark.parametrize("command", ["build-graph", "train-complex"])
def test_force_is_not_advised_where_it_would_not_help(refused, folders, command):
    for options in ([], ["--force"]):
        own = (command, "kitchen", "--out", folders / "own", *options)
        refused(*own, kind="OutputExistsError", says="not replaced, even with --force")
    refused(command, "kitchen", "--out", folders / "report", says="or replace it with --force.\n")


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("describe ", ["everyday", "everyday-1", "kitchen", "paper-examples", "own.csv", "graph"]),
        (
            "describe {}/",
            ["everyday", "everyday-1", "kitchen", "paper-examples", "{}/own.csv", "{}/graph"],
        ),
        ("books --fetch ", ["little-alchemy-2", "infinite-craft", "inorganic-synthesis"]),
    ],
)
def test_books_and_paths_are_offered(run, home, monkeypatch, words, offered):
    folder = home / "here"
    for name in ("graph", ".hidden"):
        (folder / name).mkdir(parents=True)
    (folder / "own.csv").touch()
    monkeypatch.chdir(folder)
    lines = (
        run("__complete", *words.format(folder).split(" "))
        .out.split("\n\x1fbegin\n")[1]
        .splitlines()
    )
    assert set(lines) == {name.format(folder) for name in offered}


"""What is added to examples that would take minutes; recipe scorers are trained on the smaller
book, too."""

"""Commands whose examples need nothing but the files of earlier examples; play needs a player."""


BAD_VALUES = {
    "build-graph kitchen": [
        *(f"--train-ratio={bad}" for bad in (0.0, 1.0, "nan", -0.5, "inf")),
        *("--base=", "--base=,", "--base= , ", "--seed=-1"),
    ],
    "describe kitchen --tasks": [
        "--depth=0",
        "--depth=50",
        "--distractors=-1",
        "--distractors=500",
        "--limit=-1",
        "--seed=-1",
    ],
    "evaluate-agent kitchen": [
        *(f"--distractors={bad}" for bad in ("x", "", -1, 80)),
        *("--seed=-1", "--depth=0", "--distractor-seeds=0", "--limit=0"),
    ],
    "evaluate-agent {world}/plain/seed-0": [
        "--distractor-seeds=0",
        "--distractors=many",
        "--depth=2",
    ],
    "evaluate-agent {world}/graph": ["--graph=kitchen"],
    "explain {world}/plain/seed-0": ["--episodes=0"],
    "discover kitchen": [
        *(
            "--players=gredy",
            "--players=,",
            "--attempts=0",
            "--runs=0",
            "--seed=-1",
            "--base=moonstone",
            "--base=,",
        )
    ],
    "train-agent kitchen": [
        *(
            "--distractors=500",
            "--distractors=-1",
            "--seed=18446744073709551616",
        ),
        *(
            "--learning-rate=nan",
            "--learning-rate=1e300",
            "--features=glov",
            "--device=cuda:77",
            "--device=abacus",
        ),
        *("--depth=9", "--use=u", "--kg-only", "--mixing=softmax"),
    ],
    "train-complex kitchen": [
        *(
            "--epochs=0",
            "--n3=-1",
        ),
        *("--device=nonsense", "--seeds=4-0"),
    ],
    "train-links kitchen": ["--model=rotat", "--model=complex", "--model=ComplEx"],
    "score {trained}/one ? componentOf bread": ["--top=0", "--top=-1"],
    "compare {trained}/one {trained}/two": [
        "--distractor-seeds=3",
    ],
    "reproduce knowledge": ["--seeds=0"],
    "reproduce embeddings --book kitchen": ["--jobs=0"],
    "reproduce study.toml": ["--book=kitchen"],
    "reproduce --list": ["--book=kitchen"],
    "reproduce --show": ["--seeds=2"],
}


@pytest.fixture
def empty(home, trained, world, monkeypatch):
    """Work in an empty folder; return the words of a command line."""
    (home / "empty").mkdir()
    monkeypatch.chdir(home / "empty")
    sets = Path(__file__).parents[2] / "examples" / "kitchen-sets.csv"
    places = {"trained": trained, "world": world, "sets": sets}
    places["huge"] = in_file("train-agent", unroll=2**24, batch_size=2**24)[1]
    return lambda line: [word.format(**places) for word in shlex.split(line)]


@pytest.mark.parametrize(
    ("command", "option"), [(line, bad) for line, values in BAD_VALUES.items() for bad in values]
)
def test_a_bad_value_is_one_line_that_names_the_option(run, empty, home, command, option):
    outcome = run(*empty(command), option)
    name = option.partition("=")[0]
    assert (outcome.code, outcome.out, outcome.kind) == (1, "", "ConfigError")
    assert f"--{OPTIONS.get(outcome.setting, outcome.setting)}".replace("_", "-") == name
    assert outcome.err.startswith(f"error: {name} ") or outcome.err.startswith(f"error: {name}:")
    assert outcome.err.count("\n") == 1
    assert not list((home / "empty").iterdir())


REFUSED = [
    (
        "describe evryday --tasks",
        "'evryday' is neither a file nor a known book. Did you mean 'everyday'",
    ),
    ("describe kitchen --tasks --part valid", "kitchen has no task of depth 1 in the valid part"),
    ("check-book nowhere", "'nowhere' is neither a file nor a known book"),
    ("check-book evryday", "Did you mean 'everyday'"),
    ("evaluate-agent kitchn", "Did you mean 'kitchen'"),
    ("evaluate-agent kitchen --part valid", "kitchen has no task of depth 1 in the valid part"),
    ("evaluate-agent kitchen --scorer nowhere", "nowhere"),
    ("evaluate-agent nothing", "is neither a file nor"),
    ("evaluate-agent {world}/scorer", "written by train-complex; expected a run of train-agent"),
    ("evaluate-agent {world}/plain/seed-0 --graph paper-examples", "was trained on graph"),
    ("evaluate-agent {world}/plain/seed-0 --part valid", "valid"),
    ("evaluate-links {world}/plain/seed-0", "written by train-agent; expected a model"),
    ("explain {world}/plain/seed-0 --goal spaceship", "no entity 'spaceship'"),
    ("compare {world}/plain {world}/many", "plays with max_attempts"),
    ("compare", "needs run folders"),
    ("compare {world}/plain {world}/plain", "the same settings and seed"),
    ("compare {world}/plain {world}/scorer", "expected a run of train-agent"),
    ("compare {world}/scorer", "two link predictors or more"),
    ("compare {trained}/graph", "is a graph folder"),
    ("discover kitchen --players recipe-learner", "needs a --scorer"),
    ("discover kitchen --scorer nowhere", "nowhere"),
    ("discover {sets}", "-> pesto has 6 ingredients; the open-ended world"),
    ("discover everyday --scorer {trained}/one", "expected a model from train-recipes"),
    ("train-agent kitchen --scorer nowhere", "does not exist"),
    ("train-agent paper-examples --scorer {trained}/one", "was trained on graph"),
    (
        "train-agent kitchen --config {huge}",
        "281,474,976,710,656 steps would take",
    ),
    ("train-complex kitchen --seeds 0-1 --seed 3", "--seed 3 and --seeds 0-1 cannot be combined"),
    ("train-complex kitchen --seeds 0,4294967296", "--seed 4294967296"),
    ("books --fetch little-alchemy-3", "Did you mean 'little-alchemy-2'?"),
    ("describe kitchen --entity bred", "no entity 'bred' in kitchen. Did you mean 'bread'?"),
    ("score {trained}/one bred componentOf flour", "'bread'"),
    ("score {trained}/one flour componentOf bred", "'bread'"),
    ("score {trained}/one flour combineWith water", "'combinesWith'"),
    ("score {trained}/one ? componentOf ?", "has several open slots"),
    ("score {trained}/one ? componentOf", "has several open slots"),
    ("score {trained}/one", "--in"),
    ("score {trained}/one flour", "cannot parse query 'flour'"),
    ("score {trained}/one flour combinesWith --in x.csv", "--in"),
    ("score {trained}/one flour combinesWith --out x", "--in"),
    ("score {trained}/one --in {trained}", "is not a file"),
    ("score {trained}/one 'flour + water'", "train-recipes"),
    ("reproduce", "needs a study"),
    ("reproduce knowlege", "Did you mean 'knowledge'"),
    ("reproduce knowledge --book nowhere", "nowhere"),
    ("reproduce knowledge --book kitchen,./kitchen", "two books are called 'kitchen'"),
    ("reproduce no-such-study.toml", "no such file"),
    ("reproduce --show --out nothing", "is not a results folder"),
    ("reproduce --show nothing.json", "nothing.json"),
    ("reproduce --show study.toml --out {trained}", "is not a results folder"),
    ("describe \udcff", "\\udcff' is not UTF-8. Rename the file or folder"),
    (
        "export kitchen --format=tsv --out=\udcff",
        "\\udcff' is not UTF-8. Rename the file or folder",
    ),
]


@pytest.mark.parametrize(("command", "says"), REFUSED)
def test_what_a_command_cannot_do_is_one_line_that_says_why(refused, empty, home, command, says):
    assert refused(*empty(command), says=says).count("\n") == 1
    assert not list((home / "empty").iterdir())


TORN = {
    "build-graph kitchen": (1, 2, 5, 8),
    "train-complex kitchen --dim 8 --epochs 3 --n3 0.1 --folds 2": (1, 4, 6, 14),
    "train-agent kitchen --steps 320 --eval-every 160 --config {often}": (
        1,
        4,
        9,
        16,
    ),
}


def each_write():
    """Yield commands and numbers of a write that fails: of two commands the last is fast, and of
    one the first; an agent trains for a second."""
    first = next(iter(TORN))
    for line, writes in TORN.items():
        for write in writes:
            is_last = write == writes[-1] and "agent" not in line
            is_fast = is_last or (line == first and write == writes[0])
            yield pytest.param(line, write, marks=() if is_fast else pytest.mark.slow)


@pytest.mark.parametrize(
    "number", [errno.ENOSPC, pytest.param(errno.EROFS, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(("command", "write"), list(each_write()))
def test_a_full_disk_is_one_line_and_the_command_goes_on(
    run, refused, home, monkeypatch, command, write, number
):
    """A disk that takes no more files is one line and the same command goes on."""
    opened, made = Path.open, []

    def fail_late(path, mode="r", **options):
        if mode == "xb":
            made.append(path)
            if len(made) >= write:
                raise OSError(number, os.strerror(number), "disk")
        return opened(path, mode, **options)

    often = in_file("train-agent", batch_size=16, checkpoint_every=160)[1]
    command = (*command.format(often=often).split(), "--out", home / "out", "--quiet")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", fail_late)
        error = refused(*command, says=os.strerror(number))
    assert error.count("\n") == 1
    assert ("Nothing was changed" in error) == (list(home.iterdir()) == [])
    assert run(*command).code == 0


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_result_that_stdout_does_not_take_fails_and_the_message_is_true(tmp_path, options):
    command = [sys.executable, "-m", "wordcraft_kg", "build-graph", "kitchen", "--out", "graph"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*command, *options],
            stdout=full,
            stderr=subprocess.PIPE,
            cwd=tmp_path,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "could not be printed on stdout (No space left on device)" in done.stderr
    assert "Nothing was changed" not in done.stderr
    assert (tmp_path / "graph" / "graph.json").is_file()


@pytest.mark.slow
def test_help_ends_at_any_width_of_the_terminal():
    script = """
import os
from wordcraft_kg.cli import main
for width in (0, 1, 7, 19, 20):
    os.environ["COLUMNS"] = str(width)
    for words in (["--help"], ["describe", "--help"], ["train-agent", "--help"]):
        assert main(words) == 0
"""
    # In a process of its own: a table that never ends would stop all tests.
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr


SIGNS = "water,fire,\U0001f525\n\U0001f525,water,\u03bb\n\u03bb,fire,steam\n"


@pytest.mark.parametrize(
    "encoding",
    [
        pytest.param("cp1252", marks=pytest.mark.slow),
        "ascii",
        pytest.param("utf-8", marks=pytest.mark.slow),
        pytest.param("utf-16", marks=pytest.mark.slow),
    ],
)
def test_stdout_in_any_encoding_has_the_whole_result(tmp_path, encoding):
    book = tmp_path / "book.csv"
    text = f"ingredient_a,ingredient_b,result\n{SIGNS}"
    book.write_text(text, encoding="utf-8")

    commands = (
        (str(book), "--entity", "steam", "--json"),
        ("\u03bb.csv", "--json"),
        (str(book), "--entity", "steam"),
    )
    code = """
import json, sys
from wordcraft_kg.cli import main
for words in json.loads(sys.argv[1]):
    print(main(["describe", *words]))
"""
    # A process of its own: the encoding of stdout is set at its start.
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(commands)],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
        timeout=60,
    )
    assert b"Traceback" not in done.stderr
    result, code, error, wrong, *text = done.stdout.decode(encoding).splitlines()
    assert (code, wrong, text.pop()) == ("0", "1", "0")
    assert {"\u03bb", "\U0001f525"} <= set(re.findall(r"[^ -~]", str(json.loads(result))))
    assert "\u03bb.csv" in json.loads(error)["error"]["message"]
    is_unicode = encoding.startswith("utf")
    out = "\n".join(text)
    assert ("\u03bb" if is_unicode else r"\u03bb") in out
    assert ("\U0001f525" if is_unicode else r"\U0001f525") in out


def test_lists_of_labels_quote_those_with_commas():
    values = {
        "base": ["water", "salt, pepper"],
        "most_used": [{"label": "a, b", "uses": 1_200}],
        "path": "one, two",
    }
    assert lines_of(values) == [
        "base       water, 'salt, pepper'",
        "most used  'a, b': 1,200",
        "path       one, two",
    ]


METRICS = {"success": 0.9407, "test_success": 0.3175, "steps_per_second": 12_439.0}


@pytest.fixture
def terminal(monkeypatch):
    """Make stderr look like a terminal of some columns; return how to read what was drawn, without
    colours."""
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in (("TERM", "xterm"), ("TTY_COMPATIBLE", "1"), ("TTY_INTERACTIVE", "1")):
        monkeypatch.setenv(name, value)

    def frames(text):
        return [
            line
            for line in re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text))
            if line.strip()
        ]

    return frames


@pytest.fixture
def at_once(monkeypatch):
    """Show every step, however soon it comes after the last one."""
    monkeypatch.setattr(ProgressBar, "INTERVAL", 0.0)
    monkeypatch.setattr(Stages, "INTERVAL", 0.0)


@pytest.mark.parametrize(("width", "num_figures"), [(80, 1), (120, 3), (200, 3)])
def test_a_training_bar_has_room_and_figures_beside_it(
    terminal, capsys, monkeypatch, width, num_figures
):
    monkeypatch.setenv("COLUMNS", str(width))
    with ProgressBar.session():
        progress = ProgressBar("agent", unit="step")
        for done in (9_984, 1_500_000, 3_000_000):
            progress(done, 3_000_000, METRICS)
    last = terminal(capsys.readouterr().err)[-1]
    assert len(last.rstrip()) <= width
    assert len(re.findall("[━╸╺]", last)) == 16
    assert "3,000,000/3,000,000" in last
    shown = ["success 0.9407", "test success 0.3175", "steps per second 12,439"][:num_figures]
    assert "  ".join(shown) in last


@pytest.mark.parametrize(
    ("command", "stages"),
    [
        (
            ["build-graph", "kitchen", "--out", "{home}/graph"],
            ["reading the book", "writing the graph folder"],
        ),
        (["describe", "kitchen"], ["auditing the graph"]),
        (
            ["export", "kitchen", "--format", "tsv", "--out", "{home}/out.tsv"],
            ["writing the export"],
        ),
        (["check-book", "kitchen"], ["checking the book"]),
        (["describe", "kitchen", "--tasks", "--depth", "2"], ["finding tasks"]),
        (
            ["discover", "kitchen", "--runs", "2", "--attempts", "5"],
            ["playing random-no-repeat: 1 of 2", "playing greedy"],
        ),
        pytest.param(
            ["evaluate-agent", "kitchen"],
            ["playing recipe oracle, 8 distractors: 4 of 5"],
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda value: value[0],
)
def test_commands_name_their_stages_on_stderr_and_are_silent_with_quiet(
    run, home, at_once, command, stages
):
    command = [part.replace("{home}", str(home)) for part in command]
    force = ["--force"] if "--out" in command else []
    outcome = run(*command, "--json")
    assert outcome.code == 0
    assert outcome.out.count("\n") == 1
    json.loads(outcome.out)
    for stage in stages:
        assert f"\n{stage}" in f"\n{outcome.err}"
    assert run(*command, *force, "--quiet").err == ""
