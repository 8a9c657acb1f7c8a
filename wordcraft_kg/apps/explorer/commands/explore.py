"""``wordcraft-kg explore``."""

import os
import sys
import threading
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.base import check_output
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.options import Book, Force, Paths

GROUP = "In the browser"
EXAMPLES = (
    "wordcraft-kg explore graphs/everyday --model models/everyday --run runs/partial",
    "wordcraft-kg explore everyday --export site",
)


def explore(  # noqa: PLR0913 - parameters are the command's options
    graph: Book,
    *,
    model: Paths = None,
    run: Paths = None,
    export: Path | None = None,
    force: Force = False,
    host: str = "127.0.0.1",
    port: int = 8765,
    allow_host: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    no_browser: Flag = False,
    output: Output = Output(),
) -> None:
    """Explore a graph, model predictions and agent decisions in the browser.

    Ctrl-C stops the server.

    The folders stay unchanged. Only this machine can open the pages, unless --host opens them to
    other machines.

    Args:
        graph: graph folder, recipe book file, or built-in book name.
        model: folder of a link predictor for this graph. May be given several times.
        run: run folder of an agent on this graph, or a folder with several seeds; unfinished runs
            update live. May be given several times.
        export: write a static site to this folder instead.
        host: address to listen on; other addresses than 127.0.0.1, such as 0.0.0.0, open the pages
            to other machines.
        port: port to listen on; 0 selects a free port.
        allow_host: further permitted host name or address, as with --host 0.0.0.0 or behind a
            proxy. May be given several times.
        no_browser: do not open the browser.
    """
    from wordcraft_kg.base.extras import check_extra

    check_extra("explore")
    from wordcraft_kg.apps.explorer.explored import Explored

    if export is not None:
        from wordcraft_kg.apps.explorer.site import export_site

        # Before the work, which takes seconds.
        check_output(export, force=force)
        site = export_site(Explored.open(graph, model or (), run or ()), export, force=force)
        lines = [f"wrote {export}: {site.pages:,} pages   open {export / 'index.html'}"]
        if site.skipped:
            lines.append(f"skipped pages: {len(site.skipped):,}, named in site.json")
        output.result(site, lines)
        return
    from wordcraft_kg.apps.explorer.site import make_app
    from wordcraft_kg.apps.web.serving import listen, serve
    from wordcraft_kg.base.tensors import torch_threads

    # The port first: if it is taken, nobody waits for the work, which takes seconds.
    with listen(host, port) as listening:

        def started(address: str) -> None:
            output.result({"address": address}, [f"{address}   Ctrl-C stops the server"])

        app = make_app(Explored.open(graph, model or (), run or ()), host, allow_host or ())
        # More threads of torch would only compete: a table has ten rows.
        with torch_threads(1):
            serve(app, listening, started, in_browser=not no_browser)
    # A thread that computes a page cannot be interrupted, and Python would wait for it. Nothing is
    # lost: the server writes no files.
    if threading.active_count() > 1:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
