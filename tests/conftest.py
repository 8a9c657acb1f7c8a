"""Shared by all tests: hypothesis settings, commands in this process, books, and
trained folders."""

import gc
import json
import logging
import os
import signal
import uuid
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from cyclopts import App, ArgumentCollection
from helpers import write_graph
from hypothesis import settings
from threadpoolctl import threadpool_limits

from wordcraft_kg.base.settings import CORES_VARIABLE
from wordcraft_kg.cli import main
from wordcraft_kg.cli.failures import Failure
from wordcraft_kg.graphs import RecipeGraph, library, open_book, open_graph, read_book
from wordcraft_kg.graphs.library import DATA_VARIABLE

# Ray reads these once, when it is imported, which torchrl does; a token in the home folder would
# count otherwise.
os.environ.setdefault("RAY_AUTH_MODE", "token")
os.environ.setdefault("RAY_AUTH_TOKEN", uuid.uuid4().hex)

# As in commands: collections among all imported objects took a tenth of the time.
gc.set_threshold(200_000, 20, 100)

# Property tests draw other examples in each run; `make slow` draws more.
settings.register_profile("quick", deadline=None, max_examples=5, print_blob=True)
settings.register_profile("thorough", settings.get_profile("quick"), max_examples=100)
settings.load_profile("quick")

THREADS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Numbers of threads, which numerical libraries read at import."""
DATA_FOLDER = os.environ.get(DATA_VARIABLE)
OFFICIAL_FILE = "alchemy2.json"


@dataclass(frozen=True)
class Outcome:
    """The end of a command: exit code, stdout, stderr, and kind and setting of its failure if there
    was one."""

    code: int
    out: str
    err: str
    kind: str = ""
    setting: str = ""


@pytest.hookimpl(tryfirst=True)  # before pytest selects by marker
def pytest_collection_modifyitems(items):
    """Mark the tests that use the fixture `chromium`; put rooms in the order of imports."""
    for item in items:
        if "chromium" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")
    items.sort(key=_room)


def pytest_collection_finish():
    """Keep modules and tests out of collections: they stay, and there are millions of them."""
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish():
    """Look for garbage once: pytest would go through all imported objects ten times."""
    gc.collect()
    gc.freeze()


ROOMS = (
    "agents/test_explanation.py",
    "base/",
    "graphs/",
    "envs/",
    "runs/",
    "",
    "apps/web/",
    "apps/",
)
"""Beginnings of files in the order in which they are tested; "" stands for the rest of the core.

The first file compiles most loops of numba, for half a minute. Other processes test rooms without
loops meanwhile, or all of them would compile the same. Tests in `apps/web` wait for deadlines: at
the end, one core would wait for the other.
"""


def _room(item):
    """Return the item's place in `ROOMS`: a fault in the core shows before the apps are tested."""
    file = item.nodeid.removeprefix("tests/")
    beginnings = [start for start in ROOMS if file.startswith(start)]
    return ROOMS.index(max(beginnings, key=len))


@pytest.fixture(scope="session", autouse=True)
def interruptible():
    """Let Ctrl-C raise: a shell starts its background jobs with the signal ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def one_core():
    """Use one thread: two are slower on tensors this small, and give other last bits; and train
    folds one by one."""
    # The process that only hands out tests never imports torch: its workers wait for it.
    import torch

    torch.set_num_threads(1)
    # SciPy's optimiser calls BLAS for vectors of four numbers: with a second thread of OpenBLAS,
    # which waits in a loop, a fit took 28 times the CPU time.
    with threadpool_limits(1, user_api="blas"), pytest.MonkeyPatch.context() as patch:
        # Of libraries that are loaded later, and of processes that tests start.
        for name in (CORES_VARIABLE, *THREADS_VARIABLES):
            patch.setenv(name, "1")
        yield


@pytest.fixture(scope="session", autouse=True)
def no_power_failure():
    """Leave files to the system: waiting for the disk costs 4 ms a file, and no test pulls the
    plug. A wrong descriptor is still an error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", os.fstat)
        yield


@pytest.fixture(scope="session", autouse=True)
def everyday_is_read_once():
    """Read the largest built-in book once in each process: many tests open it by name, and reading
    takes a quarter of a second. Tests of reading read other books."""
    file = Path(library.__file__).parent / "books" / "everyday.csv"
    read_once = cache(read_book)

    def read(path, **options):
        is_plain = options.keys() == {"keep_self_results", "name"}
        return (read_once if path == file and is_plain else read_book)(path, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "read_book", read)
        yield


@pytest.fixture(scope="session", autouse=True)
def signatures_are_read_once():
    """Read a command's signature once in each process: tests parse some 2,000 command lines, and
    reading takes 30 of the 37 ms of each. Users parse one in a process, so the product does not."""
    read_signature = App.assemble_argument_collection
    of_app = {}

    def read(self, *, default_parameter=None, parse_docstring=False):
        if default_parameter is not None or parse_docstring:
            return read_signature(
                self, default_parameter=default_parameter, parse_docstring=parse_docstring
            )
        if id(self) not in of_app:
            # The application is kept, too, or another one could get its id.
            of_app[id(self)] = self, read_signature(self)
        _, options = of_app[id(self)]
        # Parsing fills the options, so each command line gets empty ones.
        empty = {id(option): copy(option) for option in options}
        for option in empty.values():
            option.tokens = []
            option.children = ArgumentCollection(empty[id(one)] for one in option.children)
        return ArgumentCollection(empty.values())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(App, "assemble_argument_collection", read)
        yield


