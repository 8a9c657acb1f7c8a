"""``wordcraft-kg study export``."""

from pathlib import Path

from wordcraft_kg.cli.console import Flag, Output

GROUP = "Tasks and play"
EXAMPLES = (
    "wordcraft-kg study export study --out answers.jsonl",
    "wordcraft-kg study export study --out answers.jsonl --force --json",
)


def study_export(folder: Path, *, out: Path, force: Flag = False, output: Output = Output()) -> None:
    """Write the answers of a study as JSON lines, one an answer; it may be served meanwhile.

    Args:
        folder: folder of `study serve`.
        out: file to write.
        force: replace the file if it exists.
    """
    from wordcraft_kg.apps.people.study_folder import read_study
    from wordcraft_kg.apps.people.summary import ExportedAnswers
    from wordcraft_kg.base.artefacts import staged_file
    from wordcraft_kg.base.records import as_lines

    study = read_study(folder)
    lines = as_lines(study.lines())
    with staged_file(out, force=force) as path:
        path.write_text("".join(lines), encoding="utf-8")
    view = ExportedAnswers(str(out), len(study.people), len(lines))
    output.result(view, [f"wrote {out}: answers: {view.answers:,}, people: {view.people:,}"])
