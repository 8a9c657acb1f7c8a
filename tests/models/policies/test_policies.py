"""Policies and attention against loops that follow the paper's formulas, and what holds for every
policy."""

import itertools
import math

import pytest
import torch
from helpers import refuses
from hypothesis import example, given, strategies as st
from slow_attention import SlowAttention, dot, softmax
from small_scorers import BareScorer, normal, states as states_of

from wordcraft_kg import PolicyConfig, make_sources
from wordcraft_kg.base.errors import ConfigError, NotRegisteredError
from wordcraft_kg.models.policies.networks import (
    FOLD_LIMIT,
    AttentionPolicy,
    MLPPolicy,
    TableAttention,
    masked_softmax,
    slot_products,
)
from wordcraft_kg.models.policies.pairs import LENGTH, PairPolicy
from wordcraft_kg.models.policies.policy import EntityVectors, log_policy, look_up, mix_logits
from wordcraft_kg.models.policies.states import Attempts, States

SIZE = 7

NOTHING = SIZE

SLOTS = 5

SIZES = {"key_size": 3, "value_size": 4, "hidden_size": 6, "pair_size": 5}

SCORER = BareScorer(SIZE, seed=1)

FEATURES = {
    "dense": lambda: EntityVectors(SIZE, normal(SIZE, 4)),
    "identity": lambda: EntityVectors(SIZE, torch.eye(SIZE)),
    "one-hot": lambda: EntityVectors(SIZE),
}


def randomised(policy, scale=0.5):
    """Give all parameters values that say something, the same for policies of one shape."""
    for i, parameter in enumerate(policy.parameters()):
        parameter.data = normal(*parameter.shape, seed=i) * scale
    return policy


def attention(features="dense", knows=False, **settings):
    config = PolicyConfig(**SIZES, **settings)
    sources = make_sources(config.sources, SCORER) if knows else ()
    return randomised(AttentionPolicy(config, FEATURES[features](), sources))


def pairs(features="dense", knows=False):
    config = PolicyConfig("pairs", mixing="residual", **SIZES)
    sources = make_sources(config.sources, SCORER) if knows else ()
    return randomised(PairPolicy(config, FEATURES[features](), sources))


def mlp(features="dense", num_slots=SLOTS):
    return randomised(MLPPolicy(PolicyConfig("mlp", **SIZES), FEATURES[features](), num_slots))


KINDS = {
    "attention": lambda: attention(),
    "attention to one-hot vectors": lambda: attention("one-hot"),
    "raw read-out of one-hot vectors": lambda: attention("one-hot", value_readout="logits"),
    "all sources, free": lambda: attention(knows=True),
    "all sources, softmax": lambda: attention(
        "one-hot", knows=True, mixing="softmax", value_readout="logits"
    ),
    "all sources, residual": lambda: attention(knows=True, mixing="residual"),
    "v only, residual": lambda: attention(knows=True, use="v", kg_only=True, mixing="residual"),
    "alpha and u": lambda: attention(knows=True, use="u", mixing="softmax"),
    "scores only": lambda: attention("dense", knows=True, kg_only=True),
    "v only": lambda: attention(knows=True, use="v", kg_only=True, mixing="softmax"),
    "pairs": lambda: pairs(),
    "pairs by one-hot vectors": lambda: pairs("one-hot"),
    "all sources, pairs by vectors": lambda: pairs("dense", knows=True),
    "mlp": lambda: mlp(),
}

SYMMETRIC = [kind for kind in KINDS if not kind.startswith("mlp")]

ATTENTIVE = [kind for kind in SYMMETRIC if "pairs" not in kind]

KNOWING = [kind for kind in ATTENTIVE if "attention" not in kind and "raw" not in kind]

any_policy = pytest.mark.parametrize("kind", KINDS)

any_attention = pytest.mark.parametrize("kind", ATTENTIVE)

any_symmetric = pytest.mark.parametrize("kind", SYMMETRIC)


def states(size=9, seed=0):
    return states_of(SIZE, size, SLOTS, seed)


def channels(output):
    """The tensors of an output that are there."""
    return {name: value for name, value in output._asdict().items() if value is not None}


