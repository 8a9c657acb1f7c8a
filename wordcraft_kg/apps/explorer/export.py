"""Static sites, to publish or to open from a disk."""

import json
import os
import re
from functools import partial
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages import HOME, PAGES
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.apps.explorer.server import PACKAGE, SCRIPTS
from wordcraft_kg.apps.web.guard import static_texts, style_sheet
from wordcraft_kg.base.artefacts import dump_json, sha256_of, staged_folder, write_atomically
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import Count, Hash, Record, as_values
from wordcraft_kg.base.wording import for_html
from wordcraft_kg.runs.record import RUN_FILE

SITE_FILE = "site.json"
LONGEST_NAME = 60
"""Letters of a file name that come from page settings: file systems allow 255 bytes."""


class ExportedSite(Record):
    """A static site (``site.json``).

    Attributes:
        graph: name of the graph.
        graph_hash: content hash of the graph.
        split_hash: hash of the split.
        pages: number of pages.
        largest: bytes of the largest page.
        bytes: bytes of all pages.
        models: SHA-256 of each model's weights, by name.
        runs: SHA-256 of each run's record, by name.
        skipped: messages of the errors that took the place of pages, by the page's address.
    """

    graph: str
    graph_hash: Hash
    split_hash: Hash
    pages: Count
    largest: Count
    bytes: Count
    models: dict[str, str]
    runs: dict[str, str]
    skipped: dict[str, str]


def export_site(explored: Explored, out: Path, *, force: bool = False) -> ExportedSite:
    """Write the pages that need no server into a folder, with ``index.html`` as the first.

    A page that cannot be computed becomes a page with the message, so that links to it work.

    Args:
        explored: content of the pages.
        out: folder to write; it appears when all pages are written.
        force: replace the folder if it exists.

    Returns:
        numbers of pages and bytes, hashes of the inputs, and skipped pages, as in ``site.json``.

    Raises:
        OutputExistsError: if the folder exists and ``force`` is False.
    """
    files = _Files(explored)
    sizes = []
    skipped = {}
    with staged_folder(out, force=force) as folder:
        texts = {
            "explorer.css": style_sheet(),
            "search.js": files.search(),
            **static_texts(PACKAGE, SCRIPTS),
        }
        for name, text in texts.items():
            write_atomically(folder / name, text)
        for (page, state), name in steps("writing pages", list(files.names.items())):
            # Links are relative to the file that they are in, so each file has a site of its own.
            site = Site(
                explored,
                partial(files.address, seen_from=name),
                partial(_relative, to=name),
                is_static=True,
            )
            try:
                text = site.page(PAGES[page], state)
            except WordCraftKGError as error:
                skipped[PAGES[page].address(state)] = _without_paths(str(error), explored)
                text = site.error(404, str(error))
            content = _without_paths(text, explored).encode()
            (folder / name).parent.mkdir(exist_ok=True)
            write_atomically(folder / name, content)
            sizes.append(len(content))
        weights = {
            name: predictor.model.run.outputs["model.safetensors"]
            for name, predictor in explored.models.items()
        }
        exported = ExportedSite(
            graph=explored.opened.graph.name,
            graph_hash=explored.opened.graph.hash,
            split_hash=explored.opened.split.hash,
            pages=len(sizes),
            largest=max(sizes),
            bytes=sum(sizes),
            models=weights,
            runs={name: sha256_of(path / RUN_FILE) for name, path in explored.runs.items()},
            skipped=skipped,
        )
        write_atomically(folder / SITE_FILE, dump_json(as_values(exported)))
    return exported


class _Files:
    """File names of a site: ``names`` has each page's file by page name and settings."""

    def __init__(self, explored: Explored):
        self.explored = explored
        # Servers and disks open index.html first, so the first page has no name of its own.
        self.names: dict[tuple[str, PageState], str] = {(HOME.name, HOME.state()): "index.html"}
        file_names = {"index.html"}
        for page in PAGES.values():
            for state in page.states(explored):
                if (page.name, state) not in self.names:
                    name = _unused(f"{page.name}/{_stem(page, state)}", file_names)
                    self.names[page.name, state] = name
                    file_names.add(name)

    def address(self, page: Page[Any], state: PageState, *, seen_from: str) -> str:
        target = self.names.get((page.name, state))
        return "" if target is None else _relative(target, seen_from)

    def search(self) -> str:
        """Return the script with the entities and their files, the most used entities first."""
        graph = self.explored.opened.graph
        entity = PAGES["entity"]
        by_use = sorted(range(graph.num_entities), key=lambda i: -graph.use_counts[i])
        files = {
            label: self.names.get((entity.name, entity.state(entity=label)))
            for label in graph.labels(by_use)
        }
        entries = [(label, file) for label, file in files.items() if file]
        # A script, not a JSON file: browsers refuse to fetch files for a page that was opened from
        # a disk. ASCII only, so that the file's encoding does not matter.
        return f"window.entities = {json.dumps(entries, ensure_ascii=True)};\n"


def _unused(stem: str, taken: set[str]) -> str:
    """Return a file name that no page has.

    Labels may differ only in characters that file names cannot have.
    """
    name = f"{stem}.html"
    number = 1
    while name in taken:
        number += 1
        name = f"{stem}-{number}.html"
    return name


def _without_paths(text: str, explored: Explored) -> str:
    """Replace folders by names: paths on this machine are private."""
    folders = {
        name: predictor.folder for name, predictor in explored.models.items()
    } | explored.runs
    for name, folder in folders.items():
        # A relative path such as `run` tells nothing, and may be a word of a page.
        if folder.is_absolute():
            text = text.replace(str(folder), name)
            # Pages hold the path as HTML.
            text = text.replace(str(for_html(folder)), str(for_html(name)))
    return text


def _stem(page: Page[Any], state: PageState) -> str:
    """Return a file name from the settings other than the defaults; others may have the same.

    Only lower-case letters and digits: some file systems ignore case, and labels may have any
    characters, such as those that lead to another folder.
    """
    usual = page.state()
    values = [
        str(getattr(state, field))
        for field in state.__struct_fields__
        if getattr(state, field) != getattr(usual, field)
    ]
    plain = re.sub(r"[^a-z0-9]+", "-", "-".join(values).lower()).strip("-")
    # The cut may end with a hyphen.
    return plain[:LONGEST_NAME].strip("-") or page.name


def _relative(file: str, to: str) -> str:
    return os.path.relpath(file, os.path.dirname(to) or ".")
