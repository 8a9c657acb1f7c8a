"""``wordcraft-kg explore``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.options import Book, Paths

if TYPE_CHECKING:
    from collections.abc import Callable

    from wordcraft_kg.apps.explorer.explored import Explored

GROUP = "In the browser"
EXAMPLES = (
    "wordcraft-kg explore graphs/everyday --model models/everyday --run runs/partial",
    "wordcraft-kg explore everyday --export site",
)


def explore(
    graph: Book,
    *,
    model: Paths = None,
    run: Paths = None,
    export: Path | None = None,
    force: Flag = False,
    host: str = "127.0.0.1",
    port: int = 8765,
    allow_host: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    no_browser: Flag = False,
    output: Output = Output(),
) -> None:
    """Look at a graph, at what models predict and at what agents think, in the browser; Ctrl-C ends it.

    Nothing is written into the folders. Only this machine can open the pages, unless --host opens them to others.

    Args:
        graph: graph folder, recipe book or known book's name.
        model: folder of a link predictor of this graph; several by several options.
        run: run folder of an agent on this graph, or a folder of seeds; several by several options. A run that is still
            training is shown as it goes.
        export: write the pages into this folder instead, to publish them.
        force: replace that folder if it exists.
        host: address of this machine to listen on; others than 127.0.0.1, such as 0.0.0.0, open the pages to others.
        port: port to listen on; 0 takes a free one.
        allow_host: a further name or address by which the pages may be asked for, as with --host 0.0.0.0 or behind a
            proxy; several by several options.
        no_browser: do not open the browser.
    """
    from wordcraft_kg.base.extras import check_extra

    if export is None and force:
        raise ConfigError("--force replaces what --export wrote; name a folder with --export.")
    check_extra("explore")
    from wordcraft_kg.apps.explorer.explored import Explored

    if export is not None:
        _export(lambda: Explored.open(graph, model or (), run or ()), export, force, output)
        return
    from wordcraft_kg.apps.explorer.server import make_app, warm
    from wordcraft_kg.apps.web.serving import Serving, listen, serve

    listening = listen(host, port)  # before the work
    try:
        explored = Explored.open(graph, model or (), run or ())
    except BaseException:
        listening.close()
        raise

    def started(address: str) -> None:
        output.result(Serving(address), [f"{address}   Ctrl-C ends it"])
        warm(explored)

    serve(make_app(explored, host, allow_host or ()), listening, started, in_browser=not no_browser)


def _export(opened: "Callable[[], Explored]", out: Path, force: bool, output: Output) -> None:
    from wordcraft_kg.apps.explorer.export import export_site
    from wordcraft_kg.base.artefacts import check_output

    check_output(out, force=force)
    site = export_site(opened(), out, force=force)
    size, largest = f"{site.bytes / 2**20:.1f} MiB", f"{site.largest / 2**10:.0f} KiB"
    lines = [f"wrote {out}: {site.pages:,} pages, {size}, the largest {largest}"]
    if site.skipped:
        lines.append(f"could not be made: {len(site.skipped):,}, such as {next(iter(site.skipped.items()))}")
    output.result(site, [*lines, f"open {out / 'index.html'}"])
