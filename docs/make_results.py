"""Write docs/results.md, and the evidence pages of the studies, from docs/results.zip.

    python docs/make_results.py [--check | --take FOLDER]

The committed results hold figures and hashes, and nothing of a book. With --take, a built-in study
of a results folder takes the place of its file in the archive if it has at least three seeds of all
variants. Players without an agent come from docs/study-players.json.

docs/results.md has a row for each claim with its verdicts; a study of both books is a page of
docs/evidence/, with its long tables folded.
"""

import argparse
import json
import re
import sys
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePath
from typing import NamedTuple, get_args

import msgspec
import numpy as np

from wordcraft_kg.base.artefacts import staged_file, write_atomically
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.records import parse_record
from wordcraft_kg.base.statistics import FEWEST_PAIRS
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.splits import SplitConfig
from wordcraft_kg.studies.claims import ClaimVerdict, Verdict, in_words, share, signed, view_claims
from wordcraft_kg.studies.results import StudyResults, collect_study, results_text, studies_of
from wordcraft_kg.studies.study import Study, Values, built_in, read_study
from wordcraft_kg.studies.view import (
    PointMetrics,
    ScorerScatter,
    StudyView,
    VariantMetrics,
    title_of,
    view_study,
)

HERE = Path(__file__).parent
ARCHIVE = HERE / "results.zip"
"""The results of the studies, a JSON file each."""
BEGIN, END = "<!-- results -->\n", "<!-- end of results -->"
MEASURED = "November 2026"
"""When the studies ran; the stored results have no dates."""
MOST_ROWS = 12
"""Of an evidence page's table that is not folded."""
MOST_BYTES = 2 * 1024 * 1024
"""Of all committed results together."""
ORDER = ("embeddings", "knowledge", "sources", "alone", "splits", "depth2", "csrl", "training-data")
BOOKS = {"little-alchemy-2": "Little Alchemy 2", "everyday": "`everyday`"}
FEWEST = 3
"""Seeds from which on a study takes the place of an earlier file."""
WIDE = 0.05
"""Standard deviation of success over seeds from which on the page shows each seed."""
NO_AGENT = (
    "random pairs",
    "nearest words",
    "recipe scorer alone, u v",
    "recipe scorer alone, w",
    "planner, p",
)


class Question(NamedTuple):
    """An evidence page's title, the answer in words, and the claim with its figures."""

    title: str
    answer: str
    claim: str


