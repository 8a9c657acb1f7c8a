"""``wordcraft-kg people serve``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.apps.people.config import CONSENT, LONGEST_CONSENT, StudyConfig
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import Flag, Output, whole_numbers
from wordcraft_kg.cli.options import Book

if TYPE_CHECKING:
    from wordcraft_kg.apps.people.answers_database import Stored

GROUP = "Tasks and play"
SUBJECT = "Let people take the paper's test in the browser, and compare them with agents: serve, summary."
EXAMPLES = (
    "wordcraft-kg people serve everyday --tasks 20 --out study",
    "wordcraft-kg people serve kitchen --distractors 1,8 --forms 10 --out study",
)


def people_serve(
    graph: Book,
    *,
    out: Path,
    tasks: int = StudyConfig.tasks,
    distractors: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    forms: int = StudyConfig.forms,
    seed: int = StudyConfig.seed,
    consent: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8766,
    allow_host: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    no_browser: Flag = False,
    output: Output = Output(),
) -> None:
    """Let people take the paper's test in the browser, several at once; Ctrl-C ends it, the same command goes on.

    Each answer is on the disk before the next page. Nothing is kept of a person but picks, times, and how
    often a page was loaded.

    Args:
        graph: graph folder, recipe book or known book's name.
        out: folder of the study.
        tasks: train tasks, which are followed by their answers, and as many test tasks.
        distractors: comma-separated numbers of things on a table that the goal does not need. Several are conditions
            that people are spread over evenly. Default: 8.
        forms: number of different draws of tasks that people are spread over evenly; 1 gives all the same tasks.
        seed: seed of the first draw; the others have the seeds that follow.
        consent: text file with what people have to agree to. Default: a text that fits what is stored.
        host: address of this machine to listen on; others than 127.0.0.1, such as 0.0.0.0, open the pages to others.
        port: port to listen on; 0 takes a free one.
        allow_host: a further name or address by which the pages may be asked for, as with --host 0.0.0.0 or behind a
            proxy; several by several options.
        no_browser: do not open the browser.
    """
    from wordcraft_kg.apps.people.study import Study, kept_answers
    from wordcraft_kg.base.extras import check_extra

    check_extra("explore")
    from wordcraft_kg.apps.people.web_app import make_study_app
    from wordcraft_kg.apps.web.serving import Serving, listen, serve

    amounts = whole_numbers("distractors", distractors) if distractors else StudyConfig.distractors
    config = StudyConfig(tasks, tuple(amounts), forms, seed, _consent(consent))
    listening = listen(host, port)  # before anything is written
    try:
        study = Study(graph, config)
        with kept_answers(out, study) as answers:

            def started(address: str) -> None:
                output.result(Serving(address), [f"{address}   {_counts(answers.stored())} so far   Ctrl-C ends it"])

            app = make_study_app(study, answers, host, allow_host or ())
            serve(app, listening, started, in_browser=not no_browser)
            stored = answers.stored()
    finally:
        listening.close()
    print(f"ended; {_counts(stored)} stored in {out}; the same command goes on", file=sys.stderr)


def _consent(path: Path | None) -> str:
    """Return the consent text, with one blank line between paragraphs."""
    if path is None:
        return CONSENT
    if not path.is_file() or path.stat().st_size > 8 * LONGEST_CONSENT:
        raise ConfigError(f"--consent {path}: expected a text file of at most {LONGEST_CONSENT:,} characters.")
    try:
        # Editors of Windows put a mark before it.
        lines = path.read_text(encoding="utf-8-sig").strip().splitlines()
    except UnicodeError:
        raise ConfigError(f"--consent {path}: not a text in UTF-8.") from None
    paragraphs = "\n".join(line.strip() for line in lines).split("\n\n")
    return "\n\n".join(paragraph.strip() for paragraph in paragraphs if paragraph.strip())


def _counts(stored: "Stored") -> str:
    people = f"{stored.people:,} {'person' if stored.people == 1 else 'people'} ({stored.finished:,} finished)"
    return f"{people} and {stored.answers:,} answer{'s' * (stored.answers != 1)}"
