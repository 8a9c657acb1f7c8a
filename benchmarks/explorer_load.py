"""How fast pages come: after the start, and with many people looking at once; and how much memory that takes.

    python benchmarks/explorer_load.py graphs/la2 --model models/la2-recipes --run runs/w
    python benchmarks/explorer_load.py graphs/la2 --model models/la2-recipes --run runs/w --think 0   # without a pause

Starts `wordcraft-kg explore` in a process of its own on a free port of this machine. Each client opens one page after
another, of all kinds, each with random choices, so that hardly any page is asked for twice. Times are those that the
server says (Server-Timing, from the arrival of a request to the first byte of its answer), and those that clients see,
which share the machine with it. Let the machine do nothing else.
"""

import argparse
import http.client
import json
import os
import random
import re
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlencode

import numpy as np

from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.triples import RELATIONS

LEAST = 20
"""Pages of a kind that its 95th percentile is told of."""


def choices(opened: OpenedGraph, models: list[str], runs: list[str]) -> dict[str, Callable[[random.Random], str]]:
    """Return how to draw the address of a page of each kind."""
    graph = opened.graph
    labels, recipes, triples = graph.entities, graph.recipe_labels(), graph.triples.tolist()

    def address(name: str, **query: object) -> str:
        return f"/{name}?{urlencode({key: value for key, value in query.items() if value != ''})}"

    def link(draw: random.Random) -> str:
        head, relation, tail = draw.choice(triples)
        found = {"head": labels[head], "relation": RELATIONS[relation], "tail": labels[tail]}
        return address("link", model=draw.choice(models), **found)

    def predictions(draw: random.Random) -> str:
        relation, side = draw.choice(["", *RELATIONS]), draw.choice(["", "head", "tail"])
        sort = draw.choice(["best", "worst", "score"])
        return address(
            "predictions", model=draw.choice(models), relation=relation, side=side, sort=sort, page=draw.randint(1, 5)
        )

    def pair(draw: random.Random) -> str:
        one, other, _ = draw.choice(recipes)
        return address("pair", a=one, b=other, model=draw.choice(models))

    kinds: dict[str, Callable[[random.Random], str]] = {
        "home": lambda draw: "/home",
        "entities": lambda draw: address("entities", page=draw.randint(1, -(-len(labels) // 200))),
        "search": lambda draw: address("search", q=draw.choice(labels)[:3]),
        "entity": lambda draw: address(
            "entity", entity=draw.choice(labels), **({"model": draw.choice(models)} if models else {})
        ),
        "path": lambda draw: address("path", entity=draw.choice(labels)),
        "map": lambda draw: address("map", entity=draw.choice(labels)),
        "tasks": lambda draw: address("tasks", page=draw.randint(1, 5), run=draw.choice(["", *runs])),
    }
    if models:
        kinds |= {"predictions": predictions, "link": link, "pair": pair}
    if len(models) > 1:
        kinds["compare"] = lambda draw: address("compare", one=models[0], other=models[1], page=draw.randint(1, 20))
    if runs:
        kinds["episode"] = lambda draw: address(
            "episode", task=draw.randint(0, 500), draw=draw.randint(0, 4), run=draw.choice(runs)
        )
        kinds |= {"runs": lambda draw: "/runs", "run": lambda draw: address("run", run=draw.choice(runs))}
    return kinds


def memory_of(process: int) -> str:
    """Return the memory that a process takes, and the most that it has taken, in MB."""
    status = Path(f"/proc/{process}/status").read_text()
    now, most = (int(re.findall(rf"{name}:\s+(\d+) kB", status)[0]) / 1000 for name in ("VmRSS", "VmHWM"))
    return f"{now:.0f} MB, at most {most:.0f}"


class Clients:
    """People who open one page after another."""

    def __init__(self, place: tuple[str, int], kinds: dict[str, Callable[[random.Random], str]], think: float):
        self.place, self.kinds, self.think = place, kinds, think
        self.server: dict[str, list[float]] = defaultdict(list)
        self.seen: dict[str, list[float]] = defaultdict(list)
        self.sizes: dict[str, int] = defaultdict(int)
        self.failed: list[str] = []

    def look(self, number: int, until: float) -> None:
        draw = random.Random(number)
        connection = http.client.HTTPConnection(*self.place, timeout=60)
        time.sleep(draw.random() * self.think)
        while time.monotonic() < until:
            kind = draw.choice(list(self.kinds))
            address = self.kinds[kind](draw)
            begun = time.perf_counter()
            connection.request("GET", address)
            answer = connection.getresponse()
            body = answer.read()
            self.seen[kind].append(1000 * (time.perf_counter() - begun))
            self.server[kind].append(float(answer.headers["Server-Timing"].split("dur=")[1]))
            self.sizes[kind] = max(self.sizes[kind], len(body))
            if answer.status != 200:
                self.failed.append(f"{answer.status} {address}")
            time.sleep(draw.random() * 2 * self.think)

    def run(self, clients: int, seconds: float) -> None:
        until = time.monotonic() + seconds
        threads = [threading.Thread(target=self.look, args=(number, until)) for number in range(clients)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("graph")
    parser.add_argument("--model", action="append", default=[])
    parser.add_argument("--run", action="append", default=[])
    parser.add_argument("--clients", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--think", type=float, default=1.0, help="seconds between two pages of a client, on average")
    given = parser.parse_args()
    command = [sys.executable, "-m", "wordcraft_kg", "explore", given.graph, "--port", "0", "--no-browser", "--json"]
    for option in ("model", "run"):
        command += [word for path in getattr(given, option) for word in (f"--{option}", path)]
    begun = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = json.loads(server.stdout.readline())["address"]
            started = time.perf_counter()
            host, _, port = address.removeprefix("http://").rpartition(":")
            connection = http.client.HTTPConnection(host, int(port))
            connection.request("GET", "/home")
            connection.getresponse().read()
            first = time.perf_counter() - started
            print(f"start {started - begun:.2f} s; first page {first:.3f} s; memory {memory_of(server.pid)}")
            models, runs = ([Path(path).resolve().name for path in paths] for paths in (given.model, given.run))
            kinds = choices(open_graph(given.graph), models, runs)
            time.sleep(8)  # what is made in the background
            clients = Clients((host, int(port)), kinds, given.think)
            clients.run(given.clients, given.seconds)
            report(clients, given)
            print(f"memory {memory_of(server.pid)}; {os.cpu_count()} cores")
        finally:
            server.terminate()


def report(clients: Clients, given: argparse.Namespace) -> None:
    everything = [value for values in clients.server.values() for value in values]
    print(f"{len(everything):,} pages in {given.seconds:g} s, {given.clients} clients, {given.think:g} s between pages")
    print(f"{'':12}{'pages':>7}{'server p50':>12}{'p95':>8}{'p99':>8}{'client p95':>12}{'largest':>10}")
    rows = [(kind, clients.server[kind], clients.seen[kind], clients.sizes[kind]) for kind in clients.kinds]
    seen = [value for values in clients.seen.values() for value in values]
    for kind, server, client, size in [*rows, ("all", everything, seen, max(clients.sizes.values()))]:
        if len(server) >= LEAST:
            figures = "".join(f"{np.percentile(server, q):{width}.1f}" for q, width in ((50, 12), (95, 8), (99, 8)))
            print(f"{kind:12}{len(server):7,}{figures}{np.percentile(client, 95):12.1f}{size / 1000:7.0f} kB")
    for failure in clients.failed[:10]:
        print(f"FAILED {failure}")
    print(f"failed: {len(clients.failed)}")


if __name__ == "__main__":
    main()