QUESTIONS = {
    "embeddings": Question(
        "Does the meaning of word vectors help an agent?",
        "Mostly: GloVe vectors are far above the same vectors shuffled among the entities, but on Little "
        "Alchemy 2 with 8 distractors random vectors, of six times the dimension, are above GloVe.",
        "Meaning makes the difference: shuffled GloVe vectors are much worse.",
    ),
    "knowledge": Question(
        "Do full and partial graphs help an agent?",
        "A full graph helps drastically. A partial graph helps if the agent learns from scores of unseen recipes.",
        "Cross-fitted scores alone improve the agent as published.",
    ),
    "sources": Question(
        "Which links help an agent: partners, ingredients, or both?",
        "With the full graph, scores of ingredients are better than scores of partners, and both together are best.",
        "Full graph: the better score, u or v, depends on the number of distractors.",
    ),
    "alone": Question(
        "How far do an agent's scores get without attention?",
        "Not to 100 %, even with the full graph.",
        "The full graph alone does not give 100 % either.",
    ),
    "splits": Question(
        "Does a graph help with new goals and slots?",
        "Yes, with scores of whole recipes. Scores of links from ComplEx add little, and harm where they are of learned recipes.",
        "Scores of whole recipes help with new goals or slots, too.",
    ),
    "depth2": Question(
        "Can agents make goals that need an intermediate?",
        "Yes, with scores of plans; agents with other scores stay far below.",
        "With scores of plans (p) a partial graph drastically improves success at depth 2.",
    ),
    "csrl": Question(
        "Do the conditions of CSRL change the picture?",
        "No: scores of whole recipes help in all three conditions.",
        "Scores of whole recipes help in all three conditions.",
    ),
    "training-data": Question(
        "Do better links make better agents?",
        "More train recipes do, with unseen recipes: success rises with the number of recipes that the scorer "
        "learns from. Links from equally many right recipes are not compared.",
        "Agents with the whole partial graph are better than agents with half of the graph.",
    ),
}
"""The question of each built-in study. A study without one has its title and first claim."""
TRAIN_RATIO = SplitConfig().train_ratio
OVER_TASKS = "†"
"""Mark of an interval over tasks where tasks are in groups: no success by task was kept, so it is
too narrow.
"""
PLAYED = "graph", "split", "depth", "distractors", "distractor_seeds", "tasks"
PLAIN = {
    "no graph": "agent without a graph",
    "full, u v": "ComplEx of all recipes",
    "full, as published, u v": "ComplEx of all recipes, the paper's equations",
    "full, as published, u": "ComplEx of all recipes, the paper's equations, partners only",
    "full, as published, v": "ComplEx of all recipes, the paper's equations, ingredients only",
    "full, released code, u v": "ComplEx of all recipes, the paper's program",
    "partial, u v": "ComplEx, scores of unseen recipes",
    "partial, in-sample, u v": "ComplEx, scores of learned recipes",
    "partial, as published, u v": "ComplEx, scores of learned recipes, the paper's equations",
    "partial, as published, u": "the same, partners only",
    "partial, as published, v": "the same, ingredients only",
    "as published, cross-fitted, u v": "ComplEx, scores of unseen recipes, the paper's equations",
    "partial, released code, u v": "ComplEx, scores of learned recipes, the paper's program",
    "partial, u v w": "recipe scorer",
    "partial, u v w, no penalty": "recipe scorer, without penalty",
    "partial, u v w p": "recipe scorer with plans",
    "full graph alone, u v": "ComplEx of all recipes, no attention",
    "full graph alone, u": "ComplEx of all recipes, no attention, partners only",
    "full graph alone, v": "ComplEx of all recipes, no attention, ingredients only",
    "partial graph alone, u v": "ComplEx of train recipes, no attention",
    "in-sample": "scores of learned recipes",
    "cross-fitted": "scores of unseen recipes",
    "train tasks in-sample": "scores of learned recipes",
    "train tasks out of sample": "scores of unseen recipes",
    "random": "random vectors",
    "one-hot": "one-hot vectors",
    "no agent: recipe scorer alone, u v": "no agent: recipe scorer alone, by links",
    "no agent: recipe scorer alone, w": "no agent: recipe scorer alone, by recipes",
    "no agent: planner, p": "no agent: planner",
}
"""Names of the studies' variants and players in words."""
PHRASES = {
    "Cross-fitted scores alone improve the agent as published": (
        "Scores of unseen recipes alone improve the agent by the paper's equations"
    ),
    ": train tasks scored in-sample, or cross-fitted; w scores whole recipes,": (
        "; the recipe scorer is played"
    ),
    ", train tasks scored in-sample or, in one variant, cross-fitted": "",
    "cross-fitted u and v": "link scores of unseen recipes",
    "cross-fitted scores": "scores of unseen recipes",
    "cross-fitted with": "scores of unseen recipes with",
    "cross-fitted agents": "agents with scores of unseen recipes",
    "In-sample agents": "Agents with scores of learned recipes",
    "In-sample scores": "Scores of learned recipes",
    "in-sample scores": "scores of learned recipes",
    "in-sample with": "scores of learned recipes with",
    "in-sample knowledge is": "scores of learned recipes are",
    "scored in-sample": "with scores of learned recipes",
    "scored out of sample": "with scores of unseen recipes",
    '"Released code" follows the settings of the paper\'s code': (
        "*The paper's program* has the settings of the code that its authors released"
    ),
    "the released code": "the paper's program",
    '"As published" follows the equations of the paper': "*The paper's equations* means",
    '"As published"': "*The paper's equations*",
    "as published": "by the paper's equations",
    "self edges": "links of an item with itself",
}
"""Words of claims and settings in words for all readers, the longer phrases first."""
NAMES = re.compile(
    rf"(?<=\| )({'|'.join(map(re.escape, PLAIN))})(?= \|)|"
    rf"(?<=\*)({'|'.join(map(re.escape, PLAIN))})(?=\*)"
)
"""Such a name as a table's cell or in italics."""
FOLDERS = re.compile(r"(?<![\w.])/(?:[^\s/]+/)+")
"""The folders of an absolute path."""


