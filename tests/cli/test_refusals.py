"""Bad input to any command: one sentence that names the setting, exit code 1, and nothing is written."""

import errno
import os
import shlex
import tempfile

import pytest

from wordcraft_kg.cli.failures import OPTIONS

BAD_VALUES = {
    "build-graph kitchen": [
        *(f"--train-ratio={bad}" for bad in (0.0, 1.0, "nan", -0.5, "inf")),
        *("--base=", "--base=,", "--base= , ", "--seed=-1"),
    ],
    "check-book kitchen": ["--limit=-1"],
    "tasks kitchen": ["--depth=0", "--depth=50", "--distractors=-1", "--distractors=500", "--limit=-1", "--seed=-1"],
    "evaluate-agent kitchen": [
        *(f"--distractors={bad}" for bad in ("x", "", -1, 80)),
        *("--seed=-1", "--depth=0", "--distractor-seeds=0"),
    ],
    "evaluate-agent {world}/plain/seed-0": ["--distractor-seeds=0", "--distractors=many", "--depth=2"],
    "evaluate-agent {world}/graph": ["--agent=oracle"],
    "explain {world}/plain/seed-0": ["--episodes=0"],
    "discover kitchen": [
        *("--players=gredy", "--players=,", "--attempts=0", "--runs=0", "--seed=-1", "--base=moonstone", "--base=,")
    ],
    "train-agent kitchen": [
        *("--distractors=500", "--distractors=-1", "--unroll=0", "--discount=1.5", "--seed=18446744073709551616"),
        *("--learning-rate=nan", "--learning-rate=1e300", "--features=glov", "--device=cuda:77", "--device=abacus"),
        *("--depth=9", "--use=u", "--kg-only", "--mixing=softmax"),
    ],
    "train-complex kitchen": [
        *("--epochs=0", "--patience=3", "--learning-rate=nan", "--learning-rate=-1", "--n3=-1", "--eval-every=2"),
        *("--device=nonsense", "--seeds=4-0"),
    ],
    "train-links kitchen": ["--model=rotat", "--model=complex", "--model=ComplEx"],
    "score {trained}/one ? componentOf bread": ["--top=0", "--top=-1"],
    "compare {trained}/one {trained}/two": ["--resamples=0", "--resamples=-5", "--distractor-seeds=3"],
    "compare {world}/plain": ["--resamples=3"],
    "reference kitchen": ["--distractors=x", "--distractors=79", "--depth=0", "--base=water"],
    "reproduce knowledge": ["--seeds=0", "--metric=mrr"],
    "reproduce embeddings --book kitchen": ["--jobs=0", "--address=auto"],
    "reproduce study.toml": ["--book=kitchen"],
    "reproduce --list": ["--book=kitchen"],
    "reproduce --show": ["--seeds=2"],
}


@pytest.fixture
def empty(home, trained, world, monkeypatch):
    """Work in an empty folder; return the words of a command line."""
    (home / "empty").mkdir()
    monkeypatch.chdir(home / "empty")
    return lambda line: [word.format(trained=trained, world=world) for word in shlex.split(line)]


@pytest.mark.parametrize(("command", "option"), [(line, bad) for line, values in BAD_VALUES.items() for bad in values])
def test_a_bad_value_is_one_line_that_names_the_option(run, empty, home, command, option):
    outcome = run(*empty(command), option)
    name = option.partition("=")[0]
    assert (outcome.code, outcome.out, outcome.kind) == (1, "", "ConfigError")
    assert f"--{OPTIONS.get(outcome.setting, outcome.setting)}".replace("_", "-") == name
    assert outcome.err.startswith(f"error: {name} ") or outcome.err.startswith(f"error: {name}:")
    assert outcome.err.count("\n") == 1
    assert not list((home / "empty").iterdir())


