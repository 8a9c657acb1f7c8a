"""Link reports from a scorer in one call, and HTML pages as tests read them."""

import re
from html.parser import HTMLParser

from wordcraft_kg.evaluation.links import view_links
from wordcraft_kg.evaluation.ranked_links import rank_links
from wordcraft_kg.models.scorers.score_limits import MAX_QUERIES
from wordcraft_kg.reports.link_report import make_link_report

VOID = {
    "area",
    "base",
    "br",
    "col",
    "embed",
    "hr",
    "img",
    "input",
    "link",
    "meta",
    "source",
    "track",
    "wbr",
}


class Page(HTMLParser):
    """Collects tags, attributes and text, and notices what is not balanced."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.text: list[str] = []
        self.faults: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"</{tag}> at {self.getpos()}")

    def handle_data(self, data):
        self.text.append(data)


def text_of(html):
    return re.sub(r"\s+", " ", " ".join(Page(html).text))


def link_report(scorer, opened, kg="partial", *, max_queries=MAX_QUERIES, **more):
    """Evaluate a scorer and return its report, as ``evaluate-links`` does."""
    links = rank_links(scorer, opened, kg, max_queries=max_queries)
    return make_link_report(view_links(links, **more), links.labelled_ranks)
