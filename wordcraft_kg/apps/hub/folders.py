"""Folders for a model hub: checked files, licence and card."""

import os
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.base.artefacts import read_small_file
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.graphs.folder import check_derived_files, open_graph
from wordcraft_kg.graphs.library import known_books, open_book
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.policies.folder import load_policy
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.runs.record import RUN_FILE, RunFiles, RunRecord, front_matter, read_finished_run

CARD = "README.md"
_EXPECTED = "a graph folder, a model folder or a run of train-agent"
_GRAPH_FILES = ("graph.json", "split.json", "recipes.csv", "entities.tsv", "audit.json")
_TRIPLES = tuple(f"triples/{name}.tsv" for name in ("full", "partial", "unseen"))
_RUN_FILES = (
    *("config.toml", "model.safetensors", "vocabulary.json", "metrics.json", "trace.jsonl"),
    *("folds.json", "folds.safetensors", "calibration.json", "choice.json"),
    *("policy.json", "policy.safetensors", "constants.safetensors"),
    *("evaluation.json", "metrics.jsonl"),
)
"""Files of models and agents.

No other name is shared: a list from elsewhere may name programs and pickles.
"""
SHARED = (CARD, RUN_FILE, *_RUN_FILES, *_GRAPH_FILES, *_TRIPLES)
"""All names that a push shares and a pull takes."""
_RECORD = "\n## Record\n"


@dataclass(frozen=True)
class SharedFolder:
    """A folder in which all files match their recorded hashes.

    Attributes:
        path: the folder.
        repo_type: repository type on a hub: dataset for a graph, model for a model or an agent.
        graph: hash of the graph, or of the training graph.
        card: README.md without a licence.
        files: names of all other files to share.
    """

    path: Path
    repo_type: str
    graph: str
    card: str
    files: tuple[str, ...]

    def with_licence(self, licence: str | None) -> str:
        """Return the card with a licence.

        Args:
            licence: identifier of a licence on the hub; None for the licence of a built-in book,
                CC0.

        Raises:
            ConfigError: if the licence is no identifier, or None for any other book: only built-in
                books have a known licence.
        """
        if licence is None:
            if not self._is_built_in():
                raise ConfigError(
                    f"the book in '{self.path}' has no known licence; Little Alchemy 2 has none "
                    "at all. Publish only with the permission of the authors, and name the "
                    "licence, as in `licence` cc-by-4.0."
                )
            licence = "cc0-1.0"
        if not re.fullmatch(r"[a-z0-9][a-z0-9.-]{1,40}", licence):
            raise ConfigError(
                f"`licence` '{licence}': expected an identifier of the hub, such as cc-by-4.0 or "
                "other."
            )
        # The licence goes first into the block between the lines of dashes, which the hub reads.
        head, _, body = self.card.removeprefix("---\n").partition("\n---\n")
        head_lines = [line for line in head.split("\n") if not line.startswith("license:")]
        lines = [f"license: {licence}", *head_lines]
        return "\n".join(["---", *lines, "---", body])

    def _is_built_in(self) -> bool:
        """Return whether the graph is that of a built-in book: the content counts, not the name."""
        names = [book.name for book in known_books() if book.origin == "built in"]
        return any(RecipeGraph.from_book(open_book(name)).hash == self.graph for name in names)


def open_folder(folder: Path) -> SharedFolder:
    """Open a graph folder, a finished model or agent, and check all its files.

    Raises:
        ArtefactError: if a file is missing, changed or damaged, is a link out of the folder, or
            disagrees with the other files, or if a run lists a file that this package does not
            write.
    """
    if (folder / "graph.json").is_file():
        return _open_graph_folder(folder)
    is_model = (folder / "model.safetensors").exists()
    weights = "model.safetensors" if is_model else "policy.safetensors"
    # Before a file is read: even an error could show the content of a file behind a link.
    _check_places(folder, (RUN_FILE, weights, CARD))
    run = read_finished_run(folder, _EXPECTED, weights)
    foreign = sorted(set(run.outputs) - set(_RUN_FILES))
    if foreign:
        raise ArtefactError(
            f"{folder / RUN_FILE} lists {foreign[0]!r}, which is no file of a model or an agent. "
            "Train again, or restore a copy."
        )
    # Other inputs, such as the hash of the graph, are not in the folder.
    names = [name for name in {**run.inputs, **run.outputs} if name in _RUN_FILES]
    _check_places(folder, names)
    for name in names:
        RunFiles(folder, run).bytes(name)  # compares the hash with run.json
    if is_model:
        load_scorer(folder)
    else:
        load_policy(folder)
    # A pulled folder has a record already, which is replaced.
    text, _, _ = read_small_file(folder / CARD).decode(errors="replace").partition(_RECORD)
    card = text + _record(run)
    return SharedFolder(folder, "model", run.inputs["graph"], card, (RUN_FILE, *names))


def _check_places(folder: Path, names: Iterable[str]) -> None:
    """Raise ArtefactError if a file lies outside the folder.

    A link would publish any file that the user can read.
    """
    # Path.resolve raises on a loop of links before Python 3.13.
    inside = os.path.realpath(folder)
    for name in names:
        place = Path(os.path.realpath(folder / name))
        if not place.is_relative_to(inside):
            raise ArtefactError(
                f"{folder / name} is a link out of the folder, to {place}. Replace the link by a "
                "copy of a file that belongs to this folder."
            )


def _open_graph_folder(folder: Path) -> SharedFolder:
    _check_places(folder, _GRAPH_FILES + _TRIPLES)
    graph_folder = open_graph(str(folder))
    # Triples and audit follow from the recipes: files that do not agree with them are refused.
    check_derived_files(folder, graph_folder)
    graph = graph_folder.graph
    split = graph_folder.split
    counts = {part: int(split.is_in(part).sum()) for part in ("train", "valid", "test")}
    sizes = ", ".join(f"{count:,} {part}" for part, count in counts.items())
    card = f"""{front_matter("knowledge-graph", "recipes")}
# Recipe graph {graph.name}

{graph.num_entities:,} entities and {graph.num_recipes:,} recipes, with a split and its triples \
for link prediction.

- graph `{graph.hash}`
- split `{split.hash}`: {split.config.kind}, seed {split.config.seed}; recipes: {sizes}

```python
from wordcraft_kg import open_graph

opened = open_graph("this folder")
```
"""
    return SharedFolder(folder, "dataset", graph.hash, card, _GRAPH_FILES + _TRIPLES)


def _record(run: RunRecord) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in run.versions.items())
    inputs = "\n".join(f"- {name}: `{value}`" for name, value in run.inputs.items())
    # The program's own path is left out: it may hold a user's name.
    command = shlex.join(["wordcraft-kg", *run.argv[1:]])
    return f"{_RECORD}\n`{command}` with {versions}. Hashes of the inputs:\n\n{inputs}\n"
