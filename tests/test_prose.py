"""The language check of ``docs/check_prose.py`` counts the right words in the right kinds of text."""

import ast
import importlib.util
from pathlib import Path

import pytest

PATH = Path(__file__).parents[1] / "docs" / "check_prose.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("check_prose", PATH)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_errors_are_the_messages_of_raised_errors_without_settings(script):
    tree = ast.parse(
        'raise ConfigError(f"`of` {x}: it is wrong")\nrefuse("name", 1, "less")\nprint("of it")'
    )
    assert " ".join(script.errors(tree)).split() == [":", "it", "is", "wrong", "name", "less"]


def test_docstrings_are_counted_without_code_and_strings_without_docstrings(script):
    tree = ast.parse('def f():\n    """Return ``of`` :class:`it` one."""\n    return "of all"')
    assert next(script.docstrings(tree)).split() == ["Return", "one."]
    assert list(script.strings(tree)) == ["of all"]


def test_comments_are_counted_and_directives_are_not(script):
    assert list(script.comments("x = 1  # of it\ny = 2  # noqa: E501\n")) == ["of it"]


def test_every_kind_of_text_is_found_and_every_exception_has_a_reason(script):
    kinds = {kind for kind, _, _ in script.texts()}
    assert kinds == {"docstrings", "errors", "comments", "prompts", "templates", "help", "guides"}
    assert all(
        kind in kinds and name in script.WORDS and reason
        for (kind, name), (_, reason) in script.EXCEPTIONS.items()
    )
