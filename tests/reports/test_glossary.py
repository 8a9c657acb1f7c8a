"""The glossary: every word that a page explains is in it, and the page of concepts
is made from it."""

import importlib.util
import re
from importlib.resources import files
from pathlib import Path

from wordcraft_kg.models.policies.sources import ALPHA, BUILT_IN, with_letters
from wordcraft_kg.reports.pages import GLOSSARY

ROOT = Path(__file__).parents[2]


def test_every_word_that_a_template_explains_is_in_the_glossary():
    folders = [
        files(f"wordcraft_kg.{package}") / "templates"
        for package in ("reports", "studies", "apps.explorer")
    ]
    templates = [
        path.read_text(encoding="utf-8") for folder in folders for path in folder.iterdir()
    ]
    keys = {key for text in templates for key in re.findall(r'\bterm\("(\w+)"', text)}
    assert len(keys) > 20
    assert keys <= GLOSSARY.keys()


def test_every_source_of_knowledge_is_explained_under_its_symbol():
    for label in (ALPHA, *BUILT_IN.values()):
        term = GLOSSARY[label.name]
        assert term.symbol == label.symbol
        assert term.meaning.startswith(label.meaning)
        assert label is ALPHA or f"settings: {with_letters([label.name])}." in term.meaning


def test_no_two_terms_share_a_name_or_symbol():
    """No two terms have the same name or symbol and each meaning is a sentence."""
    names = [term.name for term in GLOSSARY.values()]
    symbols = [term.symbol for term in GLOSSARY.values() if term.symbol]
    assert len(set(names)) == len(names)
    assert len(set(symbols)) == len(symbols)
    assert all(
        term.meaning.endswith(".") and term.meaning[0].isupper() for term in GLOSSARY.values()
    )


def test_the_page_of_concepts_is_up_to_date():
    found = importlib.util.spec_from_file_location("make_terms", ROOT / "docs" / "make_terms.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    written = (ROOT / "docs" / "terms.md").read_text(encoding="utf-8")
    assert written == module.page(), "docs/terms.md is not up to date; run `make docs`"
