"""Settings of a study with people, and the default consent text."""

from dataclasses import dataclass

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import whole

TASKS_PER_PART = 40
"""The paper's number."""
MOST_TASKS = 1_000
"""Most tasks of a part: more than anybody answers."""
MOST_FORMS = 1_000
MOST_CONDITIONS = 10
LONGEST_CONSENT = 20_000
"""Characters."""
CONSENT = """You are asked to take part in a study of how people combine things. Each task names something to make and \
shows a table of things; you pick the two that make it.

Taking part is voluntary. You may stop at any time by closing the page. You need not say why, and it has no \
disadvantage for you.

What is kept: the things that you pick, how long each task takes, and how often its page was loaded. Nothing else is \
kept: no name, no address of your computer, no cookies, no date. Nobody can tell from the answers who gave them. They \
may be published for research.

You get a code with which you can go on later, or withdraw: then all your answers are removed. Keep it to yourself:
whoever has it can go on in your place."""
"""Default consent text."""


@dataclass(frozen=True)
class StudyConfig:
    """Settings of a study.

    Attributes:
        tasks: number of tasks of each part.
        distractors: conditions: numbers of distractors on a table.
        forms: number of draws of tasks; people are spread evenly over forms and conditions.
        seed: seed of the first form; each further form has the next seed.
        consent: consent text; blank lines separate paragraphs.
    """

    tasks: int = TASKS_PER_PART
    distractors: tuple[int, ...] = (8,)
    forms: int = 5
    seed: int = 0
    consent: str = CONSENT

    def __post_init__(self) -> None:
        whole("tasks", self.tasks, 1, MOST_TASKS)
        whole("forms", self.forms, 1, MOST_FORMS)
        whole("seed", self.seed, 0, 2**63 - 1 - MOST_FORMS)
        if not 1 <= len(self.distractors) <= MOST_CONDITIONS or len(set(self.distractors)) < len(self.distractors):
            raise ConfigError(f"`num_distractors` {self.distractors}: expected 1 to {MOST_CONDITIONS} different ones.")
        if not self.consent.strip() or len(self.consent) > LONGEST_CONSENT:
            raise ConfigError(
                f"`consent`: the text has {len(self.consent):,} characters; expected some, and at most "
                f"{LONGEST_CONSENT:,}."
            )
