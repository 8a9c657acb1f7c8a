"""Static sites, to publish or to open from a disk."""

import json
import os
import re
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages import HOME, PAGES
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.apps.explorer.server import PACKAGE, SCRIPTS
from wordcraft_kg.apps.web.files import static_texts, style_sheet
from wordcraft_kg.base.artefacts import dump_json, sha256_of, staged_folder, write_atomically
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.escaping import for_html
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import Count, Hash, Record, as_values
from wordcraft_kg.runs.record import RUN_FILE

SITE_FILE = "site.json"
LONGEST_NAME = 60


class ExportedSite(Record):
    """A static site (``site.json``), with hashes for weights and run records, and skipped pages."""

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
    """Write the pages that need no server into a folder, with ``index.html`` as the first."""
    files = _Files(explored)
    sizes, skipped = [], {}
    with staged_folder(out, force=force) as folder:
        texts = {
            "explorer.css": style_sheet(),
            "search.js": files.search(),
            **static_texts(PACKAGE, SCRIPTS),
        }
        for name, text in texts.items():
            write_atomically(folder / name, text)
        for (page, state), name in steps("writing pages", list(files.names.items())):
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
        exported = ExportedSite(
            graph=explored.opened.graph.name,
            graph_hash=explored.opened.graph.hash,
            split_hash=explored.opened.split.hash,
            pages=len(sizes),
            largest=max(sizes),
            bytes=sum(sizes),
            models={
                name: one.model.run.outputs["model.safetensors"]
                for name, one in explored.models.items()
            },
            runs={name: sha256_of(path / RUN_FILE) for name, path in explored.runs.items()},
            skipped=skipped,
        )
        write_atomically(folder / SITE_FILE, dump_json(as_values(exported)))
    return exported


class _Files:
    def __init__(self, explored: Explored):
        self.explored = explored
        self.names: dict[tuple[str, PageState], str] = {(HOME.name, HOME.state()): "index.html"}
        taken = {"index.html"}
        for page in PAGES.values():
            for state in page.states(explored):
                if (page.name, state) not in self.names:
                    stem = f"{page.name}/{_stem(page, state)}"
                    names = (
                        f"{stem}{'' if number == 1 else f'-{number}'}.html" for number in count(1)
                    )
                    self.names[page.name, state] = name = next(
                        name for name in names if name not in taken
                    )
                    taken.add(name)

    def address(self, page: Page[Any], state: PageState, *, seen_from: str) -> str:
        target = self.names.get((page.name, state))
        return "" if target is None else _relative(target, seen_from)

    def search(self) -> str:
        graph, entity = self.explored.opened.graph, PAGES["entity"]
        labels = graph.labels(sorted(range(graph.num_entities), key=lambda i: -graph.use_counts[i]))
        files = {
            label: self.names.get((entity.name, entity.state(entity=label))) for label in labels
        }
        return f"window.entities = {json.dumps([entry for entry in files.items() if entry[1]], ensure_ascii=True)};\n"


def _without_paths(text: str, explored: Explored) -> str:
    """Replace folders by names: paths on this machine are private."""
    folders = {name: one.folder for name, one in explored.models.items()} | explored.runs
    for name, folder in folders.items():
        if folder.is_absolute():
            text = text.replace(str(folder), name).replace(
                str(for_html(folder)), str(for_html(name))
            )
    return text


def _stem(page: Page[Any], state: PageState) -> str:
    plain = page.state()
    values = ((getattr(state, name), getattr(plain, name)) for name in state.__struct_fields__)
    chosen = "-".join(str(value) for value, usual in values if value != usual)
    return (
        re.sub(r"[^a-z0-9]+", "-", chosen.lower()).strip("-")[:LONGEST_NAME].strip("-") or page.name
    )


def _relative(file: str, to: str) -> str:
    return os.path.relpath(file, os.path.dirname(to) or ".")
