"""Sums over people: rates by condition and part, their intervals, and an agent at
the same tables."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from tests.apps.people.stored import answered, other_world, posed
from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.apps.people.answers_database import Cell, Participant
from wordcraft_kg.apps.people.study import HumanStudy, Session
from wordcraft_kg.apps.people.study_config import StudyConfig
from wordcraft_kg.apps.people.summary import AgentGame, agent_successes, view_people
from wordcraft_kg.base import ArtefactError, GraphMismatchError, checked_values
from wordcraft_kg.base.statistics import wilson_interval
from wordcraft_kg.models.policies.states import States


def session(study, right, form=0):
    """Somebody's answers: a digit for each, 1 for a right one."""
    cell = Cell(form, study.record.distractors[0])
    turns = zip(study.tasks(cell), right, strict=False)
    protocol = study.protocol(cell)
    answers = tuple(answered(protocol, task, digit == "1") for task, digit in turns)
    assert [answer.success for answer in answers] == [digit == "1" for digit in right]
    return Session(study.record, Participant(1, cell), answers)


def study_of(graph, distractors=8, tasks=3):
    return HumanStudy(graph, StudyConfig(tasks=tasks, distractors=(distractors,)))


@pytest.fixture(scope="module")
def study(kitchen):
    return study_of(kitchen)


def summed(*sessions, agents=None):
    """Sum up studies of one person each."""
    studies = {Path(str(number)): [one] for number, one in enumerate(sessions)}
    view = view_people(studies, agents or {})
    checked_values(view)
    return view


def test_each_part_is_summed_up_over_all_sessions(study):
    view = summed(*(session(study, right) for right in ("110100", "1110", "")))
    assert view.graph == "kitchen"
    assert view.settings == study.record.settings
    (condition,) = view.conditions
    assert (condition.distractors, condition.sessions, condition.finished) == (8, 3, 1)
    train, test = condition.parts["train"], condition.parts["test"]
    assert (train.answered, train.successes, train.people) == (6, 5, 2)
    assert (train.rate, train.interval) == (5 / 6, wilson_interval(5, 6))
    assert (test.answered, test.successes, test.people) == (4, 1, 2)
    assert train.agents == {}


def test_the_interval_over_people_is_that_of_all_resamples_of_people(study):
    """With two people there are four resamples, which a thousand draws meet about equally often."""
    row = summed(session(study, "111"), session(study, "100")).conditions[0].parts["train"]
    drawn = [np.mean([3, 3]) / 3, np.mean([3, 1]) / 3, np.mean([1, 3]) / 3, np.mean([1, 1]) / 3]
    assert row.people_interval == pytest.approx((min(drawn), max(drawn)))


@pytest.mark.parametrize("answers", ["111", "000"])
def test_people_all_right_or_wrong_have_an_interval(study, answers):
    """People who are all right or all wrong have an interval and not a point."""
    people = [session(study, right) for right in (answers[:2], answers, answers[:1])]
    made = {
        one.table_of(answer): AgentGame(answers == "111", answer.number)
        for one in people
        for answer in one.answers
    }
    row = summed(*people, agents={"agent": made}).conditions[0].parts["train"]
    right = 3 * (answers == "111")
    assert row.people_interval == wilson_interval(right, 3)
    assert (row.agents["agent"].tables, row.agents["agent"].interval) == (
        3,
        wilson_interval(right, 3),
    )


def test_one_person_alone_has_no_interval_over_people(study):
    """One person alone has no interval over people and none without answers."""
    parts = summed(session(study, "111")).conditions[0].parts
    assert parts["train"].people_interval is None
    assert (parts["test"].interval, parts["test"].rate, parts["test"].people) == (None, None, 0)


@pytest.mark.parametrize("what", ["graph", "split"])
def test_another_graph_or_split_is_not_summed_up(study, kitchen, what):
    with pytest.raises(GraphMismatchError, match=f"{what}_hash"):
        summed(session(study, "1"), session(study_of(other_world(kitchen, what)), "1"))