REFUSED = [
    ("tasks evryday", "'evryday' is neither a file nor a known book. Did you mean 'everyday'"),
    ("tasks kitchen --part valid", "kitchen has no task of depth 1 in the valid part"),
    ("check-book nowhere", "'nowhere' is neither a file nor a known book"),
    ("check-book kitchen --against evryday", "Did you mean 'everyday'"),
    ("evaluate-agent kitchn", "Did you mean 'kitchen'"),
    ("evaluate-agent kitchen --part valid", "kitchen has no task of depth 1 in the valid part"),
    ("evaluate-agent kitchen --scorer nowhere", "nowhere"),
    ("evaluate-agent nothing", "is neither a file nor"),
    ("evaluate-agent {world}/scorer", "written by train-complex; expected a run of train-agent"),
    ("evaluate-agent {world}/plain/seed-0 --graph paper-examples", "was trained on graph"),
    ("evaluate-agent {world}/plain/seed-0 --part valid", "valid"),
    ("evaluate-agent {world}/plain/seed-0 --agent kg-only", "trained without a scorer"),
    ("evaluate-links {world}/plain/seed-0", "written by train-agent; expected a model"),
    ("explain {world}/plain/seed-0 --goal spaceship", "no entity 'spaceship'"),
    ("compare {world}/plain {world}/many", "plays with max_attempts"),
    ("compare", "needs run folders"),
    ("compare {world}/plain {world}/plain", "the same settings and seed"),
    ("compare {world}/plain {world}/scorer", "cannot be compared"),
    ("compare {world}/scorer", "two link predictors or more"),
    ("compare {trained}/graph", "is a graph folder"),
    ("discover kitchen --players empowerment-scorer", "needs a --scorer"),
    ("discover kitchen --scorer nowhere", "nowhere"),
    ("discover everyday --scorer {trained}/one", "was trained on graph"),
    ("train-agent kitchen --scorer nowhere", "does not exist"),
    ("train-agent paper-examples --scorer {trained}/one", "was trained on graph"),
    ("train-agent kitchen --unroll=16777216 --batch-size=16777216", "281,474,976,710,656 steps would take"),
    ("train-complex kitchen --seeds 0-1 --seed 3", "--seed 3 and --seeds 0-1 cannot be combined"),
    ("train-complex kitchen --seeds 0,4294967296", "--seed 4294967296"),
    ("train-links", "needs a graph"),
    ("books --cache --fetch little-alchemy-2", "cannot be combined"),
    ("books --fetch little-alchemy-3", "Did you mean 'little-alchemy-2'?"),
    ("describe kitchen --entity bred", "no entity 'bred' in kitchen. Did you mean 'bread'?"),
    ("score {trained}/one bred componentOf flour", "'bread'"),
    ("score {trained}/one flour componentOf bred", "'bread'"),
    ("score {trained}/one flour combineWith water", "'combinesWith'"),
    ("score {trained}/one ? componentOf ?", "both slots are open"),
    ("score {trained}/one ? componentOf", "both slots are open"),
    ("score {trained}/one flour combinesWith water --new-only", "--new-only"),
    ("score {trained}/one", "--in"),
    ("score {trained}/one flour", "--in"),
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
    ("reproduce --show nothing.json", "no such file"),
    ("reproduce --show study.toml", "expected results"),
    ("reference everyday --external-results {world}/plain", "was trained on graph 43fe37e2e912"),
    ("reference kitchen --open-ended --distractors 1", "--open-ended has no tasks"),
    ("reference kitchen --open-ended --part train", "--open-ended has no tasks"),
    ("reference kitchen --open-ended --attempts 7", "--open-ended has no tasks"),
    ("reference kitchen --open-ended --external-results {world}/plain", "expected an 'evaluate-text' result, an 'mcp"),
    ("reference kitchen --external-results {world}/graph", "is a graph folder; expected a run folder of 'train-agent'"),
    ("reference kitchen --external-results nowhere", "does not exist; expected a run folder of 'train-agent'"),
    ("reference kitchen --external-results {world}/plain --depth 2", "has test tasks of depth 1 with 1 attempt"),
    ("describe \udcff", "\\udcff' is not UTF-8. Rename the file or folder"),
    ("export kitchen --format=tsv --out=\udcff", "\\udcff' is not UTF-8. Rename the file or folder"),
]


@pytest.mark.parametrize(("command", "says"), REFUSED)
def test_what_a_command_cannot_do_is_one_line_that_says_why(refused, empty, home, command, says):
    assert refused(*empty(command), says=says).count("\n") == 1
    assert not list((home / "empty").iterdir())


TORN = {
    "build-graph kitchen": (1, 2, 5, 8),
    "train-complex kitchen --dim 8 --epochs 3 --n3 0.1 --folds 2": (1, 4, 6, 14),
    "train-recipes kitchen --train-fraction 0.1 --folds 3": (1, 6, 16),
    "train-agent kitchen --steps 320 --batch-size 16 --eval-every 160 --checkpoint-every 160": (1, 4, 9, 16),
}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS])
@pytest.mark.parametrize(("command", "write"), [(line, write) for line, writes in TORN.items() for write in writes])
def test_a_disk_that_takes_no_more_files_is_one_line_and_the_same_command_goes_on(
    run, refused, home, monkeypatch, command, write, number
):
    make, made = tempfile.mkstemp, []

    def fail_late(**options):
        made.append(options)
        if len(made) >= write:
            raise OSError(number, os.strerror(number), "disk")
        return make(**options)

    command = (*command.split(), "--out", home / "out", "--quiet")
    with monkeypatch.context() as patch:
        patch.setattr(tempfile, "mkstemp", fail_late)
        error = refused(*command, says=os.strerror(number))
    assert error.count("\n") == 1
    assert ("Nothing was changed" in error) == (list(home.iterdir()) == [])
    assert run(*command).code == 0
