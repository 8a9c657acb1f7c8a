"""Chat templates: the text of transformers, within bounds of time and memory."""

import sys
import time
from copy import copy
from importlib import import_module
from pathlib import Path

import pytest

from wordcraft_kg.base.errors import ArtefactError

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