def test_a_session_is_not_counted_twice_but_unbegun_ones_are_alike(study):
    with pytest.raises(ArtefactError, match="1 has the same answers as 0"):
        summed(session(study, "10"), session(study, "10"))
    assert summed(session(study, ""), session(study, "")).conditions[0].sessions == 2


@pytest.fixture(scope="module")
def agent(recipes_folder, tmp_path_factory):
    """A little trained agent of the kitchen, whose scorer is cross-fitted."""
    from wordcraft_kg.agents.agent_config import AgentConfig, ImpalaConfig, TaskConfig
    from wordcraft_kg.agents.agent_training import train_agent

    trainer = ImpalaConfig(steps=2_000, eval_every=0)
    config = AgentConfig("kitchen", str(recipes_folder), TaskConfig(distractors=4), trainer=trainer)
    folder = tmp_path_factory.mktemp("runs") / "guided"
    train_agent(config, folder)
    return open_agent(folder)


@torch.no_grad()
def is_solved(policy, env, seen):
    """Whether two greedy picks in a person's environment make the goal."""
    number = torch.tensor([env.state.task]) if env.config.part == "train" else None
    for _ in range(2):
        batch = [torch.as_tensor(seen[name])[None] for name in ("goal", "selection", "table")]
        states = States(*batch, task=number)
        # A policy of pairs takes the best pair, whose first slot may not be the likeliest one.
        slots = policy.best_slots(states, policy.weights(), policy.external_scores(states))
        seen, _, _, _, info = env.step(int(slots))
    return info["outcome"] == "goal"


def test_an_agents_interval_resamples_what_the_split_holds_out_together(study):
    """Twelve tables in two groups: the two groups decide, not the tables."""
    people = [session(study, "101", form) for form in range(4)]
    keys = [one.table_of(answer) for one in people for answer in one.answers]
    alike = {key: AgentGame(number % 2 == 0, number % 2) for number, key in enumerate(keys)}
    apart = {key: AgentGame(number % 2 == 0, number) for number, key in enumerate(keys)}
    widths = []
    for made in (alike, apart):
        low, high = (
            summed(*people, agents={"agent": made})
            .conditions[0]
            .parts["train"]
            .agents["agent"]
            .interval
        )
        widths.append(high - low)
    assert widths[0] > 1.5 * widths[1]


def test_an_agent_is_compared_at_the_table_of_each_answer(agent):
    study = study_of(agent.opened, 5, tasks=20)
    people = [session(study, "1" * 40), session(study, "0" * 7), session(study, "01" * 12, 1)]
    made = agent_successes(agent, people)
    assert len(made) == 40 + 24
    view = summed(*people, agents={"guided": made})
    for part, row in view.conditions[0].parts.items():
        expected = []
        for seed, one in zip((0, 0, 1), people, strict=True):
            for answer in one.answers:
                if answer.part == part:
                    shown = posed(study.protocol(one.person.cell), seed, part, answer.number)
                    expected.append(is_solved(agent.policy, *shown))
        rate = row.agents["guided"]
        assert (rate.successes, row.answered) == (sum(expected), len(expected))
        assert 0 < rate.rate == sum(expected) / len(expected) < 1
        assert rate.tables == len({(key[1], key[3]) for key in made if key[2] == part})
        assert rate.interval[0] <= rate.rate <= rate.interval[1]


@pytest.mark.slow
def test_an_agent_of_another_graph_or_split_is_refused(agent, kitchen):
    for graph in (other_world(kitchen, "split"), "everyday"):
        with pytest.raises(GraphMismatchError):
            agent_successes(agent, [session(study_of(graph, 5), "1")])


def test_answers_at_a_table_that_is_not_posed_today_are_refused(agent):
    one = session(study_of(agent.opened, 5), "1")
    turned = replace(
        one, answers=(msgspec.structs.replace(one.answers[0], table=one.answers[0].table[::-1]),)
    )
    with pytest.raises(ArtefactError, match="poses another task"):
        agent_successes(agent, [turned])
