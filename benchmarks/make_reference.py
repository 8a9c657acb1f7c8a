"""Measure the reference pack, and write its files.

    python benchmarks/make_reference.py everyday --studies docs/results/knowledge-everyday.json
    python benchmarks/make_reference.py little-alchemy-2 --studies docs/results/embeddings-little-alchemy-2.json ...
    python benchmarks/make_reference.py everyday --check

Scripted players are always measured: on test tasks with depth 1 and 1, 2 and 8 distractors, with depth 2 and 1 and 8
distractors, and in open-ended mode. Agents come from study results (``--studies``: each variant with the number of
distractors in training), which replace the file's agents; ``--scorers`` are models that play without an agent. The
file's rows of other scorers stay unchanged. ``--check`` writes nothing; the exit code is 1 if a scripted player's
figures differ from the file.

The scorers for ``everyday``, without an agent:

    wordcraft-kg train-recipes everyday --out models/everyday-recipes
    python benchmarks/make_reference.py everyday --scorers "recipe scorer alone=models/everyday-recipes"

The tables of SmolLM2-135M-Instruct alone, without recipes (docs/outside-knowledge.md):

    wordcraft-kg elicit everyday --model MODEL --out knowledge/lm
    wordcraft-kg train-recipes everyday --kg none --with knowledge/lm --out models/everyday-language-model
    python benchmarks/make_reference.py everyday --scorers "SmolLM2-135M alone=models/everyday-language-model"
"""

import argparse
import json
import platform
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from wordcraft_kg.base.errors import TaskError
from wordcraft_kg.base.records import as_values, read_record
from wordcraft_kg.base.statistics import rate_interval
from wordcraft_kg.evaluation.reference import (
    FORMAT,
    PACK,
    TRAINED_WITH,
    PlayedGraph,
    ReferencePack,
    ReferenceRow,
    TaskPlay,
    metrics_of,
    read_pack,
)
from wordcraft_kg.evaluation.reference_table import (
    DISTRACTORS,
    in_order,
    open_play,
    scorer_rows,
    scripted_rows,
)
from wordcraft_kg.evaluation.result_readers import SEEN, over
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.studies.results import StudyResults

PLAYS = ((TaskPlay("test", 1, 1), DISTRACTORS), (TaskPlay("test", 2, 2), (1, 8)))
BASES = (None, ("air", "earth", "fire", "water"))
"""The graph's own, and that of people who play Little Alchemy 2."""
PACKAGES = ("wordcraft-kg", "torch", "numpy")
PLAIN = "no graph, "
"""Before the variants of the study of what an agent sees, in which no agent has a graph."""


