import io
import itertools
import json
import runpy
import sys
import time
from copy import copy
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch

from wordcraft_kg.base.errors import ArtefactError

ITEMS = ["flour", "hot water", "egg", "milk", "sugar"]


@cache
def player():
    """The names of the example; it imports transformers, so no sooner than a test needs them."""
    examples = Path(__file__).parents[3] / "examples"
    # As for a script, whose folder comes first.
    sys.path.append(str(examples))
    return runpy.run_path(str(examples / "transformers_player.py"))


@pytest.fixture(scope="module")
def reader(model_folder):
    made = reader_of(model_folder, eos_token="bread")
    made.end = made.tokens("bread")[0]
    return made


def reader_of(model_folder, **tokens):
    """A reader of a model whose tokenizer has a chat template and further special tokens."""
    from transformers import AutoTokenizer

    with pytest.MonkeyPatch.context() as patch:
        tokenizer = AutoTokenizer.from_pretrained(model_folder)
        tokenizer.chat_template = "{% for one in messages %}{{ one.content }}, {% endfor %}"
        for name, token in tokens.items():
            setattr(tokenizer, name, token)
        patch.setattr(AutoTokenizer, "from_pretrained", lambda *_, **__: tokenizer)
        return player()["Reader"](str(model_folder))


def log_prob(reader, prompt, answer):
    """Log-probability of an answer after a prompt, read as one text without a cache."""
    ids = [*prompt, *reader.tokens(answer), reader.end]
    rows = reader.model(torch.tensor([ids])).logits[0].log_softmax(-1)
    return sum(float(rows[place - 1, ids[place]]) for place in range(len(prompt), len(ids)))


@torch.inference_mode()
def test_the_answer_is_the_most_probable_untried_pair(
    reader,
):
    """The answer by probabilities is the most probable text of all pairs that were not tried."""
    prompt, tried = reader.tokens("flour is a part of"), set()
    expected = {
        f"{a} + {b}": log_prob(reader, prompt, f"{a} + {b}")
        for a, b in itertools.product(ITEMS, ITEMS)
    }
    for _ in range(15):
        answer = player()["by_probabilities"](reader, prompt, ITEMS, tried)
        assert expected[answer] == pytest.approx(max(expected.values()), abs=1e-4)
        for text in [
            text for text in expected if sorted(text.split(" + ")) == sorted(answer.split(" + "))
        ]:
            del expected[text]
    assert not expected


@torch.inference_mode()
def test_a_constrained_answer_goes_on_with_the_most_probable_allowed_token(reader):
    """Against a search that reads each beginning anew, without a cache, over all pairs."""

    def slow(prompt, texts):
        texts = [[*reader.tokens(text), reader.end] for text in texts]
        begun = []
        while len(texts) > 1:
            row = reader.model(torch.tensor([[*prompt, *begun]])).logits[0, -1]
            begun.append(max({text[len(begun)] for text in texts}, key=lambda one: float(row[one])))
            texts = [text for text in texts if text[: len(begun)] == begun]
        return texts[0][:-1]

    for text in ("flour is a part of", "sugar is hot", "egg"):
        prompt, tried, left = reader.tokens(text), set(), {*itertools.product(ITEMS, ITEMS)}
        while left:
            starts = {one: reader.tokens(f"{one} +") for one, _ in left}
            first = slow(prompt, [f"{one} +" for one in sorted(starts)])
            (one,) = (item for item, tokens in starts.items() if tokens == first)
            expected = slow(prompt, [f"{one} + {b}" for a, b in sorted(left) if a == one])
            answer = player()["by_constraint"](reader, prompt, ITEMS, tried)
            assert reader.tokens(answer) == expected
            pair = tuple(answer.split(" + "))
            left -= {pair, pair[::-1]}
    assert len(tried) == 15