def same(found, expected, *, exactly=False):
    """Compare the tensors of two outputs."""
    for name, tensor in channels(expected).items():
        torch.testing.assert_close(
            channels(found)[name], tensor, **({"atol": 0, "rtol": 0} if exactly else CLOSE)
        )


CLOSE = {"atol": 1e-5, "rtol": 1e-5}


class Slow(SlowAttention):
    """With the sources of SCORER, and the multi-layer perceptron on all slots."""

    def sources(self, goal, selection, row):
        """α, u and v as far as they are in use."""
        held = selection != NOTHING
        u = [
            SCORER.score(entity, "combinesWith", selection).item() if held else 0.0
            for entity in row
        ]
        v = [SCORER.score(entity, "componentOf", goal).item() for entity in row]
        alpha = [] if self.config.kg_only else [self.alpha(goal, selection, row)]
        return alpha + [{"u": u, "v": v}[source] for source in self.config.sources]

    def beta(self, goal, selection, row):
        """``β_i = λα·α_i + λu·u_i + λv·v_i``."""
        sources = self.sources(goal, selection, row)
        lambdas = self.lambdas(self.alpha(goal, selection, row), row)
        return [dot(lambdas, [source[i] for source in sources]) for i in range(len(row))]

    def mlp(self, goal, selection, row):
        """One hidden layer on everything in its order, empty slots as zeros; logits of all slots,
        and the value."""
        everything = [y for entity in (goal, selection, *row) for y in self.x[entity]]
        inner = [max(y, 0.0) for y in self.layer("hidden", everything)]
        return self.layer("logits", inner), self.layer("value", inner)[0]


def one_by_one(state):
    """Goal, selection, the slots that hold something, and what they hold, for each state."""
    for goal, selection, row in zip(*(part.tolist() for part in state), strict=True):
        real = [i for i, entity in enumerate(row) if entity != NOTHING]
        yield goal, selection, real, [row[i] for i in real]


def close(found, expected):
    torch.testing.assert_close(
        found.double(), torch.tensor(expected).double(), atol=1e-5, rtol=1e-4
    )


@pytest.mark.parametrize("fold_limit", [FOLD_LIMIT, 3])
@pytest.mark.parametrize("kind", [kind for kind in ATTENTIVE if kind not in KNOWING])
def test_the_policy_is_scaled_dot_product_attention(kind, fold_limit, monkeypatch):
    """The policy is the softmax of scaled dot products of query and keys."""
    monkeypatch.setattr("wordcraft_kg.models.policies.networks.FOLD_LIMIT", fold_limit)
    policy, state = KINDS[kind](), states()
    logits = policy(States(*state)).logits
    for i, (goal, selection, real, row) in enumerate(one_by_one(state)):
        alpha = Slow(policy).alpha(goal, selection, row)
        close(logits[i, real], alpha)
        close(torch.softmax(logits[i], 0)[real], softmax(alpha))


@any_attention
def test_the_value_is_an_mlp_of_the_attention_weighted_table(kind):
    policy, state = KINDS[kind](), states()
    slow = Slow(policy)
    expected = [
        slow.head("value", slow.alpha(g, s, row), row)[0] for g, s, _, row in one_by_one(state)
    ]
    close(policy(States(*state)).value, expected)
    assert max(expected) - min(expected) > 0.01


@pytest.mark.parametrize("left", [1, 2, 5, 9])
@pytest.mark.parametrize("features", FEATURES)
def test_a_policy_that_sees_attempts_adds_the_terms_of_the_phase(features, left):
    """The phase has its own terms in the attention logits, the value and the mixing weights."""
    policy, state = attention(features, knows=True, sees_attempts=True), states()
    slow = Slow(policy)
    attempts = Attempts(torch.full((len(state[0]),), left))
    output = policy(States(*state, attempts=attempts))
    for i, (goal, selection, real, row) in enumerate(one_by_one(state)):
        phase = 2 * (min(left, 5) - 1) + int(selection != NOTHING)
        added = [dot(slow.p["phases.rows"][phase], slow.x[entity]) for entity in row]
        alpha = [a + b for a, b in zip(slow.alpha(goal, selection, row), added, strict=True)]
        close(output.sources[i, 0, real], alpha)
        close(output.value[i], slow.head("value", alpha, row)[0] + slow.p["phases.value"][phase])
        lambdas = slow.head("mixture", alpha, row)
        terms = slow.p["phases.lambdas"][phase]
        close(output.lambdas[i], [a + b for a, b in zip(lambdas, terms, strict=True)])


