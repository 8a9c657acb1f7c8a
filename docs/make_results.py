"""Write docs/results.md and its pictures from the results in docs/results/.

    python docs/make_results.py [--check | --take FOLDER | --cells [FOLDER]]

The committed results hold figures and hashes, and nothing of a book. Of a store of cells, a study with at least three
seeds of all variants takes the place of its file; docs/results/left.json lists the rest with the hours. Cells hold no
durations: ``--take`` keeps the hours of a study, and ``--cells`` does not.
"""

import argparse
import json
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePath
from typing import get_args

import msgspec

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.records import read_record
from wordcraft_kg.base.statistics import FEWEST_PAIRS
from wordcraft_kg.base.wording import counted
from wordcraft_kg.studies.cells import exchange_cells
from wordcraft_kg.studies.claims import ClaimVerdict, Verdict, in_words, share, signed, view_claims
from wordcraft_kg.studies.engine import estimated_hours
from wordcraft_kg.studies.plan import make_plan
from wordcraft_kg.studies.report import study_figure
from wordcraft_kg.studies.results import StudyResults, results_text
from wordcraft_kg.studies.store import collect_study, own_results, studies_of, write_plan
from wordcraft_kg.studies.study import Study, Values, adapted, built_in, read_study
from wordcraft_kg.studies.tables import origin_in_words
from wordcraft_kg.studies.variants import PointFigures, ScorerScatter, VariantFigures
from wordcraft_kg.studies.view import StudyView, title_of, view_study

HERE = Path(__file__).parent
BEGIN, END = "<!-- results -->\n", "<!-- end of results -->"
COVERAGE = "<!-- coverage -->\n", "<!-- end of coverage -->"
LEFT = "<!-- left -->\n", "<!-- end of left -->"
MOST_BYTES = 4 * 1024 * 1024
"""Of all committed results together."""
ORDER = ("embeddings", "knowledge", "sources", "alone", "splits", "depth2", "csrl", "training-data")
BOOKS = {"little-alchemy-2": "Little Alchemy 2", "everyday": "`everyday`"}
SEEDS = {"little-alchemy-2": 5, "everyday": 3}
"""Declared seeds by book."""
FEWEST = 3
"""Seeds from which on a study of cells takes the place of an earlier file."""
NO_AGENT = "random pairs", "nearest words", "recipe scorer alone, u v", "recipe scorer alone, w", "planner, p"
PLAYED = "graph", "split", "depth", "distractors", "distractor_seeds", "tasks"
FOLDERS = re.compile(r"(?<![\w.])/(?:[^\s/]+/)+")
"""The folders of an absolute path."""


def name_of(results: StudyResults) -> str:
    """Return the study's name without the book's name; `reproduce` joins the two."""
    return results.name.removesuffix(f"-{book_of(results)}")


def book_of(results: StudyResults) -> str:
    """Return the book's name; with several books, the first graph's."""
    return PurePath(str(results.study.settings.get("book", results.graphs[0].name))).stem


def current(results: StudyResults) -> Study:
    """Return the package's version of the study, with the newest claims and words; else the version of the run."""
    return read_study(name_of(results)) if name_of(results) in built_in() else results.study


def without_paths(results: StudyResults) -> StudyResults:
    """Return results with only the last part of each path of the machine."""
    settings = results.study.settings
    if "book" in settings:
        settings = settings | {"book": FOLDERS.sub("", str(settings["book"]))}
    return msgspec.structs.replace(
        results,
        command=FOLDERS.sub("", results.command),
        study=msgspec.structs.replace(results.study, settings=settings),
        missing=tuple(msgspec.structs.replace(lost, why=FOLDERS.sub("", lost.why)) for lost in results.missing),
    )


def take(folder: Path, target: Path) -> None:
    """Copy the results of all studies of a results folder, as far as they are there."""
    target.mkdir(parents=True, exist_ok=True)
    for name in studies_of(folder):
        results = collect_study(folder, name)
        if results.runs:
            write_atomically(target / f"{name}.json", results_text(without_paths(results)))