def name_of(results: StudyResults) -> str:
    """Return the study's name without the book's name; `reproduce` joins the two."""
    return results.name.removesuffix(f"-{book_of(results)}")


def book_of(results: StudyResults) -> str:
    """Return the book's name; with several books, the first graph's."""
    return PurePath(str(results.study.settings.get("book", results.graphs[0].name))).stem


def current(results: StudyResults) -> Study:
    """Return the package's version of the study, with the newest claims and words; else the version
    of the run.
    """
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
        missing=tuple(
            msgspec.structs.replace(lost, why=FOLDERS.sub("", lost.why)) for lost in results.missing
        ),
    )


def of_first_seeds(results: StudyResults, seeds: int) -> StudyResults:
    """Return results with the first ``seeds`` seeds only: their origins, graphs and hours of
    agents.
    """
    kept = [run for run in results.runs if run.seed < seeds]
    graphs = sorted({run.graph for run in kept})
    origins = Counter(run.origin for run in kept)
    numbers = sorted(origins) if results.origins else [0]
    runs = (
        msgspec.structs.replace(
            run, graph=graphs.index(run.graph), origin=numbers.index(run.origin)
        )
        for run in kept
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


def take(folder: Path, target: Path) -> None:
    """Copy the results of a results folder's studies into the archive: of a built-in one the seeds
    that all variants have, from ``FEWEST`` on.
    """
    texts = {results.name: results_text(results) for results in read_all(target)}
    for name in studies_of(folder):
        results = collect_study(folder, name)
        complete = min((lost.seed for lost in results.missing), default=results.study.seeds)
        if name_of(results) in ORDER:
            if complete < FEWEST:
                continue
            results = of_first_seeds(results, complete)
        if results.runs:
            texts[name] = results_text(without_paths(results))
    with staged_file(target, force=True) as staged, zipfile.ZipFile(staged, "w") as archive:
        for name, text in sorted(texts.items()):
            # The same date for all, so that equal results are equal bytes.
            member = zipfile.ZipInfo(f"{name}.json", date_time=(2026, 11, 29, 0, 0, 0))
            archive.writestr(member, text, zipfile.ZIP_DEFLATED, 9)


def read_all(path: Path) -> list[StudyResults]:
    """Return the committed results in the order of the page; none without the archive."""
    if not path.exists():
        return []
    if path.stat().st_size > MOST_BYTES:
        sys.exit(
            f"the results take {path.stat().st_size:,} bytes; {MOST_BYTES:,} are the most to commit. "
            "Leave studies out."
        )
    with zipfile.ZipFile(path) as archive:
        studies = [
            parse_record(archive.read(name), StudyResults, path / name)
            for name in archive.namelist()
        ]
    order = {name: number for number, name in enumerate(ORDER)}
    books = {name: number for number, name in enumerate(BOOKS)}
    return sorted(
        studies,
        key=lambda of: (
            order.get(name_of(of), len(order)),
            name_of(of),
            books.get(book_of(of), len(books)),
        ),
    )


def page(found: list[StudyResults], views: list[StudyView]) -> Iterator[str]:
    """Yield the lines of the index of claims."""
    if not found:
        yield "No study has been run yet: this page fills itself from the files in `docs/results.zip`."
        return
    evaluated = [(results, view_claims(results, current(results).claims)) for results in found]
    yield "## Claims of the paper"
    yield ""
    yield f"{verdicts(evaluated, of_paper=True).capitalize()}."
    yield ""
    yield from claim_groups(evaluated, of_paper=True)
    yield "## Claims of this project"
    yield ""
    yield f"{verdicts(evaluated, of_paper=False).capitalize()}."
    yield ""
    yield from claim_groups(evaluated, of_paper=False)
    yield "## The studies"
    yield ""
    number = len({run.run for results in found for run in results.runs})
    yield (
        f"In all {number:,} different trainings: one that several studies or points of a grid "
        "share runs once, and counts in each."
    )
    yield ""
    yield from folded("Steps, seeds and trainings of each study", studies_table(found, views))


def studies_table(found: list[StudyResults], views: list[StudyView]) -> Iterator[str]:
    """Yield the lines of a table of the studies."""
    has_gaps = any(results.missing for results in found)
    yield f"| study | book | steps | seeds | trainings |{' missing |' * has_gaps}"
    yield f"|---|---|---|---|---|{'---|' * has_gaps}"
    for results, view in zip(found, views, strict=True):
        trainings = f"{len(results.runs)}" + f" | {len(results.missing) or ''}" * has_gaps
        yield (
            f"| [{current(results).title}]({page_of(results)}) | {shown_book(results)} | "
            f"{steps_of(view)} | {seeds_of(view)} | {trainings} |"
        )
    yield ""


def page_of(results: StudyResults) -> str:
    """Return the path of a study's evidence page below docs/."""
    return f"evidence/{name_of(results)}.md"


def claim_groups(
    evaluated: list[tuple[StudyResults, tuple[ClaimVerdict, ...]]], *, of_paper: bool
) -> Iterator[str]:
    """Yield a folded table for each study with claims, its verdicts in the line that stays."""
    groups: dict[str, list[tuple[StudyResults, ClaimVerdict]]] = {}
    for results, claims in evaluated:
        own = [claim for claim in claims if claim.source.startswith("paper") == of_paper]
        groups.setdefault(current(results).title, []).extend((results, claim) for claim in own)
    for title, group in groups.items():
        if group:
            counts = Counter(claim.verdict for _, claim in group)
            yield from folded(f"{title} {chips(counts)}", claim_rows(group))
            yield ""


def claim_rows(group: list[tuple[StudyResults, ClaimVerdict]]) -> Iterator[str]:
    """Yield the lines of a table with a row for each claim, and the number of its points by verdict
    and book.
    """
    counts: dict[tuple[str, str], dict[str, Counter[Verdict]]] = {}
    for results, claim in group:
        of_book = counts.setdefault((claim.text, claim.source), {})
        of_book.setdefault(shown_book(results), Counter())[claim.verdict] += 1
    page = page_of(group[0][0])
    books = list(dict.fromkeys(shown_book(results) for results, _ in group))
    yield f"| claim | {' | '.join(books)} |"
    yield f"|---|{'---|' * len(books)}"
    for (text, source), found in counts.items():
        texts = (chips(found.get(book, Counter())) for book in books)
        where = source.removeprefix("paper, ").removeprefix("this project, ")
        yield f"| [{text}]({page}) *({where})* | {' | '.join(texts)} |"
    yield ""


def chips(counts: Counter[Verdict]) -> str:
    """Return verdicts with their numbers of points, the most favourable first."""
    return " ".join(
        chip(verdict, counts[verdict]) for verdict in get_args(Verdict) if counts[verdict]
    )


def chip(verdict: Verdict, number: int) -> str:
    """Return a verdict with the number of its points, in the verdict's colour on the website."""
    return f'<span class="verdict {verdict.replace(" ", "-")}">{number} {verdict}</span>'


def verdicts(
    evaluated: list[tuple[StudyResults, tuple[ClaimVerdict, ...]]], *, of_paper: bool
) -> str:
    """Return how many verdicts of each kind there are."""
    given = [
        claim
        for _, claims in evaluated
        for claim in claims
        if claim.source.startswith("paper") == of_paper
    ]
    counts = Counter(claim.verdict for claim in given)
    few = Counter(claim.verdict for claim in given if is_provisional(claim))
    texts = {
        name: f"{counts[name]} {name}" + (f" ({few[name]} provisional)" if few[name] else "")
        for name in counts
    }
    return ", ".join(texts[name] for name in get_args(Verdict) if name in texts) or "none"


def is_provisional(claim: ClaimVerdict) -> bool:
    """Return whether a verdict rests on too few seeds to be firm."""
    decided = claim.verdict not in ("undecided", "not run")
    return decided and any(measured.seeds < FEWEST_PAIRS for measured in claim.measured)


def shown_book(results: StudyResults) -> str:
    """Return the name of the book for people."""
    return BOOKS.get(book_of(results), book_of(results))


def steps_of(view: StudyView) -> str:
    """Return the steps of the trainings."""
    return " to ".join(f"{steps:,}" for steps in _ends(entry.steps for entry in _entries(view)))


def seeds_of(view: StudyView) -> str:
    """Return how many seeds the cells have."""
    return " to ".join(
        str(number) for number in _ends(len(entry.seeds) for entry in _entries(view))
    )


def _ends(values: Iterable[int]) -> list[int]:
    found = set(values)
    return sorted({min(found), max(found)})


def _entries(view: StudyView) -> list[VariantMetrics]:
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


def evidence(of: list[tuple[StudyResults, StudyView]]) -> Iterator[str]:
    """Yield the lines of the evidence page of a study on each of its books."""
    study = current(of[0][0])
    name = name_of(of[0][0])
    claim = next((claim.text for claim in study.claims), "")
    question = QUESTIONS.get(name, Question(study.title, claim, claim))
    yield "<!-- generated by docs/make_results.py -->"
    yield f"# {question.title}"
    yield ""
    yield f"**Answer.** {' '.join(answer(of, question))}"
    yield ""
    head, *lines = main_table(*of[0])
    first_column = head.split("|")[2].strip()
    where = f"{shown_book(of[0][0]).strip('`')}, {first_column}"
    shown = "Correlation" if of[0][1].scatters else "Success"
    yield f"<!-- figure: {shown}, {where} | {shown.lower()} = {first_column} -->"
    yield ""
    yield from (head, *lines)
    yield ""
    yield (
        "Rows are agents by the scores that they use. Scores of *learned* recipes come from a scorer "
        'trained on the very recipes that the agent practises ("in-sample"); of *unseen* recipes, '
        'from scorers that left them out ("cross-fitted"). *Partners*: links combinesWith; '
        "*ingredients*: componentOf. †: interval over tasks, too narrow."
    )
    yield ""
    yield "## Method"
    yield ""
    yield f"{' '.join(study.about.split())} *{study.source}.*"
    yield (
        f"Agents train for {steps_of(of[0][1])} steps, with "
        f"{' and '.join(f'{seeds_of(view)} seeds on {shown_book(results)}' for results, view in of)}. "
        "Success is the share of test episodes in which the greedy agent makes the goal, "
        "with a 95 % interval over seeds and tasks ([intervals](intervals.md))."
    )
    yield ""
    yield "## Caveats"
    yield ""
    yield "- One split of each kind (seed 0): intervals say nothing about other splits and books."
    if study.settings.get("depth", 1) != 1:
        yield (
            "- At depth 2: tasks and tables of before all tables had one size "
            "([why they have](../explanation/leaks.md#the-number-of-items-tells-the-form))."
        )
    commands = {scorer.get("command") for scorer in study.scorers.values()}
    if "train-recipes" in commands:
        yield (
            "- Scores of whole recipes and plans are those of the recipe scorer by tables, before "
            "neighbour lists ([the difference](recipe-scorer.md#lists))."
        )
    for results, view in of:
        for point in view.points:
            for text in uneven(point):
                yield f"- {shown_book(results)}, {point.title}: {text}"
        if results.missing:
            yield f"- Missing: {missing_text(results)}."
    yield ""
    yield "## Command"
    yield ""
    yield "```"
    yield from (results.command for results, _ in of)
    yield "```"
    yield ""
    yield (
        f"{MEASURED}, {origins_of([results for results, _ in of])}. "
        f"Figures: {', '.join(stored(results) for results, _ in of)} in [results.zip](../results.zip)."
    )
    for results, view in of:
        yield ""
        yield from folded(f"All claims and figures: {shown_book(results)}", details(results, view))


def answer(of: list[tuple[StudyResults, StudyView]], question: Question) -> Iterator[str]:
    """Yield the answer in words, and the figures of its claim at the first point of each book."""
    yield question.answer
    for results, _ in of:
        for claim in view_claims(results, current(results).claims):
            if claim.text == question.claim and claim.measured:
                measured = claim.measured[0]
                where = f"{shown_book(results)}, {title_of(measured.values)}"
                figures = in_words(claim, measured, mark="*")
                yield f"{where}: {figures}."
                break


def stored(results: StudyResults) -> str:
    """Return the name of the file with a study's figures."""
    return f"`{results.name}.json`"


def folded(summary: str, lines: Iterable[str]) -> Iterator[str]:
    """Yield lines that a reader unfolds; GitHub and the website show both."""
    yield "<details markdown>"
    yield f"<summary>{summary.replace('`', '')}</summary>"
    yield ""
    yield from lines
    yield "</details>"


def main_table(results: StudyResults, view: StudyView) -> Iterator[str]:
    """Yield the page's first table: success of the variants on the first book, a column a point."""
    book = shown_book(results)
    if view.scatters:
        yield f"| {book}: correlation over scorers | MRR and success | MRR and steps, by rank |"
        yield "|---|---|---|"
        for scatter in view.scatters:
            cells = [
                f"{of.value:+.2f} [{of.low:+.2f}, {of.high:+.2f}]" if of else ""
                for of in (scatter.pearson, scatter.steps_spearman)
            ]
            yield f"| train tasks {'in-sample' if scatter.in_sample else 'out of sample'} | {' | '.join(cells)} |"
        return
    yield f"| {book} | {' | '.join(point.title for point in view.points)} |"
    yield f"|---|{'---|' * len(view.points)}"
    for variant, cells in list(rows_of(results, view).items())[:MOST_ROWS]:
        yield f"| {variant} | {' | '.join(cells)} |"


def in_plain_words(line: str) -> str:
    """Return a line of a page with the names of variants, and of scorers' training data, in words."""
    line = NAMES.sub(lambda name: PLAIN[name[0]], line)
    for phrase, words in PHRASES.items():
        line = line.replace(phrase, words)
    line = re.sub(r"train_fraction (1|0\.\d)", lambda of: f"{float(of[1]):.0%} of recipes", line)
    return re.sub(r"label_noise (0\.\d+)", lambda of: f"{float(of[1]):.0%} wrong results", line)


def rows_of(results: StudyResults, view: StudyView) -> dict[str, list[str]]:
    """Return success with its interval by variant and player, a cell for each point."""
    rows: dict[str, list[str]] = {}
    for number, point in enumerate(view.points):
        texts = {entry.variant: success_text(entry) for entry in point.variants}
        texts |= {name: success for name, success, *_ in without_agent(results, point)}
        for name, text in texts.items():
            rows.setdefault(name, [""] * len(view.points))[number] = text
    return rows


def success_text(entry: VariantMetrics) -> str:
    """Return a variant's success with its interval."""
    low, high = entry.interval
    return f"{share(entry.mean)} [{share(low)}, {share(high)}]"


def details(results: StudyResults, view: StudyView) -> Iterator[str]:
    """Yield the long tables of a study: claims, and figures of each point."""
    study = current(results)
    yield from claims_table(view_claims(results, study.claims))
    yield ""
    if view.scatters:
        for scatter in view.scatters:
            yield from scatter_table(results, view, scatter)
    else:
        for point in view.points:
            yield from point_table(results, view, point)
    graphs = [
        f"{of.name} `{of.hash[:12]}` ({of.kind}, split `{of.split[:12]}`)" for of in results.graphs
    ]
    yield f"Graphs: {', '.join(graphs)}."
    yield ""


def uneven(point: PointMetrics) -> Iterator[str]:
    """Yield a sentence for each variant whose seeds differ much."""
    for entry in point.variants:
        if len(entry.success) > 1 and np.std(entry.success, ddof=1) > WIDE:
            yield (
                f"Seeds of *{entry.variant}* differ much: "
                f"{', '.join(share(rate) for rate in entry.success)}."
            )


def origins_of(found: list[StudyResults]) -> str:
    """Return the platforms of the trainings, and the versions of packages that all trainings on a
    platform had.
    """
    made: dict[str, dict[str, str]] = {}
    for of in (of for results in found for of in results.origins):
        versions = made.setdefault(of.platform, of.versions)
        made[of.platform] = {
            name: at for name, at in versions.items() if of.versions.get(name) == at
        }
    texts = (
        f"{who}: {', '.join(f'{name} {at}' for name, at in made[who].items())}"
        for who in sorted(made)
    )
    return "; ".join(texts) or "not recorded"


def without_agent(
    results: StudyResults, point: PointMetrics
) -> Iterator[tuple[str, str, str, float]]:
    """Yield the players without an agent on the tasks of a point.

    Yields:
        name, success as text, success by the own recipe as text, and success.
    """
    path = HERE / "study-players.json"
    settings = {"depth": 1, "distractors": 1} | results.study.settings | point.values
    point_of = (settings["depth"], settings["distractors"], point.distractor_seeds, point.tasks)
    at = {(graph.hash, graph.split, *point_of) for graph in point.graphs}
    is_grouped = settings["depth"] > 1 or any(
        graph.kind not in ("by-recipe", "by-recipe-plain") for graph in point.graphs
    )
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    for row in sorted(rows, key=lambda row: NO_AGENT.index(row["player"])):
        if tuple(row[key] for key in PLAYED) in at:
            success = f"{share(row['success'])} [{share(row['low'])}, {share(row['high'])}]"
            success += OVER_TASKS if is_grouped and "groups" not in row else ""
            name = f"*no agent: {row['player']}*"
            yield name, success, share(row["by_plan"]), row["success"]


def point_table(results: StudyResults, view: StudyView, point: PointMetrics) -> Iterator[str]:
    """Yield the lines of a table of all variants at a point of the grid, and of players without an agent."""
    has_mrr = any(entry.mrr is not None for entry in point.variants)
    yield f"{point.title[0].upper()}{point.title[1:]}, {counted(point.tasks, 'test task')}:"
    yield ""
    yield (
        f"| | seeds |{' MRR |' * has_mrr} success | more than {view.reference} | own recipe | on "
        "train tasks |"
    )
    yield f"|---|---|{'---|' * has_mrr}---|---|---|---|"
    for entry in point.variants:
        mrr = f" {'' if entry.mrr is None else share(entry.mrr)} |" * has_mrr
        success = success_text(entry)
        more = ""
        if entry.comparison:
            low, high = entry.comparison.interval
            more = f"{signed(entry.comparison.difference)} [{signed(low)}, {signed(high)}]"
        train = "" if entry.train is None else share(entry.train)
        own = share(entry.by_plan)
        yield (
            f"| {entry.variant} | {len(entry.seeds)} |{mrr} {success} | {more} | {own} | {train} |"
        )
    for name, success, own, _ in without_agent(results, point):
        yield f"| {name} | |{' |' * has_mrr} {success} | | {own} | |"
    yield ""


def scatter_table(results: StudyResults, view: StudyView, scatter: ScorerScatter) -> Iterator[str]:
    """Yield the lines of a table of success by the scorer's MRR."""
    how = (
        "train tasks scored in-sample" if scatter.in_sample else "train tasks scored out of sample"
    )
    yield f"{how.capitalize()}{f', {title_of(scatter.values)}' if scatter.values else ''}:"
    yield ""
    yield f"| scorer | MRR | success | steps to where {view.reference} ends |"
    yield "|---|---|---|---|"
    if scatter.without is not None:
        yield f"| none |  | {share(scatter.without)} |  |"
    for at in scatter.points:
        low, high = at.interval
        reached = "never" if at.reached is None else f"{at.reached:,}"
        yield (
            f"| {at.label} | {share(at.mrr)} | {share(at.success)} [{share(low)}, {share(high)}] | "
            f"{reached} |"
        )
    at = [point for point in view.points if point.values.items() >= scatter.values.items()]
    rows = dict.fromkeys(
        (name, success) for point in at for name, success, *_ in without_agent(results, point)
    )
    for name, success in rows:
        yield f"| {name} | | {success} | |"
    yield ""
    correlations = {
        "of MRR and success, Pearson": scatter.pearson,
        "Spearman": scatter.spearman,
        "of MRR and steps, Spearman": scatter.steps_spearman,
    }
    said = [
        f"{name} {of.value:+.2f} [{of.low:+.2f}, {of.high:+.2f}]"
        for name, of in correlations.items()
        if of
    ]
    if said:
        yield (
            f"Correlation over these scorers, with the 95 % interval over them: {', '.join(said)}."
        )
        yield ""


def missing_text(results: StudyResults) -> str:
    """Return which trainings have no results, and why."""
    reasons: dict[str, list[tuple[str, Values, int]]] = {}
    for lost in results.missing:
        reasons.setdefault(lost.why, []).append((lost.variant, lost.values, lost.seed))
    return "; ".join(
        f"{counted(len(of), 'training')} ({why}), the first {of[0][0]}"
        f"{f', {title_of(of[0][1])}' if of[0][1] else ''}, seed {of[0][2]}"
        for why, of in reasons.items()
    )


def replaced(text: str, marks: tuple[str, str], lines: Iterable[str]) -> str:
    """Return a text with new lines between two marks."""
    before, found, rest = text.partition(marks[0])
    return (
        before + found + "\n" + "\n".join(lines) + "\n" + marks[1] + rest.partition(marks[1])[2]
        if found
        else text
    )


def written(studies: list[StudyResults], text: str) -> dict[str, str]:
    """Return the index and the evidence pages, by path below docs/."""
    views = [view_study(results) for results in studies]
    files = {"results.md": replaced(text, (BEGIN, END), map(in_plain_words, page(studies, views)))}
    by_page: dict[str, list[tuple[StudyResults, StudyView]]] = {}
    for results, view in zip(studies, views, strict=True):
        by_page.setdefault(page_of(results), []).append((results, view))
    for path, of in by_page.items():
        files[path] = "\n".join(map(in_plain_words, evidence(of))) + "\n"
    return files


def main() -> None:
    """Write the pages and the pictures, or check them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--check", action="store_true", help="write nothing; exit code 1 if something would change"
    )
    choice.add_argument(
        "--take", type=Path, metavar="FOLDER", help="first copy the studies of a results folder"
    )
    options = parser.parse_args()
    try:
        if options.take:
            take(options.take, ARCHIVE)
        files = written(read_all(ARCHIVE), (HERE / "results.md").read_text(encoding="utf-8"))
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