def test_a_policy_that_sees_attempts_needs_them_and_starts_blind():
    seeing = AttentionPolicy(PolicyConfig(**SIZES, sees_attempts=True), FEATURES["dense"]())
    other = AttentionPolicy(PolicyConfig(**SIZES), FEATURES["dense"]())
    seeing.load_state_dict(other.state_dict(), strict=False)
    state = states()
    attempts = Attempts(torch.arange(1, 1 + len(state[0])))
    found = seeing(States(*state, attempts=attempts))
    expected = other(States(*state))
    assert torch.equal(found.logits, expected.logits)
    assert torch.equal(found.value, expected.value)
    with pytest.raises(ConfigError, match="needs the attempts left"):
        seeing(States(*state))


@pytest.mark.parametrize("kind", KNOWING)
def test_beta_mixes_alpha_u_and_v_by_lambda(kind):
    """Beta mixes alpha u and v by lambda an mlp of the attention weighted table."""
    policy, state = KINDS[kind](), states()
    slow, output = Slow(policy), policy(States(*state))
    for i, (goal, selection, real, row) in enumerate(one_by_one(state)):
        close(output.lambdas[i], slow.lambdas(slow.alpha(goal, selection, row), row))
        for channel, expected in zip(
            output.sources[i], slow.sources(goal, selection, row), strict=True
        ):
            close(channel[real], expected)
        close(output.logits[i, real], slow.beta(goal, selection, row))
    shapes = {
        name: tuple(p.shape) for name, p in policy.named_parameters() if name.startswith("mixture")
    }
    if policy.config.mixing == "residual":
        assert not shapes
    else:
        assert shapes["mixture.0.weight"] == (SIZES["value_size"], policy.vectors.dim)
        assert shapes["mixture.2.weight"] == (len(policy.labels), SIZES["value_size"])


@pytest.mark.parametrize("sees_attempts", [False, True])
def test_residual_mixing_with_weights_of_0_is_the_policy_without_sources(sees_attempts):
    knowing = attention(knows=True, mixing="residual", sees_attempts=sees_attempts)
    ignorant = attention(sees_attempts=sees_attempts)
    weights = knowing.state_dict()
    ignorant.load_state_dict({name: weights[name] for name in ignorant.state_dict()})
    with torch.no_grad():
        knowing.lambdas.step.fill_(-1 / 30)
        assert knowing.lambdas()[1:].abs().max() < 1e-6
        knowing.lambdas.first[1:] = 0
        knowing.lambdas.step.zero_()
        if sees_attempts:
            knowing.phases.lambdas.zero_()
    state = States(*states(), attempts=Attempts(torch.ones(9, dtype=torch.int64)))
    found, expected = knowing(state), ignorant(state)
    assert found.sources[:, 1:].any()
    assert torch.equal(found.logits, expected.logits)
    assert torch.equal(found.value, expected.value)


@pytest.mark.parametrize("kg_only", [False, True])
def test_residual_mixing_begins_with_a_weight_of_1_for_each_source(kg_only):
    config = PolicyConfig(**SIZES, mixing="residual", kg_only=kg_only)
    policy = AttentionPolicy(config, FEATURES["dense"](), make_sources(["u", "v"], SCORER))
    lambdas = policy(States(*states())).lambdas
    assert lambdas.shape == (9, len(policy.labels))
    assert (lambdas == 1).all()
    assert policy.lambdas.step.shape == (2,)


