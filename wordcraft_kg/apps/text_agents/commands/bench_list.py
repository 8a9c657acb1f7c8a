"""``wordcraft-kg bench list``."""

from collections.abc import Iterator

from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned

GROUP = "Text agents"
SUBJECT = "Play a benchmark's frozen tasks, and verify results by playing all games again."
EXAMPLES = ("wordcraft-kg bench list", "wordcraft-kg bench list --json")


def bench_list(*, output: Output = Output()) -> None:
    """List the benchmark's tracks, and the kinds of players for `bench run`."""
    from wordcraft_kg.apps.text_agents.benchmark import read_manifest
    from wordcraft_kg.apps.text_agents.benchmark_players import KINDS

    manifest, manifest_hash = read_manifest()
    tracks = {
        name: {"about": track.about, "games": counted(len(track.tasks or track.orders), "game")}
        for name, track in manifest.tracks.items()
    }
    kinds = {kind.usage(name): kind.about for name, kind in KINDS.items()}

    def text() -> Iterator[str]:
        yield f"{manifest.name} of {manifest.date}, {manifest.licence}, {manifest_hash[:12]}"
        yield from aligned(
            [(f"  {name}", track["games"], track["about"]) for name, track in tracks.items()]
        )
        yield "add -lite for 100 tasks, or 100 attempts, and -made-up for made-up words"
        yield "players"
        yield from aligned([(f"  {name}", about) for name, about in kinds.items()])

    # Text names the endings once; programs get each full name.
    view = {
        "benchmark": manifest.name,
        "hash": manifest_hash,
        "date": manifest.date,
        "tracks": tracks,
    }
    output.result({**view, "names": manifest.names, "players": kinds}, text())
