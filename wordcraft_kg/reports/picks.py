"""An explained pick as a table: the slots of highest logit first, with bars of what the sources contributed."""

from typing import Any

from markupsafe import Markup

from wordcraft_kg.agents.explanation import ExplainedSlot, ExplainedStep
from wordcraft_kg.evaluation.recipe_scores import told
from wordcraft_kg.models.policies.sources import Label, label_of
from wordcraft_kg.reports.charts import contribution_bar
from wordcraft_kg.reports.glossary import GLOSSARY
from wordcraft_kg.reports.training_pictures import COLOURS


def column_labels(step: ExplainedStep) -> list[Label]:
    """Return the labels of the columns of a step's scores."""
    return [label_of(name) for name in step.slots[0].sources]


def slot_rows(step: ExplainedStep) -> list[tuple[ExplainedSlot, Markup]]:
    """Return the slots by descending logit, each with a picture of its contributions, all on one scale."""
    scale = max(
        sum(abs(value) for value in slot.contributions.values() if (value > 0) is to_the_right)
        for slot in step.slots
        for to_the_right in (True, False)
    )
    by_logit = sorted(step.slots, key=lambda slot: slot.logit, reverse=True)
    return [(slot, contribution_bar(slot.contributions, scale, COLOURS)) for slot in by_logit]


PICKS: dict[str, Any] = {
    "colours": COLOURS,
    "column_labels": column_labels,
    "label_of": label_of,
    "slot_rows": slot_rows,
    "told": told,
    "words": {name: GLOSSARY[name].name for name in COLOURS},
}
"""What the template ``picks.html.j2`` needs."""
