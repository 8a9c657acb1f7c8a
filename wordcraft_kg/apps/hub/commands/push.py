"""``wordcraft-kg hub push``."""

from pathlib import Path

from wordcraft_kg.cli.console import Flag, Output

GROUP = "Sharing"
SUBJECT = "Share graph folders, model folders and agents on the Hugging Face hub."
EXAMPLES = (
    "wordcraft-kg hub push graphs/kitchen me/kitchen-recipes --dry-run",
    "wordcraft-kg hub push models/mine me/my-scorer --licence cc-by-4.0 --private",
)


def hub_push(
    folder: Path,
    repository: str,
    *,
    licence: str | None = None,
    private: Flag = False,
    revision: str | None = None,
    dry_run: Flag = False,
    output: Output = Output(),
) -> None:
    """Check a graph folder, model folder or agent, and push it to the hub with a card.

    All files are one commit.

    The card (README.md) has the licence, metrics, command, versions and hashes of the inputs. A
    login is needed: hf auth login, or the variable HF_TOKEN.

    Args:
        folder: graph folder, model folder or run of train-agent.
        repository: OWNER/NAME on the hub; a dataset for a graph, otherwise a model. Created if
            necessary.
        licence: identifier of a licence on the hub. Default: cc0-1.0 for built-in books, an error
            for others.
        private: create a private repository.
        revision: branch, created if necessary. Default: main.
        dry_run: list the files and print the card, without a connection.
    """
    from wordcraft_kg.apps.hub.folders import CARD, open_folder
    from wordcraft_kg.apps.hub.transfer import push
    from wordcraft_kg.base.extras import check_extra

    check_extra("hub")
    shared = open_folder(folder)
    card = shared.with_licence(licence)
    files = [*shared.files, CARD]
    url = None if dry_run else push(shared, card, repository, private=private, revision=revision)
    view = {
        "repository": repository,
        "type": shared.repo_type,
        "files": files,
        "card": card,
        "url": url,
    }
    output.result(
        view,
        [*files, "", *card.splitlines()] if url is None else [f"pushed {len(files)} files: {url}"],
    )
