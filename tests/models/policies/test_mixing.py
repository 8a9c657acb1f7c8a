"""Mixing: u and v of slots against one question to the scorer each, and mixed logits against a loop over sources."""

import math

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from torch import Tensor

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg.envs.wrappers import KGScoreObservation
from wordcraft_kg.errors import ConfigError
from wordcraft_kg.graphs import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.policies import mixing
from wordcraft_kg.models.policies.mixing import KnowledgeScores, mix_logits
from wordcraft_kg.models.scorers.neighbours import NeighbourScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.scales import scaled_scorer

SIZE = 6
NOTHING = SIZE
SOURCES = (("u",), ("v",), ("u", "v"))
any_sources = pytest.mark.parametrize("sources", SOURCES, ids=",".join)


class OtherScorer:
    """The least that follows the protocol: not one of ours, and with scores that somebody trains."""

    graph_hash = "of no graph"
    entities = tuple("abcdef")

    def __init__(self, seed: int = 0):
        self.scores = torch.randn(len(RELATIONS), SIZE, SIZE, generator=torch.Generator().manual_seed(seed))
        self.scores.requires_grad_()

    def score(self, heads, relations, tails):
        return self.scores[RELATIONS.index(relations) if isinstance(relations, str) else relations, heads, tails]

    def table(self, relation):
        return self.score(torch.arange(SIZE)[:, None], relation, torch.arange(SIZE))


SCORER = OtherScorer()


def states(size: int = 7, num_slots: int = 4) -> tuple[Tensor, Tensor, Tensor]:
    """Goals, selections that differ from row to row and are sometimes nothing, and tables with empty slots."""
    goal = torch.arange(size) % SIZE
    selection = (torch.arange(size) * 2 + 1) % (SIZE + 1)
    table = torch.randint(SIZE + 1, (size, num_slots), generator=torch.Generator().manual_seed(0))
    assert {NOTHING} < set(selection.tolist())
    assert (table == NOTHING).any()
    return goal, selection, table


def slow_scores(sources, goal: Tensor, selection: Tensor, table: Tensor) -> list[list[list[float]]]:
    """``u_i = L(e_i, combinesWith, e_s)`` and ``v_i = L(e_i, componentOf, e_g)``, one question for each slot."""

    def ask(entity: int, relation: str, other: int) -> float:
        return 0.0 if NOTHING in (entity, other) else SCORER.score(entity, relation, other).item()

    found = []
    for g, s, row in zip(goal.tolist(), selection.tolist(), table.tolist(), strict=True):
        u = [ask(entity, "combinesWith", s) for entity in row]
        v = [ask(entity, "componentOf", g) for entity in row]
        found.append([{"u": u, "v": v}[source] for source in sources])
    return found


# --- u and v ---------------------------------------------------------------------------------------------------------


def test_the_scorer_of_these_tests_follows_the_protocol_and_is_not_symmetric():
    assert isinstance(SCORER, TripleScorer)
    assert all(not torch.allclose(SCORER.table(relation), SCORER.table(relation).T) for relation in RELATIONS)


@any_sources
def test_u_and_v_are_the_scores_of_each_slot_with_the_selection_and_with_the_goal(sources):
    state = states()
    found = KnowledgeScores(SIZE, sources, SCORER)(*state)
    assert found.shape == (7, len(sources), 4)
    assert found.dtype == torch.float32
    assert torch.equal(found, torch.tensor(slow_scores(sources, *state)))


@any_sources
def test_every_row_of_a_batch_is_scored_with_its_own_selection_and_goal_unlike_official_bug_a1(sources):
    goal, selection, table = states()
    knowledge = KnowledgeScores(SIZE, sources, SCORER)
    singles = [knowledge(goal[i : i + 1], selection[i : i + 1], table[i : i + 1]) for i in range(len(goal))]
    batched = knowledge(goal, selection, table)
    assert torch.equal(batched, torch.cat(singles))
    tiled = torch.arange(table.numel()) % len(goal)  # the row whose selection and goal the official code would take
    mixed_up = knowledge(goal[tiled], selection[tiled], table.view(-1, 1)).view(7, 4, -1).transpose(1, 2)
    assert not torch.equal(batched, mixed_up)