def of_first_seeds(results: StudyResults, seeds: int) -> StudyResults:
    """Return results with the first ``seeds`` seeds only: their origins, graphs and hours of agents."""
    kept = [run for run in results.runs if run.seed < seeds]
    graphs = sorted({run.graph for run in kept})
    origins = Counter(run.origin for run in kept)
    numbers = sorted(origins) if results.origins else [0]
    runs = (
        msgspec.structs.replace(run, graph=graphs.index(run.graph), origin=numbers.index(run.origin)) for run in kept
    )
    return msgspec.structs.replace(
        results,
        command=f"{results.command} --seeds {seeds}",
        study=msgspec.structs.replace(results.study, seeds=seeds),
        runs=tuple(runs),
        missing=tuple(lost for lost in results.missing if lost.seed < seeds),
        graphs=tuple(results.graphs[number] for number in graphs),
        hours=round(sum(run.seconds for run in kept) / 3600, 4),
        origins=tuple(
            msgspec.structs.replace(of, runs=origins[number])
            for number, of in enumerate(results.origins)
            if number in origins
        ),
    )


def collect(store: Path, target: Path) -> None:
    """Collect all built-in studies from a store of cells, and list the missing trainings."""
    left = []
    for name in ORDER:
        for book, seeds in SEEDS.items():
            study = adapted(read_study(name), book=book, seeds=seeds)
            plan = make_plan(study, f"{name}-{book}")
            with tempfile.TemporaryDirectory() as folder, own_results(Path(folder)):
                exchange_cells(plan, Path(folder), store)
                hours = estimated_hours(plan, Path(folder), store)
                write_plan(
                    Path(folder), plan, f"wordcraft-kg reproduce {name} --book {book} --store docs/results/cells"
                )
                results = collect_study(Path(folder), plan.name)
            row = {"study": study.title, "book": BOOKS[book], "trainings": len(plan.cells), "here": len(results.runs)}
            left.append(row | {"hours": round(hours, 1)})
            complete = min((lost.seed for lost in results.missing), default=seeds)
            if complete >= FEWEST:
                whole = without_paths(of_first_seeds(results, complete))
                write_atomically(target / f"{plan.name}.json", results_text(whole))
    write_atomically(target / "left.json", "[\n" + ",\n".join(map(json.dumps, left)) + "\n]\n")


def left_table(path: Path) -> Iterator[str]:
    """Yield the lines of a table of the declared trainings that are not there yet."""
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    yield "| study | book | declared trainings | there | hours of one core for the rest, estimated |"
    yield "|---|---|---|---|---|"
    for row in rows:
        yield f"| {row['study']} | {row['book']} | {row['trainings']} | {row['here']} | {row['hours']:.1f} |"
    yield f"| all | | {sum(row['trainings'] for row in rows)} | {sum(row['here'] for row in rows)} | |"


def read_all(folder: Path) -> list[StudyResults]:
    """Return the committed results in the order of the page."""
    paths = [path for path in sorted(folder.glob("*.json")) if path.name != "left.json"]
    found = [read_record(path, StudyResults) for path in paths]
    size = sum(path.stat().st_size for path in paths)
    if size > MOST_BYTES:
        sys.exit(f"the results take {size:,} bytes; {MOST_BYTES:,} are the most to commit. Leave studies out.")
    order = {name: number for number, name in enumerate(ORDER)}
    books = {name: number for number, name in enumerate(BOOKS)}
    return sorted(
        found, key=lambda of: (order.get(name_of(of), len(order)), name_of(of), books.get(book_of(of), len(books)))
    )