@pytest.mark.parametrize("features", sorted(FEATURES.keys() - {"one-hot"}))
def test_the_mlp_has_one_hidden_layer_on_all_slots_in_order(features):
    """The mlp has one hidden layer on goal selection and all slots in their order."""
    policy, state = mlp(features), states()
    output = policy(States(*state))
    for i, whole in enumerate(zip(*(part.tolist() for part in state), strict=True)):
        logits, value = Slow(policy).mlp(*whole)
        real = [slot for slot, entity in enumerate(whole[2]) if entity != NOTHING]
        close(output.logits[i, real], [logits[slot] for slot in real])
        close(output.value[i], value)


@any_policy
def test_rows_of_a_batch_equal_single_states_unlike_in_the_released_code(kind):
    policy, state = KINDS[kind](), states()
    batch = channels(policy(States(*state)))
    for i in range(9):
        for name, single in channels(policy(States(*(part[i : i + 1] for part in state)))).items():
            torch.testing.assert_close(batch[name][i : i + 1], single, **CLOSE)
    if policy.labels:
        scores = slice(0 if policy.config.kg_only else 1, None)
        singles = [
            policy(States(*(part[i : i + 1] for part in state))).sources[:, scores]
            for i in range(9)
        ]
        assert torch.equal(batch["sources"][:, scores], torch.cat(singles))


@any_policy
def test_every_parameter_and_nothing_else_receives_a_finite_gradient(kind):
    policy, state = KINDS[kind](), states()
    logits, value, *_ = policy(States(*state))
    taken = (state[2] != NOTHING).int().argmax(1)
    (torch.log_softmax(logits, 1)[torch.arange(9), taken].sum() + (value**2).sum()).backward()
    for name, parameter in policy.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        has_no_say = kind == "v only" and name.startswith(
            "mixture"
        )  # the softmax of one number is 1
        assert parameter.grad.any() != has_no_say, name
    names = {name for name, _ in policy.named_parameters()}
    constants = set(policy.state_dict()) - names
    assert constants == {"vectors.vectors", *(f"sources.{name}.scores" for name in policy.sources)}
    assert not any(buffer.requires_grad for buffer in policy.buffers())


@any_symmetric
@given(order=st.permutations(range(SLOTS)), seed=st.integers(0, 20))
def test_permuting_the_slots_permutes_the_logits_and_leaves_the_value(kind, order, seed):
    policy, (goal, selection, table) = KINDS[kind](), states(seed=seed)
    plain, permuted = (
        policy(States(goal, selection, table)),
        policy(States(goal, selection, table[:, order])),
    )
    sources = None if plain.sources is None else plain.sources[:, :, order]
    same(permuted, plain._replace(logits=plain.logits[:, order], sources=sources))


@any_symmetric
def test_empty_slots_at_the_end_of_a_table_change_nothing(kind):
    policy, (goal, selection, table) = KINDS[kind](), states()
    plain = policy(States(goal, selection, table))
    wide = policy(States(goal, selection, torch.cat([table, torch.full((9, 3), NOTHING)], dim=1)))
    torch.testing.assert_close(wide.logits[:, :SLOTS], plain.logits, **CLOSE)
    torch.testing.assert_close(wide.value, plain.value, **CLOSE)
    assert wide.logits[:, SLOTS:].isneginf().all()


@pytest.mark.parametrize(
    ("use", "scores"),
    [("u", ("u",)), ("v", ("v",)), ("u,v", ("u", "v")), (" v , u ", ("u", "v")), ("u,u", ("u",))],
)
@pytest.mark.parametrize("kg_only", [False, True])
def test_a_source_that_is_switched_off_takes_no_weight(use, scores, kg_only):
    """A source that is switched off takes no weight unlike in the released code."""
    policy = attention(knows=True, use=use, kg_only=kg_only, mixing="softmax")
    output = policy(States(*states()))
    names = scores if kg_only else ("alpha", *scores)
    assert tuple(label.name for label in policy.labels) == names
    assert output.lambdas.shape == (9, len(names))
    assert output.sources.shape == (9, len(names), SLOTS)
    assert (output.lambdas > 0).all()
    torch.testing.assert_close(output.lambdas.sum(1), torch.ones(9))


