"""What each knowledge source adds to a trained agent, and which sources add nothing.

The agent plays the same tables again with a source's scores set to 0. This asks what the finished
agent gets from the source; what an agent would have learned without it, only another training says.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np

from wordcraft_kg.agents.evaluation import Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.base.statistics import paired_difference
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.policies.sources import with_letters


class SourceGain(Record):
    """What a source adds to a trained agent on the agent's tables.

    Attributes:
        without: success rate of the same agent with the source's scores set to 0.
        gain: the agent's success rate minus `without`.
        gain_ci: 95 % interval for `gain`, by resampling groups of tasks.
    """

    without: Share
    gain: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    gain_ci: tuple[float, float]

    @property
    def adds_nothing(self) -> bool:
        """Whether the agent is not better with the source, by the interval."""
        return self.gain_ci[0] <= 0

    @property
    def sentence(self) -> str:
        """The result in words, to be read after the source's name."""
        verdict = "adds nothing" if self.adds_nothing else "adds to success"
        low, high = self.gain_ci
        return (
            f"{verdict}: with its scores set to 0 the agent makes {self.without:.3f}, "
            f"a difference of {self.gain:+.3f} [{low:+.3f}, {high:+.3f}]"
        )


def source_gains(
    policies: Sequence[Policy], evaluator: Evaluator, results: Sequence[Evaluation]
) -> dict[str, SourceGain]:
    """Let agents play without each of their sources.

    Args:
        policies: the policies of an agent's runs, with the same sources.
        evaluator: the tables.
        results: the evaluation of each policy on these tables, with all sources.

    Returns:
        The gain by each source, by name, such as ``combines (u)``; empty without sources.
    """
    success = np.concatenate([result.success for result in results], axis=1)
    gains = {}
    for source in policies[0].sources:
        played = [evaluator(PolicyPlayer(policy, silent=[source])) for policy in policies]
        without = np.concatenate([result.success for result in played], axis=1)
        gain, low, high = paired_difference(success, without, results[0].groups)
        gains[with_letters([source])] = SourceGain(float(without.mean()), gain, (low, high))
    return gains