def page(found: list[StudyResults], views: list[StudyView]) -> Iterator[str]:
    """Yield the lines of the page below its head."""
    if not found:
        yield "No study has been run yet: this page fills itself from the files in `docs/results/`."
        return
    has_gaps = any(results.missing for results in found)
    yield f"| study | book | steps | seeds | trainings |{' missing |' * has_gaps} hours of one core |"
    yield f"|---|---|---|---|---|{'---|' * has_gaps}---|"
    for results, view in zip(found, views, strict=True):
        trainings = f"{len(results.runs)}" + f" | {len(results.missing) or ''}" * has_gaps
        yield (
            f"| [{current(results).title}](#{anchor(results)}) | {shown_book(results)} | {steps_of(view)} | "
            f"{seeds_of(view)} | {trainings} | {f'{results.hours:.1f}' if results.hours else 'not recorded'} |"
        )
    yield ""
    evaluated = [(results, view_claims(results, current(results).claims)) for results in found]
    yield "## Claims"
    yield ""
    yield f"Of the paper: {verdicts(evaluated, of_paper=True)}. Of this project: {verdicts(evaluated, of_paper=False)}."
    yield "Each claim counts at each point that it is about, on each book; [the rule](#how-to-read-this-page) is below."
    yield ""
    for results, claims in evaluated:
        yield f"**{current(results).title}**, {shown_book(results)}, by `{results.command}`:"
        yield ""
        yield from claims_table(claims)
        yield ""
    for results, view in zip(found, views, strict=True):
        yield from section(results, view)


def verdicts(evaluated: list[tuple[StudyResults, tuple[ClaimVerdict, ...]]], *, of_paper: bool) -> str:
    """Return how many verdicts of each kind there are."""
    given = [claim for _, claims in evaluated for claim in claims if claim.source.startswith("paper") == of_paper]
    counts = Counter(claim.verdict for claim in given)
    few = Counter(claim.verdict for claim in given if is_provisional(claim))
    texts = {name: f"{counts[name]} {name}" + (f" ({few[name]} provisional)" if few[name] else "") for name in counts}
    return ", ".join(texts[name] for name in get_args(Verdict) if name in texts) or "none"


def is_provisional(claim: ClaimVerdict) -> bool:
    """Return whether a verdict rests on too few seeds to be firm."""
    decided = claim.verdict not in ("undecided", "not run")
    return decided and any(measured.seeds < FEWEST_PAIRS for measured in claim.measured)


def anchor(results: StudyResults) -> str:
    """Return the anchor of a section, independent of the heading's words."""
    return f"{name_of(results)}-{book_of(results)}"


def shown_book(results: StudyResults) -> str:
    """Return the name of the book for people."""
    return BOOKS.get(book_of(results), book_of(results))


def steps_of(view: StudyView) -> str:
    """Return the steps of the trainings."""
    return " to ".join(f"{steps:,}" for steps in _ends(entry.steps for entry in _entries(view)))


def seeds_of(view: StudyView) -> str:
    """Return how many seeds the cells have."""
    return " to ".join(str(number) for number in _ends(len(entry.seeds) for entry in _entries(view)))


def _ends(values: Iterable[int]) -> list[int]:
    found = set(values)
    return sorted({min(found), max(found)})


def _entries(view: StudyView) -> list[VariantFigures]:
    return [entry for point in view.points for entry in point.variants]


def claims_table(claims: Iterable[ClaimVerdict]) -> Iterator[str]:
    """Yield the lines of a table of claims; the text of a claim is there once."""
    yield "| claim | at | left against right: difference [95 %] | verdict |"
    yield "|---|---|---|---|"
    before = ""
    for claim in claims:
        text = f"{claim.text} *({claim.source})*" if claim.source else claim.text
        where = "; ".join(title_of(measured.values) for measured in claim.measured)
        figures = "<br>".join(in_words(claim, measured, mark="*") for measured in claim.measured)
        verdict = f"**{claim.verdict}**: {claim.why}" + (f". {claim.note}" if claim.note else "")
        yield f"| {'' if text == before else text} | {where} | {figures} | {verdict} |"
        before = text


def section(results: StudyResults, view: StudyView) -> Iterator[str]:
    """Yield the lines of a study: question, figures, and command."""
    study = current(results)
    yield f'<a id="{anchor(results)}"></a>'
    yield ""
    yield f"## {study.title} ({shown_book(results)})"
    yield ""
    yield f"{' '.join(study.about.split())} *{study.source}.*"
    yield ""
    yield f"![{study.title} ({shown_book(results).strip('`')})](images/results-{anchor(results)}.svg)"
    yield ""
    if view.scatters:
        for scatter in view.scatters:
            yield from scatter_table(results, view, scatter)
    else:
        for point in view.points:
            yield from point_table(results, view, point)
    if results.missing:
        yield f"Missing: {missing_text(results)}."
        yield ""
    graphs = [f"{of.name} `{of.hash[:12]}` ({of.kind}, split `{of.split[:12]}`)" for of in results.graphs]
    hours = f"{results.hours:.1f} core hours" if results.hours else "from stored cells, which hold no hours"
    yield f"Made with `{results.command}`: {hours}, on {', '.join(graphs)}; {origins_of(results)}."
    yield ""


