"""Settings of a study with people, and the default consent text."""

from dataclasses import dataclass

from wordcraft_kg.base import ConfigError, whole

TASKS_PER_PART = 40
"""The number in the paper."""
MOST_TASKS = 1_000
"""Maximum number of tasks in a part: more than anybody answers."""
MOST_FORMS = 1_000
MOST_CONDITIONS = 10
LONGEST_CONSENT = 20_000
"""Characters."""
# A promise: answers_database must store nothing else.
CONSENT = """You are invited to take part in a study of how people combine items. Each task shows \
a goal and a set of items. You select the two items that make the goal.

Participation is voluntary. You may stop at any time, without giving a reason and without any \
disadvantage, by closing the page.

We store the items that you select, the time that you take for each task, and the number of times \
its page was loaded. We do not store your name, your IP address, cookies or dates. The stored \
answers contain nothing that identifies you. The answers may be published for research.

You will receive a code. With this code you can continue later or withdraw from the study. If you \
withdraw, all your answers are removed. Do not share the code: anyone who has it can continue \
your session."""


@dataclass(frozen=True)
class StudyConfig:
    """Settings of a study.

    People are spread evenly over forms and conditions.

    Attributes:
        tasks: tasks per part, 1 to 1,000.
        distractors: distractors on a table in each condition, 1 to 10 different numbers.
        forms: sampled task lists, 1 to 1,000; each form after the first has the next seed.
        seed: seed of the first form.
        consent: text that people agree to, 1 to 20,000 characters; blank lines separate paragraphs.
    """

    tasks: int = TASKS_PER_PART
    distractors: tuple[int, ...] = (8,)
    forms: int = 5
    seed: int = 0
    consent: str = CONSENT

    def __post_init__(self) -> None:
        whole("tasks", self.tasks, 1, MOST_TASKS)
        whole("forms", self.forms, 1, MOST_FORMS)
        # The seed of the last form must still fit into an int64.
        whole("seed", self.seed, 0, 2**63 - 1 - MOST_FORMS)
        number = len(self.distractors)
        has_repeated = len(set(self.distractors)) < number
        if has_repeated or not 1 <= number <= MOST_CONDITIONS:
            raise ConfigError(
                f"`num_distractors` {self.distractors}: expected 1 to {MOST_CONDITIONS} "
                "different numbers."
            )
        if not self.consent.strip() or len(self.consent) > LONGEST_CONSENT:
            raise ConfigError(
                f"`consent`: the text has {len(self.consent):,} characters; expected 1 to "
                f"{LONGEST_CONSENT:,}."
            )
