"""Write the figures of the studies from docs/results.zip into docs/evidence/tables.csv.

    python docs/make_results.py [--check | --take FOLDER]

The archive holds figures and hashes, and nothing of a book. With --take, a study of a results
folder takes the place of its file in the archive if no training is missing and its settings are
those of the built-in study, with any number of seeds. Each study has a page of evidence, whose
tables docs/make_evidence.py renders:

| table of a study's page | rows and columns |
|---|---|
| ``success`` | variants by book and kind of split; of several numbers of distractors, a table each |
| ``learning`` | success at shares of the training's steps, at the first point, by variant and book |
| ``claims`` | claims at each point by book: verdict, difference and its interval |

The page ``parts`` has plain PPO beside the players of the study (benchmarks/plain_ppo.py). The page
``results`` has the claims of the paper and of this project with their numbers of verdicts,
and the trainings of each study. P-values are corrected over the claims of more and of less of all
studies (Holm 1979).
"""

import argparse
import json
import re
import sys
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from make_evidence import MARK, TABLES, Cell, as_csv, read_cells
from msgspec import structs

from wordcraft_kg.base.artefacts import staged_file, write_atomically
from wordcraft_kg.base.records import parse_record
from wordcraft_kg.base.statistics import crossed_difference, holm, rate_interval
from wordcraft_kg.studies.claims import ClaimVerdict, Measured, Verdict, view_claims
from wordcraft_kg.studies.results import StudyResults, collect_study, results_text, studies_of
from wordcraft_kg.studies.study import Values, adapted, read_study, title_of
from wordcraft_kg.studies.view import StudyView, view_study

ARCHIVE = Path(__file__).parent / "results.zip"
"""The results of the studies, a JSON file each."""
MEASUREMENTS = Path(__file__).parent / "evidence" / "measurements.zip"
"""Stored figures of benchmarks; ``plain-ppo.json`` stands beside the study ``parts``."""
ORDER = ("embeddings", "knowledge", "sources", "alone", "parts", "planning")
"""The studies, in the order of the pages."""
BOOKS = {"little-alchemy-2": "Little Alchemy 2", "everyday": "`everyday`"}
KINDS = {"by-recipe": "unseen recipes", "by-goal": "unseen goals"}
"""Kinds of split in words."""
FOLDERS = re.compile(r"(?<![\w.])/(?:[^\s/]+/)+")
"""The folders of an absolute path."""
LEVEL = 0.05
"""Least corrected p-value of a difference that may be chance."""
CURVE_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of a training's steps at which its success on test tasks is shown."""
BY_CHANCE = "‡"
"""Mark of a verdict whose difference may be chance after correction."""
NAMES = {
    "no graph": "the paper's attention, no graph",
    "GloVe": "the paper's attention, GloVe",
    "GloVe, shuffled": "GloVe shuffled among the items",
    "random": "random vectors",
    "one-hot": "one-hot vectors",
    "GloVe, simple MLP": "simple MLP, GloVe",
    "learner": "the learner, no graph",
    "learner, shuffled": "the learner, GloVe shuffled",
    "learner, random": "the learner, random vectors",
    "random pair": "two items at random",
    "full, as published, u v": "ComplEx of all recipes",
    "full, as published, u": "ComplEx of all recipes, partners only",
    "full, as published, v": "ComplEx of all recipes, ingredients only",
    "partial, as published, u v": "ComplEx of train recipes, scores of learned recipes",
    "partial, as published, u": "the same, partners only",
    "partial, as published, v": "the same, ingredients only",
    "as published, cross-fitted, u v": "ComplEx of train recipes, scores of unseen recipes",
    "full graph alone, u v": "ComplEx of all recipes, no attention",
    "full graph alone, u": "ComplEx of all recipes, no attention, partners only",
    "full graph alone, v": "ComplEx of all recipes, no attention, ingredients only",
    "partial graph alone, u v": "ComplEx of train recipes, no attention",
}
"""Names of variants in words; others are words already."""


