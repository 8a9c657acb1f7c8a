"""Time the map: its layout, its page, and the frames while it is dragged and zoomed in headless Chromium.

python benchmarks/explorer_map.py GRAPH [GRAPH ...]
"""

import argparse
import math
import shutil
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.map import Map, map_of
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.apps.explorer.server import make_app
from wordcraft_kg.apps.web.serving import address_of, listen

RECORD = """() => {
  window.frames = [];
  const next = (now) => { window.frames.push(now); window.recording = requestAnimationFrame(next); };
  window.recording = requestAnimationFrame(next);
}"""
STOP = "() => { cancelAnimationFrame(window.recording); return window.frames; }"


def time_views(explored: Explored) -> None:
    """Print seconds of the layout, and milliseconds and bytes of pages."""
    graph, page = explored.opened.graph, PAGES["map"]
    start = time.perf_counter()
    found = map_of(graph)
    seconds = time.perf_counter() - start
    placed, links = len(found.ids), len(found.view.combines) + len(found.view.components)
    print(f"  layout of {placed:,} entities with {links:,} links {seconds:10.2f} s")
    explored.once("map", lambda: found)
    site = Site(explored, lambda page, state: page.address(state), lambda name: f"/files/{name}")
    most, least = (graph.entities[int(choice)] for choice in (graph.use_counts.argmax(), graph.use_counts.argmin()))
    for name, state in (("nothing chosen", Map()), ("most used", Map(entity=most)), ("least used", Map(entity=least))):
        took = []
        for _ in range(7):
            start = time.perf_counter()
            size = len(site.page(page, state).encode())
            took.append(1_000 * (time.perf_counter() - start))
        print(f"  page, {name:14} {size / 1_000:8.0f} kB {np.median(took):8.1f} ms")


def time_frames(explored: Explored) -> None:
    """Print milliseconds between frames while the map is dragged, and while it is zoomed."""
    import uvicorn
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        sys.exit("there is no Chromium")
    listening = listen("127.0.0.1", 0)
    server = uvicorn.Server(uvicorn.Config(make_app(explored), log_config=None, lifespan="off", ws="none"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    graph = explored.opened.graph
    most = graph.entities[int(graph.use_counts.argmax())]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        for name, state in (("nothing chosen", Map()), (f"'{most}' chosen", Map(entity=most))):
            page.goto(address_of(listening) + PAGES["map"].address(state))
            page.locator("svg.world.moves").scroll_into_view_if_needed()
            page.wait_for_timeout(500)
            box = page.locator("svg.world").bounding_box()
            assert box is not None
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 3
            for kind in ("dragging", "zooming"):
                page.mouse.move(x, y)
                page.evaluate(RECORD)
                if kind == "dragging":
                    page.mouse.down()
                    for i in range(240):
                        page.mouse.move(x + 150 * math.sin(i / 12), y + 100 * math.cos(i / 12) - 100)
                    page.mouse.up()
                else:
                    for i in range(120):
                        page.mouse.wheel(0, -30 if i % 40 < 20 else 30)
                frames = page.evaluate(STOP)
                between = [after - before for before, after in pairwise(frames)]
                middle, slow = np.median(between), np.percentile(between, 95)
                print(
                    f"  {kind}, {name:20} {len(between):5} frames, median {middle:5.1f} ms, 95 % below {slow:5.1f} ms"
                )
        browser.close()
    server.should_exit = True
    thread.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("graph", nargs="+")
    parser.add_argument("--no-frames", action="store_true", help="leave out what needs a browser")
    arguments = parser.parse_args()
    for graph in arguments.graph:
        explored = Explored.open(graph)
        print(f"{Path(graph).name}: {explored.opened.graph.num_entities:,} entities")
        time_views(explored)
        if not arguments.no_frames:
            time_frames(explored)


if __name__ == "__main__":
    main()
