"""Registration of model folders by the command ``elicit``, in the entry-point group ``wordcraft_kg.models``."""

from wordcraft_kg.apps.elicitation.config import ElicitationConfig
from wordcraft_kg.apps.elicitation.records import ElicitationMetrics
from wordcraft_kg.apps.elicitation.scorer import ElicitedScorer
from wordcraft_kg.models.folder import MODELS
from wordcraft_kg.models.model import History
from wordcraft_kg.models.scorers.folder import SCORERS
from wordcraft_kg.runs.files import RunFiles


def _elicited_history(files: RunFiles) -> History:
    config, metrics = ElicitationConfig.read(files.folder), files.record("metrics.json", ElicitationMetrics)
    facts = {
        "command": " ".join(files.run.argv),
        "content": f"{metrics.elicited:,} recipes elicited from {config.model} at {config.endpoint}",
        "answering model": ", ".join(metrics.models) or "unknown",
        "prompts": f"{metrics.prompts:,}, template {metrics.template[:12]}",
    }
    return History(config, facts, metrics, is_trained=False)


MODELS.update(dict.fromkeys(ElicitationConfig.commands, _elicited_history))
SCORERS[ElicitedScorer.kind] = ElicitedScorer