class Checked(NamedTuple):
    """A study on a book, with its summary and the verdicts on the claims of today."""

    results: StudyResults
    view: StudyView
    claims: tuple[ClaimVerdict, ...]

    @property
    def name(self) -> str:
        """The study's name without that of the book."""
        return self.results.name.removesuffix(f"-{self.results.study.settings['book']}")

    @property
    def book(self) -> str:
        """The book's name for people."""
        return BOOKS[str(self.results.study.settings["book"])]


def read_archive(path: Path) -> list[StudyResults]:
    """Return the archive's results."""
    with zipfile.ZipFile(path) as archive:
        return [
            parse_record(archive.read(name), StudyResults, path / name)
            for name in archive.namelist()
        ]


def take(folder: Path, target: Path) -> None:
    """Put the complete built-in studies of a results folder into the archive."""
    archived = {results.name: results for results in read_archive(target)}
    texts = {name: results_text(results) for name, results in archived.items()}
    for name in studies_of(folder):
        results = collect_study(folder, name)
        if results.missing:
            sys.stderr.write(f"{name}: not taken, {len(results.missing)} trainings are missing\n")
        elif name in archived and archived[name].study.seeds > results.study.seeds:
            sys.stderr.write(f"{name}: not taken, the archive has more trainings\n")
        elif not is_built_in(results):
            sys.stderr.write(f"{name}: not taken, its settings are no built-in study's\n")
        else:
            # The results folder may lie anywhere, and the archive names no place of a machine.
            command = FOLDERS.sub("", results.command)
            texts[name] = results_text(structs.replace(results, command=command))
    with staged_file(target, force=True) as staged, zipfile.ZipFile(staged, "w") as archive:
        for name, text in sorted(texts.items()):
            # The same date for all, so that equal results are equal bytes.
            member = zipfile.ZipInfo(f"{name}.json", date_time=(2026, 11, 29, 0, 0, 0))
            archive.writestr(member, text, zipfile.ZIP_DEFLATED, 9)


def is_built_in(results: StudyResults) -> bool:
    """Return whether a study is a built-in one on its book, perhaps with another number of seeds."""
    book = str(results.study.settings.get("book"))
    name = results.name.removesuffix(f"-{book}")
    if name not in ORDER or book not in BOOKS:
        return False
    declared = adapted(read_study(name), book=book, seeds=results.study.seeds)
    # Claims and words may change after the trainings.
    words = ("title", "about", "source", "claims", "drawing", "reference")
    later = {field: getattr(declared, field) for field in words}
    return structs.replace(results.study, **later) == declared


def checked(archived: Iterable[StudyResults]) -> list[Checked]:
    """Return summaries and verdicts, in the order of pages and books."""
    studies = []
    for results in archived:
        book = str(results.study.settings["book"])
        study = read_study(results.name.removesuffix(f"-{book}"))
        studies.append(Checked(results, view_study(results), view_claims(results, study.claims)))
    books = list(BOOKS.values())
    return sorted(studies, key=lambda study: (ORDER.index(study.name), books.index(study.book)))


def cells(studies: list[Checked]) -> Iterator[Cell]:
    """Yield all cells of the studies' tables."""
    by_chance = chance_differences(studies)
    for study in studies:
        yield from success_cells(study)
        if study.name == "parts":
            yield from ppo_cells(study)
        yield from curve_cells(study)
        yield from claim_cells(study, by_chance)
        yield from training_cells(study)
    for table, is_paper in (("claims of the paper", True), ("claims of this project", False)):
        yield from verdict_cells(studies, table, is_paper)


def split_of(values: Values) -> tuple[str, str]:
    """Return the kind of split of a point, in words or empty, and its other settings in words."""
    others = {name: value for name, value in values.items() if name != "split"}
    return KINDS.get(str(values.get("split")), ""), title_of(others)