@pytest.fixture
def run(capsys, monkeypatch):
    """Run a command of the command line in this process."""
    monkeypatch.setenv("COLUMNS", "1000")
    failures = []
    show = Failure.show
    monkeypatch.setattr(
        Failure, "show", lambda failure, output: failures.append(failure) or show(failure, output)
    )

    def run(*arguments):
        capsys.readouterr()
        failures.clear()
        collection = gc.get_threshold()
        try:
            code = main([str(argument) for argument in arguments])
        finally:
            logging.captureWarnings(False)
            gc.set_threshold(*collection)
        captured = capsys.readouterr()
        failed = (failures[0].kind, failures[0].setting) if failures else ()
        return Outcome(code, captured.out, captured.err, *failed)

    return run


@pytest.fixture
def refused(run):
    """Run a command that is refused without a result or a traceback, and return the error."""

    def refused(*command, says=(), kind=None, setting=None, code=1):
        outcome = run(*command)
        assert (outcome.code, outcome.out) == (code, "")
        assert kind in (None, outcome.kind)
        assert setting in (None, outcome.setting)
        assert "Traceback" not in outcome.err
        for part in [says] if isinstance(says, str) else says:
            assert part in outcome.err
        return outcome.err

    return refused


@pytest.fixture
def put(tmp_path):
    """Write a text, bytes, or values as JSON into a file of the test, and return its path."""

    def put(content, name="book.csv"):
        path = tmp_path / name
        if not isinstance(content, str | bytes):
            content = json.dumps(content, ensure_ascii=False)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return put


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Give the test an empty cache of its own and no data folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(DATA_VARIABLE, raising=False)
    return tmp_path


@pytest.fixture
def uninstalled(monkeypatch):
    """Let packages look as if they were not installed, as in `uninstalled("mcp")`."""

    def hide(*names):
        def installed(name):
            if name in names:
                raise PackageNotFoundError(name)
            return version(name)

        monkeypatch.setattr("wordcraft_kg.base.extras.version", installed)

    return hide


@pytest.fixture(scope="session")
def kitchen():
    return RecipeGraph.from_book(open_book("kitchen"))


@pytest.fixture(scope="session")
def opened_kitchen():
    """The kitchen with its default split, 80 % train and no validation part."""
    return open_graph("kitchen")


@pytest.fixture(scope="session")
def opened(opened_kitchen):
    """The kitchen, in files that open no other graph."""
    return opened_kitchen


@pytest.fixture(scope="session")
def made_once(tmp_path_factory):
    """Make a folder once for all processes of this test session: `made_once(name, make)`; read
    only."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent

    def made_once(name, make):
        folder, done = root / "shared" / name, root / "shared" / f"{name}.done"
        folder.parent.mkdir(parents=True, exist_ok=True)
        with folder.with_name(f"{folder.name}.lock").open("w") as lock:
            with suppress(ImportError):  # Windows: the tests run in one process
                import fcntl

                fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                make(folder)
                done.touch()
        return folder

    return made_once


@pytest.fixture(scope="session")
def kitchen_folder(made_once):
    """The graph folder of the kitchen with its default split; read only."""
    return made_once("default/kitchen", write_graph)


@pytest.fixture(scope="session")
def parted_folder(made_once):
    """A graph folder of the kitchen with a validation part; read only."""
    return made_once(
        "parted/kitchen", lambda out: write_graph(out, train_ratio=0.7, valid_ratio=0.15)
    )


@pytest.fixture(scope="session")
def parted_kitchen(parted_folder):
    return open_graph(parted_folder)


@pytest.fixture(scope="session")
def recipes_folder(made_once):
    """A recipe scorer of the kitchen with three folds; read only."""
    from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
    from wordcraft_kg.models.recipes.recipe_training import train_recipes

    config = RecipesConfig("kitchen", RecipeScorerConfig(folds=3))
    return made_once("kitchen-recipes", lambda out: train_recipes(config, out))


@pytest.fixture(scope="session")
def cross_fitted(recipes_folder):
    """This scorer, loaded."""
    from wordcraft_kg.models.scorers.scorer_folder import load_scorer

    return load_scorer(recipes_folder)


@pytest.fixture(scope="session")
def alchemy_path():
    path = Path(DATA_FOLDER or "") / OFFICIAL_FILE
    if not DATA_FOLDER or not path.is_file():
        pytest.skip(
            f"needs Little Alchemy 2: set {DATA_VARIABLE} to a folder that holds {OFFICIAL_FILE}"
        )
    return path


@pytest.fixture(scope="session")
def alchemy(alchemy_path):
    """Little Alchemy 2 with its five base entities."""
    return RecipeGraph.from_book(open_book(alchemy_path), ["air", "earth", "fire", "time", "water"])


@pytest.fixture
def forget_plugins(monkeypatch):
    """Return a function that forgets all plugins, as another process does; at the end, too."""
    from wordcraft_kg.agents.players import PLAYERS
    from wordcraft_kg.base import registry
    from wordcraft_kg.envs.world_config import REWARDS
    from wordcraft_kg.graphs.splits import SPLITS
    from wordcraft_kg.models.policies.policy_config import POLICIES
    from wordcraft_kg.models.policies.sources import SOURCES

    registries = (POLICIES, SOURCES, REWARDS, SPLITS, PLAYERS)
    built_in = [dict(kind._known) for kind in registries]

    def forget():
        monkeypatch.setattr(registry, "_LOADED", {})
        for kind, known in zip(registries, built_in, strict=True):
            monkeypatch.setattr(kind, "_known", dict(known))
            monkeypatch.setattr(kind, "_plugins", {})

    forget()
    return forget