@torch.inference_mode()
def test_the_answer_by_recipes_is_the_pair_of_the_most_probable_texts(reader, monkeypatch, capsys):
    """Against each text read anew; a pair has two texts, an item with itself one and comes last."""
    prompt = reader.tokens("Recipe: bread =")
    expected = {}
    for a, b in itertools.product(ITEMS, ITEMS):
        ids = [*prompt, *reader.tokens(f" {a} + {b}")]
        rows = reader.model(torch.tensor([ids])).logits[0].log_softmax(-1)
        places = range(len(prompt), len(ids))
        probability = np.exp(sum(float(rows[place - 1, ids[place]]) for place in places))
        pair = frozenset((a, b))
        expected[pair] = expected.get(pair, 0.0) + probability
    game = [
        {"goal": "bread", "table": ITEMS, "text": "", "new": number % 15 == 0}
        for number in range(30)
    ]
    lines = "".join(json.dumps(line) + "\n" for line in game)
    monkeypatch.setattr("sys.stdin", io.StringIO(lines))
    player()["play_by_recipes"](reader)
    answers = capsys.readouterr().out.splitlines()
    assert answers[:15] == answers[15:]
    for answer in answers[:15]:
        pair = frozenset(answer.split(" + "))
        left = [value for other, value in expected.items() if len(other) == 2]
        assert expected[pair] == pytest.approx(max(left or expected.values()), rel=1e-3)
        del expected[pair]
    assert not expected


sys.path.append(str(Path(__file__).parents[3] / "examples"))
module = import_module("chat_template")
ChatTemplate = module.ChatTemplate

LOOP = "{% for _ in range(99999) %}{% for _ in range(99999) %}{% endfor %}{% endfor %}"
TEMPLATE = (
    "{% for one in messages %}{{ '<' ~ one.role ~ '> ' ~ one.content | trim }}{{ pad_token }}\n"
    "{% if one.content == 'loop' %}" + LOOP + "{% endif %}"
    "{% if one.content == 'fail' %}{{ raise_exception('\x1b[2J no roles') }}{% endif %}"
    "{% endfor %}{% if add_generation_prompt %}<assistant>{% endif %}"
)


def said(*contents):
    return [{"role": "user", "content": content} for content in contents]


@pytest.fixture
def tokenizer_with(tokenizer):
    def make(template):
        made = copy(tokenizer)
        made.chat_template = template
        return made

    return make


def test_a_conversation_is_the_text_of_transformers_and_a_loop_is_ended(
    tokenizer_with, monkeypatch
):
    tokenizer = tokenizer_with(TEMPLATE)
    template = ChatTemplate(tokenizer)
    for messages, is_asked in ((said("flour", " é 🚀 "), True), (said("egg"), False)):
        expected = tokenizer.apply_chat_template(
            messages, add_generation_prompt=is_asked, tokenize=False
        )
        assert template.render(messages, is_asked=is_asked) == expected
    with pytest.raises(ArtefactError, match=r"template fails: TemplateError: <U\+001B>\[2J no ro"):
        template.render(said("fail"), is_asked=True)
    monkeypatch.setattr(module, "SECONDS", 0.3)
    for _ in range(2):
        began = time.monotonic()
        with pytest.raises(ArtefactError, match=r"took more than 0\.3 seconds"):
            template.render(said("loop"), is_asked=True)
        assert time.monotonic() - began < 5


@pytest.mark.slow
@pytest.mark.parametrize("hostile", ["9 ** (9 ** 9)", "'x' * 10 ** 10", "'x' * 10 ** 8"])
def test_a_template_takes_neither_all_memory_nor_writes_without_an_end(
    tokenizer_with, monkeypatch, hostile
):
    """The first two are computed when the template is read, and the third is shown."""
    monkeypatch.setattr(module, "SECONDS", 5.0)
    template = ChatTemplate(tokenizer_with("{{ (" + hostile + ") | string }}"))
    with pytest.raises(ArtefactError, match=r"took more than|MemoryError"):
        template.render(said("flour"), is_asked=True)


def test_a_tokenizer_without_a_usual_template_is_refused(tokenizer_with):
    for template in ("", {"tools": "x"}, 7, "x" * 10_000_001):
        with pytest.raises(ArtefactError, match="has no chat template"):
            ChatTemplate(tokenizer_with(template))