def success_cells(study: Checked) -> Iterator[Cell]:
    """Yield success by variant; each setting other than the split is a table."""
    for point in study.view.points:
        kind, others = split_of(point.values)
        table = f"success, {others}" if others else "success"
        column = f"{study.book}, {kind}" if kind else study.book
        for entry in point.variants:
            low, high = entry.interval
            row = NAMES.get(entry.variant, entry.variant)
            # One split does not show how splits differ.
            mark = MARK if len(entry.seeds) == 1 else ""
            yield cell(study.name, table, row, column, f"{entry.mean:.3f}{mark}", low, high)


def curve_cells(study: Checked) -> Iterator[Cell]:
    """Yield mean success during training of each trained variant, at the study's first point."""
    point = study.view.points[0].values
    curves: dict[str, list[list[float]]] = {}
    for run in study.results.runs:
        if run.values == point and run.curve:
            steps, success = zip(*run.curve, strict=True)
            shares = np.interp(np.multiply(CURVE_SHARES, run.steps), steps, success)
            curves.setdefault(run.variant, []).append(shares.tolist())
    for variant, trainings in curves.items():
        for share, success in zip(CURVE_SHARES, np.mean(trainings, axis=0), strict=True):
            row, column = NAMES.get(variant, variant), f"{study.book}, {share:.0%} of the steps"
            yield cell(study.name, "learning", row, column, f"{success:.3f}", None, None)


def ppo_cells(study: Checked) -> Iterator[Cell]:
    """Yield success of plain PPO, and what the learner makes more on the same tables."""
    with zipfile.ZipFile(MEASUREMENTS) as archive:
        trainings = json.loads(archive.read("plain-ppo.json")).values()
    book = study.results.study.settings["book"]
    for point in study.view.points:
        kind, others = split_of(point.values)
        played = {
            training["seed"]: training
            for training in trainings
            if training["book"] == book
            and training["split"] == point.values["split"]
            and training["distractors"] == point.values["distractors"]
        }
        runs = [
            run
            for run in study.results.runs
            if run.variant == "learner" and run.values == point.values
        ]
        if not {run.seed for run in runs} <= played.keys():
            continue
        learner = study.results.rates_of(runs)
        assert learner.groups is not None
        assert learner.splits is not None
        trainings_of_splits = [played[run.seed] for run in runs]
        success = [np.array([*each["won"]], float) / each["tables"] for each in trainings_of_splits]
        groups = [group for each in trainings_of_splits for group in each["groups"]]
        # Group numbers mean nothing between studies, but the same tasks have the same groups.
        if len({*zip(learner.groups, learner.splits, groups, strict=True)}) != len(
            {*zip(learner.groups, learner.splits, strict=True)}
        ):
            sys.exit("plain-ppo.json is of other test tasks; run benchmarks/plain_ppo.py again")
        rates = np.concatenate(success)[None]
        low, high = rate_interval(rates, learner.groups, learner.splits)
        mean = np.mean([values.mean() for values in success])
        column = f"{study.book}, {kind}"
        yield cell("parts", f"success, {others}", "plain PPO", column, f"{mean:.3f}", low, high)
        gains = learner.scores - rates
        (gain, low, high), _ = crossed_difference(gains, learner.groups, learner.splits)
        yield cell("parts", "plain PPO", others, column, f"{gain:+.3f}", low, high, "+.3f")


def claim_cells(study: Checked, by_chance: set[int]) -> Iterator[Cell]:
    """Yield verdict and difference of each claim at each point, by book."""
    for checked in study.claims:
        for measured in checked.measured:
            # What is undecided may be chance anyway.
            is_marked = id(measured) in by_chance and checked.verdict != "undecided"
            mark = BY_CHANCE if is_marked else ""
            row = f"{checked.claim.text} | {where(measured.values)}"
            value = f"{checked.verdict}{mark}, {measured.difference:+.3f}"
            low, high = measured.low, measured.high
            yield cell(study.name, "claims", row, study.book, value, low, high, "+.3f")


