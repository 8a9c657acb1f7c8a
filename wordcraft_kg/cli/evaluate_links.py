"""``wordcraft-kg evaluate-links``."""

import sys
from pathlib import Path
from typing import Any

from wordcraft_kg.cli.console import Flag, Output, aligned

EXAMPLES = (
    "wordcraft-kg evaluate-links models/everyday",
    "wordcraft-kg evaluate-links models/everyday --json --force",
)


def evaluate_links(
    model: Path,
    *,
    graph: str | None = None,
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> int:
    """Rank the triples that a model has never seen and write the report; leaked triples never count.

    Args:
        model: model folder.
        graph: where the graph is now, if it has moved since the training.
        out: folder to write. Default: report/ in the model folder.
        force: replace the report if there is one.
    """
    from wordcraft_kg.artefacts import check_output

    folder = out or model / "report"
    if model.is_dir():
        check_output(folder, force=force)
    from wordcraft_kg.models.links.folder import open_model
    from wordcraft_kg.reports.link_report import make_link_report, summary_values, write_link_report

    trained = open_model(model, graph)
    report = make_link_report(
        trained.scorer,
        trained.opened,
        kg=trained.kg,
        name=model.name,
        provenance=trained.provenance,
        trace=trained.trace,
    )
    write_link_report(report, folder, force=force)
    values = summary_values(report.values) | {"report": str(folder / "index.html")}
    output.result(values, _text(report.values, folder))
    # Coverage is the split's own choice (by-goal cannot have it); the other checks must hold for any figure to count.
    failed = [check for check in report.values["checks"] if not check["passed"] and check["id"] != "coverage"]
    for check in failed:
        print(f"CHECK FAILED: {check['name']} ({check['detail']})", file=sys.stderr)
    return 1 if failed else 0


def _text(values: dict[str, Any], folder: Path) -> list[str]:
    metrics, baselines = values["metrics"], values["baselines"]

    def figures(table: dict[str, Any]) -> str:
        if not table["queries"]:
            return "no queries"
        interval = f" [{table['mrr_ci'][0]:.3f}, {table['mrr_ci'][1]:.3f}]" if "mrr_ci" in table else ""
        return f"MRR {table['mrr']:.3f}{interval}  hits@1 {table['hits@1']:.3f}  hits@10 {table['hits@10']:.3f}"

    rows = [(name, figures(metrics[name])) for name in ("all", "combinesWith", "componentOf")]
    rows += [(name, figures(table["all"])) for name, table in baselines.items()]
    if values["model"]["has_seen_the_test_recipes"]:
        first = f"{values['triples']:,} triples of the graph, all of them seen in training: memory, not prediction"
    else:
        first = f"{values['triples']:,} unseen triples; {values['leaked_left_out']:,} leaked ones left out"
        others = [row for row in values["drill_down"]["near_synonyms"] if row["slice"] == "no such train recipe"]
        rows += [
            ("no near-synonym", f"{figures(row)}  (recipes that no train recipe nearly repeats)") for row in others
        ]
        rows.append(("with leaked", f"MRR {values['with_leaked']['mrr']:.3f}, inflated: training contains them"))
    return [first, *aligned(rows), f"wrote {folder}/   open {folder / 'index.html'}"]