def test_with_nothing_selected_u_is_exactly_zero_for_every_slot_and_v_is_not():
    goal, _, table = states()
    u, v = KnowledgeScores(SIZE, ("u", "v"), SCORER)(goal, torch.full_like(goal, NOTHING), table).unbind(1)
    assert not u.any()
    assert torch.equal(v != 0, table != NOTHING)


def test_an_empty_slot_scores_zero_with_everything():
    everything = torch.arange(SIZE)
    empty = torch.full((SIZE, 3), NOTHING)
    assert not KnowledgeScores(SIZE, ("u", "v"), SCORER)(everything, everything, empty).any()


@pytest.mark.parametrize("scale", ["standardise", "ranks", "none"])
@pytest.mark.parametrize("self_edges", ["keep", "drop"])
def test_a_policy_sees_exactly_the_scores_that_observations_show(kitchen: RecipeGraph, scale, self_edges):
    scorer = scaled_scorer(NeighbourScorer(kitchen, kitchen.triples[::2]), scale=scale, self_edges=self_edges)
    settings = {"graph": "kitchen", "part": "all", "depth": 2, "num_distractors": 3}
    env = KGScoreObservation(gym.make("WordCraft-v0", **settings), scorer)
    knowledge = KnowledgeScores(kitchen.num_entities, ("u", "v"), scorer)
    rng = np.random.default_rng(0)
    seen, _ = env.reset(seed=0)
    held, empty = 0, 0
    for _ in range(40):
        state = [torch.as_tensor(np.asarray(seen[key]))[None] for key in ("goal", "selection", "table")]
        u, v = knowledge(*state)[0].numpy()
        np.testing.assert_array_equal(u, seen["u"])
        np.testing.assert_array_equal(v, seen["v"])
        held += bool(u.any())
        empty += bool((state[-1] == kitchen.num_entities).any())
        seen, _, over, *_ = env.step(int(rng.choice(np.flatnonzero(seen["action_mask"]))))
        if over:
            seen, _ = env.reset()
    assert min(held, empty) > 0


@any_sources
def test_tables_with_other_strides_are_read_in_the_same_order(sources):
    goal, selection, table = states()
    knowledge = KnowledgeScores(SIZE, sources, SCORER)
    strided = table.T.contiguous().T
    assert not strided.is_contiguous()
    assert torch.equal(knowledge(goal, selection, strided), knowledge(goal, selection, table))


def test_scores_are_constants_even_if_the_scorer_is_being_trained():
    knowledge = KnowledgeScores(SIZE, ("u", "v"), SCORER)
    assert SCORER.table("combinesWith").requires_grad
    assert list(knowledge.parameters()) == []
    assert list(knowledge.state_dict()) == ["scores"]
    assert not knowledge(*states()).requires_grad


def test_later_changes_of_the_scorer_do_not_change_the_scores():
    scorer = OtherScorer(seed=1)
    knowledge = KnowledgeScores(SIZE, ("u", "v"), scorer)
    before = knowledge(*states())
    scorer.scores.data.zero_()
    assert torch.equal(knowledge(*states()), before)
    assert before.any()


def test_without_a_scorer_the_tables_are_zeros_to_be_loaded():
    empty, full = KnowledgeScores(SIZE, ("u", "v")), KnowledgeScores(SIZE, ("u", "v"), SCORER)
    assert not empty(*states()).any()
    empty.load_state_dict(full.state_dict())
    assert torch.equal(empty(*states()), full(*states()))


