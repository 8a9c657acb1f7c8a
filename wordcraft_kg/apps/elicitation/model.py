"""Registration for model folders by ``ask-opinions``, through the entry-point group ``wordcraft_kg.models``."""

from wordcraft_kg.apps.elicitation.config import OpinionsConfig
from wordcraft_kg.apps.elicitation.records import OpinionMetrics
from wordcraft_kg.apps.elicitation.scorer import OpinionScorer
from wordcraft_kg.models.folder import MODELS
from wordcraft_kg.models.model import History
from wordcraft_kg.models.scorers.folder import SCORERS
from wordcraft_kg.runs.files import RunFiles


def _opinions_history(files: RunFiles) -> History:
    config, metrics = OpinionsConfig.read(files.folder), files.record("metrics.json", OpinionMetrics)
    facts = {
        "asked by": " ".join(files.run.argv),
        "what it is": f"{metrics.opinions:,} opinions of {config.model} at {config.endpoint}",
        "answered as": ", ".join(metrics.models) or "not said",
        "prompts": f"{metrics.prompts:,}, wording {metrics.template[:12]}",
    }
    return History(config, facts, metrics, is_trained=False)


MODELS.update(dict.fromkeys(OpinionsConfig.commands, _opinions_history))
SCORERS[OpinionScorer.kind] = OpinionScorer
