"""``wordcraft-kg hub pull``."""

from pathlib import Path

from wordcraft_kg.cli.console import Output

GROUP = "Sharing"
EXAMPLES = (
    "wordcraft-kg hub pull me/kitchen-recipes --out graphs/kitchen",
    "wordcraft-kg hub pull me/my-scorer --revision v1 --out models/mine",
)


def hub_pull(
    repository: str, *, out: Path, revision: str | None = None, output: Output = Output()
) -> None:
    """Pull a graph folder, model folder or agent from the hub into a new folder.

    The folder is checked before.

    Args:
        repository: OWNER/NAME on the hub, pushed by `hub push`.
        out: output folder; an existing folder is never replaced.
        revision: branch, tag or commit. Default: main.
    """
    from wordcraft_kg.apps.hub.transfer import pull
    from wordcraft_kg.base.extras import check_extra

    check_extra("hub")
    commit = pull(repository, out, revision)
    output.result(
        {"out": str(out), "repository": repository, "commit": commit},
        [f"wrote {out}/ of commit {commit}"],
    )