@any_sources
def test_tables_that_would_not_fit_are_refused_before_the_scorer_is_asked(sources, monkeypatch: pytest.MonkeyPatch):
    needed = len(sources) * (SIZE + 1) ** 2 * 4
    monkeypatch.setattr(mixing, "TABLE_LIMIT", needed)
    KnowledgeScores(SIZE, sources, SCORER)
    monkeypatch.setattr(mixing, "TABLE_LIMIT", needed - 1)
    with pytest.raises(ConfigError, match="scores of all pairs of 6 entities take"):
        KnowledgeScores(SIZE, sources, None)


# --- β ---------------------------------------------------------------------------------------------------------------


def slow_mixture(logits: Tensor, lambdas: Tensor, mask: Tensor) -> list[list[float]]:
    """``β_i = Σ_s λ_s · source_s,i``, and -inf for empty slots."""
    return [
        [
            sum(float(lam * channel[i]) for lam, channel in zip(row, channels, strict=True)) if is_real else -math.inf
            for i, is_real in enumerate(slots)
        ]
        for row, channels, slots in zip(lambdas.double(), logits.double(), mask.tolist(), strict=True)
    ]


@pytest.mark.parametrize("num_sources", [1, 2, 3])
def test_beta_is_the_sum_of_sources_weighted_by_lambda(num_sources: int):
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(5, num_sources, 4, generator=generator)
    lambdas = torch.randn(5, num_sources, generator=generator)
    mask = torch.rand(5, 4, generator=generator) < 0.6
    found = mix_logits(logits, lambdas, mask)
    assert (found.shape, found.dtype) == ((5, 4), torch.float32)
    assert torch.equal(found.isneginf(), ~mask)
    torch.testing.assert_close(found, torch.tensor(slow_mixture(logits, lambdas, mask)))


LARGE = st.floats(-(2.0**100), 2.0**100, width=32) | st.sampled_from([0.0, -1.0, 1e-45, -1e30, 1e30])


@given(lambdas=st.tuples(LARGE, LARGE, LARGE), mask=st.lists(st.booleans(), min_size=4, max_size=4).filter(any))
@example(lambdas=(0.0, 0.0, 0.0), mask=[True, False, False, False])  # official bug A12: λ → 0 unmasked empty slots
@example(lambdas=(1e30, -1e30, 1e30), mask=[False, True, False, True])
def test_a_masked_slot_has_probability_exactly_zero_for_any_lambda(lambdas: tuple[float, ...], mask: list[bool]):
    logits = torch.tensor([[[9.0, 1.0, -3.0, 0.5], [1e3, 2.0, -1e3, 0.0], [0.0, -5.0, 7.0, 1.0]]])
    real = torch.tensor([mask])
    probabilities = torch.softmax(mix_logits(logits, torch.tensor([lambdas]), real), dim=1)
    assert not probabilities.isnan().any()
    assert (probabilities[~real] == 0).all()
    assert float(probabilities.sum()) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("lam", [math.nan, math.inf, -math.inf, 3e38])
def test_a_masked_slot_stays_masked_even_if_lambda_is_broken(lam: float):
    mixed = mix_logits(torch.ones(1, 2, 3), torch.tensor([[lam, 1.0]]), torch.tensor([[True, False, True]]))
    assert mixed[0, 1] == -torch.inf


def test_masked_slots_neither_receive_nor_send_gradients():
    logits = torch.ones(1, 2, 3).requires_grad_()
    lambdas = torch.tensor([[2.0, 3.0]]).requires_grad_()
    mixed = mix_logits(logits * torch.tensor([1.0, 10.0, 1.0]), lambdas, torch.tensor([[True, False, True]]))
    torch.log_softmax(mixed, dim=1)[0, 0].backward()
    assert logits.grad.isfinite().all()
    assert lambdas.grad.isfinite().all()
    assert not logits.grad[:, :, 1].any()
    torch.testing.assert_close(logits.grad[0, :, 0], torch.tensor([1.0, 1.5]))