def origins_of(results: StudyResults) -> str:
    """Return the platforms and versions of the trainings."""
    made = [(f"{origin_in_words(of)}, {of.platform}: ", of.versions) for of in results.origins] or [
        ("", results.versions)
    ]
    texts = (who + ", ".join(f"{name} {version}" for name, version in versions.items()) for who, versions in made)
    return "; ".join(texts)


def without_agent(results: StudyResults, point: PointFigures) -> Iterator[tuple[str, str, str]]:
    """Yield name, success and success by the own recipe of players without an agent, on the tasks of a point."""
    path = HERE / "study-players.json"
    settings = {"depth": 1, "distractors": 1} | results.study.settings | point.values
    point_of = (settings["depth"], settings["distractors"], point.distractor_seeds, point.tasks)
    at = {(graph.hash, graph.split, *point_of) for graph in point.graphs}
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    for row in sorted(rows, key=lambda row: NO_AGENT.index(row["player"])):
        if tuple(row[key] for key in PLAYED) in at:
            success = f"{share(row['success'])} [{share(row['low'])}, {share(row['high'])}]"
            yield f"*no agent: {row['player']}*", success, share(row["by_plan"])


def point_table(results: StudyResults, view: StudyView, point: PointFigures) -> Iterator[str]:
    """Yield the lines of a table of all variants at a point of the grid, and of players without an agent."""
    has_mrr = any(entry.mrr is not None for entry in point.variants)
    yield f"{point.title[0].upper()}{point.title[1:]}, {counted(point.tasks, 'test task')}:"
    yield ""
    yield f"| | seeds |{' MRR |' * has_mrr} success | more than {view.reference} | own recipe | on train tasks |"
    yield f"|---|---|{'---|' * has_mrr}---|---|---|---|"
    for entry in point.variants:
        mrr = f" {'' if entry.mrr is None else share(entry.mrr)} |" * has_mrr
        low, high = entry.interval
        success = f"{share(entry.mean)} [{share(low)}, {share(high)}]"
        more = ""
        if entry.comparison:
            low, high = entry.comparison.interval
            more = f"{signed(entry.comparison.difference)} [{signed(low)}, {signed(high)}]"
        train = "" if entry.train is None else share(entry.train)
        own = share(entry.by_plan)
        yield f"| {entry.variant} | {len(entry.seeds)} |{mrr} {success} | {more} | {own} | {train} |"
    for name, success, own in without_agent(results, point):
        yield f"| {name} | |{' |' * has_mrr} {success} | | {own} | |"
    yield ""


def scatter_table(results: StudyResults, view: StudyView, scatter: ScorerScatter) -> Iterator[str]:
    """Yield the lines of a table of success by the scorer's MRR."""
    how = "train tasks scored in-sample" if scatter.in_sample else "train tasks scored out of sample"
    yield f"{how.capitalize()}{f', {title_of(scatter.values)}' if scatter.values else ''}:"
    yield ""
    yield f"| scorer | MRR | success | steps to where {view.reference} ends |"
    yield "|---|---|---|---|"
    if scatter.without is not None:
        yield f"| none |  | {share(scatter.without)} |  |"
    for at in scatter.points:
        low, high = at.interval
        reached = "never" if at.reached is None else f"{at.reached:,}"
        yield f"| {at.label} | {share(at.mrr)} | {share(at.success)} [{share(low)}, {share(high)}] | {reached} |"
    at = [point for point in view.points if point.values.items() >= scatter.values.items()]
    rows = dict.fromkeys((name, success) for point in at for name, success, _ in without_agent(results, point))
    for name, success in rows:
        yield f"| {name} | | {success} | |"
    yield ""
    correlations = {
        "of MRR and success, Pearson": scatter.pearson,
        "Spearman": scatter.spearman,
        "of MRR and steps, Spearman": scatter.steps_spearman,
    }
    said = [f"{name} {of.value:+.2f} [{of.low:+.2f}, {of.high:+.2f}]" for name, of in correlations.items() if of]
    if said:
        yield f"Correlation over these scorers, with the 95 % interval over them: {', '.join(said)}."
        yield ""