def where(values: Values) -> str:
    """Return a point in words."""
    return ", ".join(filter(None, split_of(values)))


def verdict_cells(studies: list[Checked], table: str, is_paper: bool) -> Iterator[Cell]:
    """Yield the numbers of verdicts of each claim, by book."""
    for study in studies:
        counts: dict[tuple[str, str], Counter[Verdict]] = {}
        for checked in study.claims:
            claim = checked.claim
            if claim.source.startswith("paper") == is_paper:
                counts.setdefault((claim.text, claim.source), Counter())[checked.verdict] += 1
        for (text, source), verdicts in counts.items():
            place = source.removeprefix("paper, ").removeprefix("this project").lstrip(";, ")
            row = f"[{text}](evidence/{study.name}.md)" + (f" *({place})*" if place else "")
            chips = [chip(verdict, verdicts[verdict]) for verdict in get_args(Verdict)]
            yield Cell("results", table, row, study.book, " ".join(filter(None, chips)), "", "")


def chip(verdict: Verdict, number: int) -> str:
    """Return a verdict with the number of its points, in its colour on the website."""
    if not number:
        return ""
    return f'<span class="verdict {verdict.replace(" ", "-")}">{number} {verdict}</span>'


def training_cells(study: Checked) -> Iterator[Cell]:
    """Yield the extent of a study on a book."""
    entries = [entry for point in study.view.points for entry in point.variants]
    trained = [entry for entry in entries if entry.steps]
    steps = sorted({entry.steps for entry in trained})
    row = f"[{study.results.study.title}](evidence/{study.name}.md) | {study.book}"
    figures = {
        "steps": " and ".join(f"{number:,}" for number in steps),
        "splits": str(max(len(entry.seeds) for entry in entries)),
        "trainings": str(sum(len(entry.seeds) for entry in trained)),
        "test tasks": f"{max(point.tasks for point in study.view.points):,}",
    }
    for column, text in figures.items():
        yield Cell("results", "trainings", row, column, text, "", "")


def chance_differences(studies: list[Checked]) -> set[int]:
    """Return the identities of differences that may be chance after correction over all claims."""
    tested: list[Measured] = []
    for study in studies:
        for checked in study.claims:
            # Other claims say that there is no difference, or that it varies.
            if checked.claim.expected in ("more", "less"):
                tested += [at for at in checked.measured if at.p_value is not None]
    corrected = holm([at.p_value for at in tested if at.p_value is not None])
    return {id(at) for at, p_value in zip(tested, corrected, strict=True) if p_value >= LEVEL}


def cell(
    page: str,
    table: str,
    row: str,
    column: str,
    value: str,
    low: float | None,
    high: float | None,
    form: str = ".3f",
) -> Cell:
    """Return a cell with an interval, if there is one."""
    # Adding 0 takes the sign from a negative zero.
    ends = ["" if end is None else format(round(end, 3) + 0.0, form) for end in (low, high)]
    return Cell(page, table, row, column, value, *ends)


def main() -> None:
    """Write the tables, or check them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--check", action="store_true", help="write nothing; 1 if outdated")
    choice.add_argument("--take", type=Path, metavar="FOLDER", help="first take finished studies")
    options = parser.parse_args()
    if options.take:
        take(options.take, ARCHIVE)
    new = list(cells(checked(read_archive(ARCHIVE))))
    replaced = {(of.page, of.table) for of in new}
    before = read_cells()
    after = [of for of in before if (of.page, of.table) not in replaced] + new
    if after == before:
        return
    if not options.check:
        write_atomically(TABLES, as_csv(after))
    else:
        sys.exit(f"{TABLES.name} is not up to date; run `make docs`")


if __name__ == "__main__":
    main()
