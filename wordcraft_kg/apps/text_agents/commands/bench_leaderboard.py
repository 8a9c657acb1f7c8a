"""``wordcraft-kg bench leaderboard``."""

from pathlib import Path

from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.cli.console import Flag, Output

GROUP = "Text agents"
EXAMPLES = (
    "wordcraft-kg bench leaderboard leaderboard/everyday-v3 --out docs/leaderboard.md",
    "wordcraft-kg bench leaderboard leaderboard/everyday-v3 --out docs/leaderboard.md --check",
)


def bench_leaderboard(
    folder: Path, *, out: Path, check: Flag = False, output: Output = Output()
) -> None:
    """Verify all submissions in a folder, and write a page with a table for each track.

    Args:
        folder: folder with folders of `bench run`, or ZIP archives of their files, at any depth.
        out: Markdown page to write.
        check: write nothing, and fail if the page would change.
    """
    from wordcraft_kg.apps.text_agents.leaderboard import leaderboard_page
    from wordcraft_kg.base.artefacts import output_target, write_atomically

    # The page depends on the submissions alone, so that --check can compare it in full.
    page = leaderboard_page(folder)
    if not check:
        write_atomically(output_target(out), page)
    elif not out.is_file() or out.read_text(encoding="utf-8") != page:
        raise ArtefactError(f"{out} is not up to date; omit --check.")
    output.result({"out": str(out)}, [f"{out} is up to date" if check else f"wrote {out}"])