@pytest.mark.parametrize("kg_only", [False, True])
def test_with_nothing_selected_u_cannot_change_the_policy(kg_only):
    goal, _, table = states()
    nothing = torch.full_like(goal, NOTHING)
    policy = attention(knows=True, kg_only=kg_only)
    before = policy(States(goal, nothing, table))
    assert not before.sources[:, [label.name for label in policy.labels].index("u")].any()
    policy.sources["u"].scores[:NOTHING] += 100
    assert torch.equal(policy(States(goal, nothing, table)).logits, before.logits)
    held = torch.zeros_like(goal)
    assert (policy(States(goal, held, table)).sources - before.sources).abs().max() > 50


def test_free_coefficients_begin_at_about_one_for_every_source():
    config = PolicyConfig(**SIZES, mixing="free")
    policy = AttentionPolicy(config, FEATURES["dense"](), make_sources(["u", "v"], SCORER))
    assert policy.mixture[2].bias.tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("num_slots", [SLOTS - 1, SLOTS + 1])
def test_the_mlp_refuses_another_size_of_table(num_slots):
    """The mlp refuses another size of table and says which it was made for."""
    table = torch.zeros(2, num_slots, dtype=torch.int64)
    with pytest.raises(
        ConfigError, match=rf"tables have {num_slots} slots: this mlp was made for {SLOTS}"
    ):
        mlp()(States(table[:, 0], table[:, 0], table))


SIZES_OF = ("key_size", "value_size", "hidden_size", "pair_size")

REFUSED = {
    "dropout": (-0.1, 1, "no"),
    "policy": ("attentoin", "MLP"),
    "pooling": ("maxx",),
    "mixing": ("sofmax", 3),
    "scale": ("standardize", "rank", 1),
    "self_edges": ("dropp",),
    "value_readout": ("logit",),
    **dict.fromkeys(SIZES_OF, (0, -1, 2.5)),
    "use": ("", " ", "x", "u,", "u,x", "uv", "U", "u;v"),
    **dict.fromkeys(("allow_missing", "kg_only"), ("no", 1, None)),
}


@pytest.mark.parametrize(
    ("setting", "value"), [(name, value) for name, values in REFUSED.items() for value in values]
)
def test_a_setting_that_cannot_be_is_refused_by_its_name(setting, value):
    with refuses(setting, NotRegisteredError if setting in ("use", "policy") else ConfigError):
        PolicyConfig(**{setting: value})


KEY_SIZE = 3

NUM_ENTITIES = 7


def attention_of(dim):
    attention = TableAttention(dim, KEY_SIZE)
    for i, parameter in enumerate(attention.parameters()):
        parameter.data = normal(*parameter.shape, seed=i + 1)
    return attention


def alpha_of(attention, vectors, goal, selection, table):
    rows = attention.rows({**vectors.weights(), **attention.weights()}, goal, selection)
    weights = vectors.weights()
    slot_vectors = look_up(weights["vectors"], table) if weights else None
    return slot_products(rows, slot_vectors, table)


@st.composite
def masked_logits(draw):
    """Logits as large as their differences can be, and masks with at least one slot that holds
    something."""
    size, num_slots = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    numbers = st.floats(-(2.0**126), 2.0**126, width=32) | st.floats(-5, 5, width=32)
    row = st.lists(numbers, min_size=num_slots, max_size=num_slots)
    filled = st.lists(st.booleans(), min_size=num_slots, max_size=num_slots).filter(any)
    logits = torch.tensor(draw(st.lists(row, min_size=size, max_size=size)))
    return logits, torch.tensor(draw(st.lists(filled, min_size=size, max_size=size)))


@given(masked_logits())
def test_the_log_policy_is_the_log_of_the_softmax_with_slots_first(drawn):
    logits, mask = drawn
    found = log_policy(logits.masked_fill(~mask, -torch.inf))
    assert found.shape == logits.T.shape
    assert torch.equal(found.isneginf(), ~mask.T)
    torch.testing.assert_close(found.exp(), masked_softmax(logits, mask).T)


LARGE = st.floats(-(2.0**100), 2.0**100, width=32) | st.sampled_from(
    [0.0, -1.0, 1e-45, -1e30, 1e30]
)


