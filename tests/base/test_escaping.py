"""Texts from outside: no format reads them as anything but text."""

import json
import re
import sys
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from wordcraft_kg.base.wording import (
    for_file,
    for_html,
    for_json,
    for_terminal,
)

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from leaderboard_page import for_markdown, look_alike_key

pytest.importorskip("linkify_it")  # for MarkdownIt("gfm-like")
from markdown_it import MarkdownIt

MARKDOWN = MarkdownIt("gfm-like")  # also turns bare addresses into links
MARKUP = (
    "<a ",
    "<img",
    "<code",
    "<pre",
    "<h1",
    "<h2",
    "<li",
    "<strong",
    "<em",
    "<s>",
    "<hr",
    "<blo",
)
HOSTILE = [
    "[x](javascript:alert(1))",
    "![pixel](http://example.org/x.png)",
    "http://example.org www.example.org a@example.org <http://example.org> example.org/path",
    "HTTPS://example.org ftp://example.org mailto:a@example.org",
    "`code` | `more`",
    "a | b",
    "\\| a",
    "# heading",
    "1. item",
    "2) item",
    "- item",
    "+ item",
    "> quote",
    "---",
    "**bold** _emphasis_ ~~struck~~",
    "<img src=x onerror=alert(1)>",
    "[name]: http://example.org",
    "a\n\n## verified\n\n| b | c |",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_becomes_markup_in_markdown(text):
    table = MARKDOWN.render(f"| a | b |\n|---|---|\n| {for_markdown(text)} | last |\n")
    alone = MARKDOWN.render(for_markdown(text))
    assert not [mark for mark in MARKUP if mark in table + alone]
    assert table.count("<td>") == 2
    assert table.rstrip().endswith("<td>last</td>\n</tr>\n</tbody>\n</table>")


@given(st.text(max_size=60))
def test_every_text_stays_in_its_cell_and_is_shown_unchanged(text):
    table = MARKDOWN.render(f"| a | b |\n|---|---|\n| x{for_markdown(text)}x | last |\n")
    inside = table.split("<td>")[1].split("</td>")[0]
    expected = MARKDOWN.utils.escapeHtml(f"x{for_terminal(text)}x")
    assert table.count("<td>") == 2
    assert " ".join(inside.split()) == " ".join(expected.split())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b[31mred", "a<U+001B>[31mred"),
        ("one\nreplayed  craft-8", "one<U+000A>replayed  craft-8"),
        ("\u202eevil\u2066", "<U+202E>evil<U+2066>"),
        ("\x9b31m\x7f\r\t", "<U+009B>31m<U+007F><U+000D><U+0009>"),
        ("\udcff", "<U+DCFF>"),
        ("a\u2028b\U000e0041", "a<U+2028>b<U+E0041>"),
        ("soft\u00adhyphen \u3164", "soft<U+00AD>hyphen <U+3164>"),
        ("crème brûlée, 水, שלום, 👩\u200d🚀", "crème brûlée, 水, שלום, 👩\u200d🚀"),
    ],
)
def test_what_does_not_show_on_a_terminal_is_a_code(text, shown):
    assert for_terminal(text) == shown


def test_html_is_escaped_once_and_marks_of_direction_are_codes():
    once = for_html("<b>\u202ex & y")
    assert str(once) == "&lt;b&gt;&lt;U+202E&gt;x &amp; y"
    assert for_html(once) is once
    assert str(for_html(3)) == "3"


@given(st.text(st.characters(codec=None), max_size=20))
def test_a_text_for_a_file_is_unchanged_but_for_halves_of_characters(text):
    written = for_file(text)
    assert written.encode().decode() == written
    if not re.search("[\ud800-\udfff]", text):
        assert written == text


@given(st.text())
def test_json_for_a_terminal_has_the_same_value_and_no_control_character(text):
    dumped = for_json(json.dumps({text: [text]}, ensure_ascii=False))
    assert json.loads(dumped) == {text: [text]}
    assert not [char for char in dumped if "\x7f" <= char <= "\x9f" or char in "\u202e\u2028"]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("r\u0430ndom", "random"),  # a Cyrillic letter
        ("\uff32andom", "random"),  # a wide letter
        ("GPT\u20114", "gpt-4"),
        ("rándom", "random"),
        ("recipe  oracle ", "Recipe oracle"),
        ("0racle", "oracle"),
        ("p1anner", "pIanner"),
        ("modern", "modem"),
        ("\u0391gent", "agent"),  # a Greek capital
        ("\u0397UMA\u039d\u03a5", "humany"),  # Greek capitals with other small letters
        ("\ua4d6\ua4d1\ua4d4-4", "GPT-4"),  # Lisu
        ("\u13c0\u13e2\u13a2-4", "GPT-4"),  # Cherokee
        ("\uab90\uabb2\uab72-4", "GPT-4"),  # small Cherokee letters
        ("\u0262\u1d18\u1d1b-4", "GPT-4"),  # small capitals
        ("\u0280\u1d00\u0274\u1d05\u1d0f\u1d0d", "random"),
        ("\U0001f1f7andom", "random"),  # a letter of flags
        ("\u024dandom", "random"),  # with a stroke
    ],
)
def test_names_that_look_alike_share_a_key(one, other):
    assert look_alike_key(one) == look_alike_key(other)


def test_different_names_have_different_keys():
    names = ["random", "votes", "agent, u v", "agent, u v w", "agent, u v w p", "GPT-4", "GPT-5"]
    assert len({look_alike_key(name) for name in names}) == len(names)


def test_html_is_made_by_the_escaping_environment_alone():
    # Templates without autoescape, and text marked as safe, would show labels as markup.
    package = Path(str(files("wordcraft_kg")))
    python = {path: path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    made = [path.name for path, text in python.items() if "jinja2.Environment(" in text]
    assert made == ["pages.py"]
    assert not [path.name for path, text in python.items() if "from html import" in text]
    for path in package.rglob("*.j2"):
        text = path.read_text(encoding="utf-8")
        marked = [part for part in text.split("{{") if "|safe" in part.split("}}")[0]]
        assert all(part.lstrip().startswith('"') for part in marked), path  # constants only