def main() -> None:
    """Measure, and write or compare a file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", help="graph folder, recipe book or known book's name")
    parser.add_argument(
        "--studies", nargs="+", default=(), type=Path, help="results of studies of this book"
    )
    parser.add_argument(
        "--scorers", nargs="+", default=(), metavar="NAME=MODEL", help="model folders, by scorer"
    )
    parser.add_argument(
        "--check", action="store_true", help="compare scripted players with the file"
    )
    chosen = parser.parse_args()
    opened = open_graph(chosen.graph)
    path = PACK / f"{opened.graph.name}.json"
    scripted = tuple(scripted_players(opened))
    kept = read_pack(path).rows if path.exists() else ()
    if chosen.check:
        sys.exit(differences(read_pack(path), scripted))
    agents = [*studied(opened, chosen.studies)] or [row for row in kept if row.kind == "agent"]
    scorers = [*alone(opened, chosen.scorers)]
    names = {row.player for row in scorers}
    scorers[:0] = [row for row in kept if row.kind == "scorer" and row.player not in names]
    pack = ReferencePack(
        format=FORMAT,
        title=opened.graph.name,
        graph=PlayedGraph.of(opened),
        versions=versions(),
        rows=in_order([*scripted, *scorers, *agents]),
    )
    path.write_text(pack_text(pack), encoding="utf-8")
    print(f"wrote {path}: {len(pack.rows)} rows, {path.stat().st_size:,} bytes")


def scripted_players(opened: OpenedGraph) -> Iterator[ReferenceRow]:
    """Yield the rows of scripted players: crafting tasks, then open-ended play."""
    for play, columns in PLAYS:
        try:
            yield from scripted_rows(opened, play, columns)
        except TaskError as error:
            print(error, file=sys.stderr)
    for play in dict.fromkeys(open_play(opened, base) for base in BASES):
        yield from scripted_rows(opened, play, ())


def alone(opened: OpenedGraph, named: Sequence[str]) -> Iterator[ReferenceRow]:
    """Yield the rows of scorers without agents by their model folders, ``NAME=MODEL``."""
    for text in named:
        name, _, folder = text.partition("=")
        model = open_model(folder, opened.source)
        for row in scorer_rows(opened, *PLAYS[0], name, model):
            yield replace(row, source=row.source.replace(name, folder))


def studied(opened: OpenedGraph, paths: Sequence[Path]) -> Iterator[ReferenceRow]:
    """Yield rows for study variants that played depth 1 on this graph and split;
    equal runs once."""
    seen: set[str] = set()
    for path in paths:
        results = read_record(path, StudyResults)
        study = results.study
        for name, settings in study.variants.items():
            runs = [
                run
                for run in results.runs
                if run.variant == name
                and results.graphs[run.graph].split == opened.split.hash
                and run.values.keys() <= {"distractors"}
                and run.run not in seen
            ]
            seen |= {run.run for run in runs}
            amounts = sorted({int(run.values["distractors"]) for run in runs})
            if not amounts:
                continue
            rates = {
                amount: [run.rates for run in runs if run.values["distractors"] == amount]
                for amount in amounts
            }
            found = {
                amount: (float(np.mean(rate)), *rate_interval(rate, results.groups_of(runs[0])))
                for amount, rate in rates.items()
            }
            own = {
                amount: float(
                    np.mean(
                        [run.by_plan["test"] for run in runs if run.values["distractors"] == amount]
                    )
                )
                for amount in amounts
            }
            scorer = study.scorers.get(str(settings.get("scorer")), {})
            yield ReferenceRow(
                player=name if scorer or name.startswith("no graph") else PLAIN + name,
                kind="agent",
                measure="success",
                figures=metrics_of(found, own),
                origin="ours",
                source=f"{results.command} ({study.title})",
                play=PLAYS[0][0],
                interval=over(opened.split.unit, seeds=len({run.seed for run in runs})),
                tasks=len(runs[0].won),
                distractor_seeds=runs[0].distractor_seeds,
                seeds=len({run.seed for run in runs}),
                settings={key: str(value) for key, value in settings.items()}
                | {"steps": f"{runs[0].steps:,}", TRAINED_WITH: "as many distractors as here"},
                notes=f"its scorer {SEEN}" if scorer.get("kg") == "full" else "",
            )


def versions() -> dict[str, str]:
    """Return the versions that figures may depend on."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}


def pack_text(pack: ReferencePack) -> str:
    """Return a pack file, with a line per row for readable diffs."""
    values = as_values(pack)
    rows = ",\n".join(json.dumps(row, ensure_ascii=False) for row in values.pop("rows"))
    return f'{json.dumps(values, ensure_ascii=False)[:-1]}, "rows": [\n{rows}\n]}}\n'


def differences(pack: ReferencePack, scripted: Sequence[ReferenceRow]) -> int:
    """Print differences between file and measurements; return the exit code."""
    recorded = {
        (row.player, row.play): row for row in pack.rows if row.kind not in ("agent", "scorer")
    }
    wrong = [row.player for row in scripted if recorded.pop((row.player, row.play), None) != row]
    for name in [*wrong, *(player for player, _ in recorded)]:
        print(f"'{name}' is not as in the file")
    return 1 if wrong or recorded else 0


if __name__ == "__main__":
    main()