@given(
    lambdas=st.tuples(LARGE, LARGE, LARGE),
    mask=st.lists(st.booleans(), min_size=4, max_size=4).filter(any),
)
@example(
    lambdas=(0.0, 0.0, 0.0), mask=[True, False, False, False]
)  # in the released code λ → 0 unmasks empty slots
@example(lambdas=(1e30, -1e30, 1e30), mask=[False, True, False, True])
def test_a_masked_slot_has_probability_exactly_zero_for_any_lambda(lambdas, mask):
    logits = torch.tensor([[[9.0, 1.0, -3.0, 0.5], [1e3, 2.0, -1e3, 0.0], [0.0, -5.0, 7.0, 1.0]]])
    real = torch.tensor([mask])
    probabilities = torch.softmax(mix_logits(logits, torch.tensor([lambdas]), real), dim=1)
    assert not probabilities.isnan().any()
    assert (probabilities[~real] == 0).all()
    assert float(probabilities.sum()) == pytest.approx(1, abs=1e-5)


MIDDLE_IS_EMPTY = torch.tensor([[True, False, True]])


@pytest.mark.parametrize("lam", [math.nan, math.inf, -math.inf, 3e38])
def test_a_masked_slot_stays_masked_even_if_lambda_is_broken(lam):
    assert (
        mix_logits(torch.ones(1, 2, 3), torch.tensor([[lam, 1.0]]), MIDDLE_IS_EMPTY)[0, 1]
        == -torch.inf
    )


def test_masked_slots_neither_receive_nor_send_gradients():
    logits = torch.ones(1, 2, 3).requires_grad_()
    lambdas = torch.tensor([[2.0, 3.0]]).requires_grad_()
    mixed = mix_logits(logits * torch.tensor([1.0, 10.0, 1.0]), lambdas, MIDDLE_IS_EMPTY)
    torch.log_softmax(mixed, dim=1)[0, 0].backward()
    assert logits.grad.isfinite().all()
    assert lambdas.grad.isfinite().all()
    assert not logits.grad[:, :, 1].any()
    torch.testing.assert_close(logits.grad[0, :, 0], torch.tensor([1.0, 1.5]))


def test_constant_vectors_are_a_float32_copy_that_nothing_trains():
    given_ones = normal(NUM_ENTITIES, 5).double().requires_grad_()
    vectors = EntityVectors(NUM_ENTITIES, given_ones)
    before = given_ones.detach().float().clone()
    given_ones.data.zero_()
    assert list(vectors.parameters()) == []
    assert not vectors.weights()["vectors"].requires_grad
    assert vectors.weights()["vectors"].dtype == torch.float32
    assert torch.equal(vectors.weights()["vectors"][:-1], before)
    assert list(vectors.state_dict()) == ["vectors"]
    assert (vectors.dim, vectors.is_one_hot) == (5, False)


def test_one_hot_vectors_are_unwritten():
    one_hot = EntityVectors(NUM_ENTITIES)
    assert (one_hot.weights(), list(one_hot.parameters())) == ({}, [])
    assert (one_hot.dim, one_hot.is_one_hot) == (NUM_ENTITIES, True)


HIDDEN = 4


def policy_of(*, knows=False, **settings):
    config = PolicyConfig("pairs", pair_size=HIDDEN, mixing="residual", **settings)
    sources = make_sources(config.sources, SCORER) if knows else ()
    policy = PairPolicy(config, EntityVectors(SIZE, normal(SIZE, 3)), sources)
    for i, parameter in enumerate(policy.parameters()):
        parameter.data = normal(*parameter.shape, seed=i) / 2
    return policy.double()


def states_of_pairs(selection=None, attempts=None):
    """Return nine states, with no selection, or with the entity of a slot."""
    generator = torch.Generator().manual_seed(0)
    # Different entities, and an empty slot on most tables.
    rows = [torch.randperm(SIZE + 1, generator=generator)[:SLOTS] for _ in range(9)]
    table = torch.stack(rows)
    goal = torch.arange(9) % SIZE
    selected = torch.full_like(goal, NOTHING) if selection is None else table[:, selection]
    return States(goal, selected, table, attempts=attempts)


