"""A search for settings by optuna: the best on validation tasks, so that test tasks stay unseen."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from wordcraft_kg.agents.agent_config import TaskConfig
from wordcraft_kg.base.errors import ConfigError, TrainingError
from wordcraft_kg.studies.plan import Plan, defaults_of
from wordcraft_kg.studies.study import OF_GRAPH, PLAYER, Study, Value, Values, check_study

_LOG = logging.getLogger(__name__)


def search(study: Study, score: Callable[[Study], float]) -> Study:
    """Return a study with the best settings of ``study.trials`` trials.

    Trials follow from the study alone, so a search that is repeated finds what it has trained.

    Args:
        study: a study with ``search``.
        score: trains a study with the settings of a trial, and returns its validation success; a
            TrainingError is a trial that lost.

    Raises:
        ConfigError: if nothing is to be searched, several variants are, or the split has no
            validation part.
        TrainingError: if all trials failed.
    """
    # Imported here: it takes a second, and studies without a search do without.
    import optuna

    check_searchable(study)
    # A refused setting is our error of one line, not a warning with a traceback.
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    trials = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=0))
    failures: list[TrainingError] = []

    def scored(trial: Any) -> float:
        try:
            return score(_with(study, _suggested(trial, study)))
        except TrainingError as error:
            # Settings at the edge of the space may diverge; the search goes on without them.
            failures.append(error)
            _LOG.warning("trial %d: %s", trial.number + 1, error)
            raise optuna.TrialPruned from error

    trials.optimize(scored, study.trials)
    if len(failures) == study.trials:
        raise failures[-1]
    best = _with(study, trials.best_params)
    shown = ", ".join(f"{name} {value}" for name, value in trials.best_params.items())
    outcome = f"best of {study.trials} trials, validation success {trials.best_value:.3f}"
    return msgspec.structs.replace(best, title=f"{study.title} ({outcome}: {shown})")


def check_searchable(study: Study) -> None:
    """Raise a ConfigError unless a study is a search over one variant with a validation part."""
    if not study.search:
        raise ConfigError("the study has no table [search]; expected the settings to search over.")
    if len(study.variants) > 1 or study.grid or study.claims:
        raise ConfigError("a search is over one variant: leave out grid and claims.")
    (variant,) = study.variants.values()
    if PLAYER in variant:
        raise ConfigError(f"a search is for an agent that is trained, not for a '{PLAYER}'.")
    if not study.settings.get("valid_ratio"):
        raise ConfigError("a search needs validation tasks: set `valid_ratio`, such as 0.1.")
    easier = sorted(study.search.keys() & {*OF_GRAPH, *defaults_of(TaskConfig)} - {"reward"})
    if easier:
        raise ConfigError(
            f"search.{easier[0]} changes the tasks, so that the easiest would win. Put it into "
            "[settings]; search over settings of policy, trainer, scorer and `reward`."
        )


def validation_success(plan: Plan, root: Path) -> float:
    """Return the mean success of a plan's agents on validation tasks."""
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.agents.evaluation import evaluate
    from wordcraft_kg.envs.world import World

    rates = []
    for address in plan.runs:
        agent = open_agent(root / address)
        tasks = agent.config.tasks.environment("valid")
        rates.append(evaluate(agent.policy, World(agent.opened, tasks)).success.mean())
    return float(np.mean(rates))


def _suggested(trial: Any, study: Study) -> Values:
    values: Values = {}
    for name, space in study.search.items():
        if isinstance(space, list):
            values[name] = trial.suggest_categorical(name, space)
        else:
            is_whole = isinstance(space.low, int) and isinstance(space.high, int)
            suggest = trial.suggest_int if is_whole else trial.suggest_float
            values[name] = suggest(name, space.low, space.high, log=space.log)
    return values


def _with(study: Study, values: dict[str, Value]) -> Study:
    trial = msgspec.structs.replace(study, settings=study.settings | values, search={})
    check_study(trial)
    return trial