def missing_text(results: StudyResults) -> str:
    """Return which trainings have no figures, and why."""
    reasons: dict[str, list[tuple[str, Values, int]]] = {}
    for lost in results.missing:
        reasons.setdefault(lost.why, []).append((lost.variant, lost.values, lost.seed))
    return "; ".join(
        f"{counted(len(of), 'training')} ({why}), the first {of[0][0]}"
        f"{f', {title_of(of[0][1])}' if of[0][1] else ''}, seed {of[0][2]}"
        for why, of in reasons.items()
    )


def coverage_table(path: Path) -> Iterator[str]:
    """Yield the lines of the table of simulated coverage, with a row for each kind of interval."""
    by_kind: dict[str, dict[int, str]] = {}
    for row in json.loads(path.read_text(encoding="utf-8")):
        text = f"{share(row['coverage'])} ({share(row['lowest'])} to {share(row['highest'])})"
        by_kind.setdefault(row["kind"], {})[row["seeds"]] = text
    yield "| 95 % interval | 2 seeds | 3 seeds | 5 seeds | without seeds |"
    yield "|---|---|---|---|---|"
    for kind, texts in by_kind.items():
        yield f"| {kind} | {' | '.join(texts.get(seeds, '') for seeds in (2, 3, 5, 1))} |"


def replaced(text: str, marks: tuple[str, str], lines: Iterable[str]) -> str:
    """Return a text with new lines between two marks."""
    before, found, rest = text.partition(marks[0])
    return before + found + "\n" + "\n".join(lines) + "\n" + marks[1] + rest.partition(marks[1])[2] if found else text


def written(found: list[StudyResults], text: str) -> dict[str, str]:
    """Return the page with new figures, and the pictures, by path below docs/."""
    views = [view_study(results) for results in found]
    text = replaced(text, (BEGIN, END), page(found, views))
    text = replaced(text, LEFT, left_table(HERE / "results" / "left.json"))
    files = {"results.md": replaced(text, COVERAGE, coverage_table(HERE / "interval-coverage.json"))}
    for results, view in zip(found, views, strict=True):
        title = f"{current(results).title} ({shown_book(results).strip('`')})"
        files[f"images/results-{anchor(results)}.svg"] = study_figure(msgspec.structs.replace(view, title=title))
    return files


def main() -> None:
    """Write the page and the pictures, or check them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--check", action="store_true", help="write nothing; exit code 1 if something would change")
    choice.add_argument("--take", type=Path, metavar="FOLDER", help="first copy the studies of a results folder")
    cells = HERE / "results" / "cells"
    choice.add_argument(
        "--cells",
        type=Path,
        nargs="?",
        const=cells,
        metavar="FOLDER",
        help="first collect the built-in studies from a store of cells (default: docs/results/cells), without training",
    )
    options = parser.parse_args()
    if options.cells and not options.cells.is_dir():
        sys.exit(f"'{options.cells}' is not a folder; expected a store of cells (`wordcraft-kg reproduce --store`).")
    try:
        if options.take:
            take(options.take, HERE / "results")
        if options.cells:
            collect(options.cells, HERE / "results")
        files = written(read_all(HERE / "results"), (HERE / "results.md").read_text(encoding="utf-8"))
    except WordCraftKGError as error:
        sys.exit(str(error))
    for path, text in files.items():
        target = HERE / path
        if not options.check:
            write_atomically(target, text)
        elif not target.exists() or target.read_text(encoding="utf-8") != text:
            sys.exit(f"{path} is not up to date; run `make docs`")


if __name__ == "__main__":
    main()