def numbers(policy, states_of_pairs):
    """Return the probability of each pair of slots, in both orders, from :meth:`choose`."""
    shares = torch.softmax(policy.choose(states_of_pairs, policy.weights(), None).logits, dim=1)
    return {
        (i, j): shares[:, number]
        for number, (i, j) in enumerate((i, j) for i in range(SLOTS) for j in range(i + 1))
    }


def test_a_pairs_logit_is_that_of_the_formula_written_out():
    policy, state = policy_of(knows=True), states_of_pairs()
    scores = policy.external_scores(state)
    output = policy.choose(state, policy.weights(), scores.double())
    units = torch.nn.functional.normalize(policy.vectors.vectors[:-1], dim=1)
    x = units * LENGTH
    of_words, of_itself = 30 * policy.words.step
    u, v = (source.scores.double() for source in policy.sources.values())
    lambda_u, lambda_v = (1 + 30 * policy.lambdas.step).tolist()
    for row, (goal, table) in enumerate(zip(state.goal, state.table, strict=True)):
        a, b = policy.goals(x[goal]).chunk(2)
        places = ((i, j) for i in range(SLOTS) for j in range(i + 1))
        for number, (i, j) in enumerate(places):
            one, other = table[i], table[j]
            if NOTHING in (one, other):
                assert output.logits[row, number] == -math.inf
                continue
            p, q, r = policy.items(x[one]).chunk(3)
            p2, q2, r2 = policy.items(x[other]).chunk(3)
            hidden = torch.relu(p + p2 + q * q2 + a + b * (r + r2))
            centred = hidden - hidden.mean()
            hidden = centred / (centred.square().mean() + 1e-5).sqrt()
            alpha = policy.score.weight[0] @ hidden
            alpha += of_words * units[goal] @ (units[one] + units[other]) + of_itself * (i == j)
            known = lambda_u * (u[one, other] + u[other, one]) / 2
            known += lambda_v * (v[goal, one] + v[goal, other]) / 2
            torch.testing.assert_close(output.logits[row, number], alpha + known)


def test_both_selections_together_choose_a_pair_with_its_probability():
    """The marginal times the conditional probability, in both orders, is that of the pair."""
    policy = policy_of()
    joint = numbers(policy, states_of_pairs())
    first = torch.softmax(policy(states_of_pairs()).logits, dim=1)
    for i, j in itertools.combinations_with_replacement(range(SLOTS), 2):
        orders = {(i, j), (j, i)}
        total = torch.zeros(9).double()
        for one, other in orders:
            second = torch.softmax(policy(states_of_pairs(selection=one)).logits, dim=1)
            is_there = states_of_pairs().table[:, one] != NOTHING
            total += torch.where(is_there, first[:, one] * second[:, other], 0)
        torch.testing.assert_close(total, joint[max(i, j), min(i, j)])


@pytest.mark.parametrize("selection", [None, 0])
def test_contributions_of_sources_add_up_to_the_logits(selection):
    policy = policy_of(knows=True)
    state = states_of_pairs(selection)
    output = policy(state, external_scores=policy.external_scores(state).double())
    total = torch.einsum("bs,bsa->ba", output.lambdas, output.sources)
    is_filled = state.table != NOTHING
    torch.testing.assert_close(total[is_filled], output.logits[is_filled])
    assert output.sources[:, 1:].any()


def test_a_greedy_player_takes_the_best_pair_and_not_the_most_probable_first_slot():
    policy = policy_of()
    # Nearly equal pairs: a slot in many good pairs is more probable than one in the best pair.
    policy.words.step.data = -policy.words.first / 30
    policy.score.weight.data /= 20
    joint = numbers(policy, states_of_pairs())
    best = [max(joint, key=lambda pair: joint[pair][row].item()) for row in range(9)]
    first = policy.best_slots(states_of_pairs())
    table = states_of_pairs().table
    second = policy.best_slots(
        states_of_pairs()._replace(selection=table.gather(1, first[:, None])[:, 0])
    )
    assert [{*pair} for pair in best] == [
        {*pair} for pair in zip(first.tolist(), second.tolist(), strict=True)
    ]
    assert not torch.equal(first, policy(states_of_pairs()).logits.argmax(1))


def test_a_selection_beside_the_table_has_the_scores_that_it_would_have_on_it():
    policy = policy_of(knows=True)
    goal, _, table = states_of_pairs()[:3]
    # An entity that is on no table.
    table = torch.where(table == 3, NOTHING, table)
    beside = States(goal, torch.full_like(goal, 3), table)
    wider = beside._replace(table=torch.cat([table, beside.selection[:, None]], dim=1))
    found, expected = policy.float()(beside), policy(wider)
    torch.testing.assert_close(found.logits, expected.logits[:, :SLOTS])
    torch.testing.assert_close(found.sources, expected.sources[:, :, :SLOTS])


def test_dropped_units_are_the_same_for_all_pairs_and_the_others_make_up_for_them():
    policy = policy_of(dropout=0.25)
    state, weights = states_of_pairs(), policy.weights()
    noise = torch.full((9, HIDDEN), 0.25)
    noise[:, 1] = 0.24
    expected = policy_of(dropout=0.25)
    expected.score.weight.data[0, 1] = 0
    expected.score.weight.data /= 0.75
    expected.words.step.data[:] = policy.words.step
    found = policy.choose(state, weights, None, noise).logits
    torch.testing.assert_close(found, expected.choose(state, expected.weights(), None).logits)


def test_noise_moves_the_vectors_that_the_maps_see_and_no_cosine():
    policy = policy_of(vector_noise=0.5)
    plain, again, other = (
        policy.weights(None if seed is None else torch.Generator().manual_seed(seed))
        for seed in (None, 1, 1)
    )
    assert torch.equal(again["items"], other["items"])
    assert not torch.allclose(plain["items"], again["items"])
    assert torch.equal(plain["units"], again["units"])
    # Of length .5 where vectors have length 1: a map's inputs differ by about LENGTH / 2.
    policy.items = torch.nn.Linear(3, 3, bias=False).double()
    policy.items.weight.data = torch.eye(3).double()
    moved = policy.weights(torch.Generator().manual_seed(1))["items"] - policy.weights()["items"]
    assert 0.3 * LENGTH < moved[:-1].norm(dim=1).square().mean().sqrt() < 0.8 * LENGTH
    silent = policy_of(vector_noise=0)
    assert torch.equal(silent.weights(torch.Generator())["goals"], silent.weights()["goals"])


def test_without_sources_a_policy_begins_near_a_player_of_nearest_words():
    config = PolicyConfig("pairs", pair_size=HIDDEN)
    policy = PairPolicy(config, EntityVectors(SIZE, normal(SIZE, 3)))
    assert policy.words().tolist() == [8, 0]
    knowing = PairPolicy(
        PolicyConfig("pairs", pair_size=HIDDEN, mixing="residual"),
        EntityVectors(SIZE, normal(SIZE, 3)),
        make_sources(["u", "v"], SCORER),
    )
    assert knowing.words().tolist() == [0, 0]


def test_the_attempts_left_have_their_own_terms_whatever_the_selection():
    policy = policy_of(sees_attempts=True)
    left = [Attempts(torch.full((9,), number)) for number in (1, 2)]
    one, two = (policy(states_of_pairs(attempts=each)).logits for each in left)
    assert not torch.allclose(one, two)
    # Both selections of an attempt are of the same pairs.
    state = states_of_pairs(selection=0, attempts=left[1])
    pairs = policy.choose(state, policy.weights(), None).logits
    unselected = policy.choose(states_of_pairs(attempts=left[1]), policy.weights(), None).logits
    assert torch.equal(pairs, unselected)
    with pytest.raises(ConfigError, match="needs the attempts left"):
        policy(states_of_pairs())


@pytest.mark.parametrize("settings", [{"kg_only": True}, {"mixing": "free"}])
def test_a_mixture_that_pairs_do_not_have_is_refused(settings):
    config = PolicyConfig(**{"policy": "pairs", "mixing": "residual", **settings})
    with pytest.raises(ConfigError, match="needs `policy` attention"):
        PairPolicy(config, EntityVectors(SIZE), make_sources(["u", "v"], SCORER))
