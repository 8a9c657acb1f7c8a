"""Push a folder to a model hub as one commit, and pull a folder, checked, as a new folder."""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wordcraft_kg.apps.hub.folders import CARD, SUMS, SharedFolder, open_folder, read_sums
from wordcraft_kg.base.artefacts import sha256_of, staged_folder
from wordcraft_kg.base.errors import ArtefactError, ConfigError, FetchError, WordCraftKGError
from wordcraft_kg.base.progress import stage

_LARGEST_TEXT = 2**20
"""Largest card and list of hashes in bytes; ours have a few thousand."""


@stage("uploading")
def push(
    shared: SharedFolder,
    texts: dict[str, str],
    repository: str,
    *,
    private: bool,
    revision: str | None,
) -> str:
    """Commit the files of a folder to a repository, created if necessary.

    All files are one commit, so a reader never sees a part of them.

    Args:
        shared: the checked folder.
        texts: further files by name: the card and the list of hashes.
        repository: OWNER/NAME on the hub.
        private: create a private repository; an existing one stays as it is.
        revision: branch, created if necessary; None for the main branch.

    Returns:
        The web address of the commit.

    Raises:
        ConfigError: if ``repository`` is not OWNER/NAME.
        FetchError: if the hub cannot be reached or refuses.
    """
    with _transfer(repository, "pushed"):
        from huggingface_hub import CommitOperationAdd, HfApi

        api = HfApi(library_name="wordcraft-kg")
        target = {"repo_id": repository, "repo_type": shared.repo_type}
        # None rather than False: an organisation may make all its repositories private.
        api.create_repo(**target, private=private or None, exist_ok=True)
        if revision is not None:
            api.create_branch(**target, branch=revision, exist_ok=True)
        files = [CommitOperationAdd(name, str(shared.path / name)) for name in shared.files]
        files += [CommitOperationAdd(name, text.encode()) for name, text in texts.items()]
        commit = api.create_commit(
            **target, operations=files, revision=revision, commit_message="wordcraft-kg hub push"
        )
        return str(commit.commit_url)


@stage("downloading")
def pull(repository: str, out: Path, revision: str | None) -> str:
    """Write a pushed folder to ``out``, a new folder, and return the commit's hash.

    Only files that :func:`push` shares are downloaded, and the folder is opened before it is
    written.

    Args:
        repository: OWNER/NAME on the hub.
        out: new folder.
        revision: branch, tag or commit; None for the main branch.

    Raises:
        ConfigError: if ``repository`` is not OWNER/NAME.
        FetchError: if the hub cannot be reached or refuses.
        ArtefactError: if a file differs from its recorded hash or from the other files, is not
            one of ours, or would not fit; ``out`` is then not written.
        OutputExistsError: if ``out`` exists.
    """
    with staged_folder(out) as folder:
        with _transfer(repository, "pulled"):
            from huggingface_hub import HfApi
            from huggingface_hub.errors import RepositoryNotFoundError

            api = HfApi(library_name="wordcraft-kg")
            # Models and datasets have names of their own on the hub; a name does not tell the kind.
            try:
                commit = api.model_info(repository, revision=revision).sha
                repo_type = "model"
            except RepositoryNotFoundError:
                commit = api.dataset_info(repository, revision=revision).sha
                repo_type = "dataset"
            # The commit, not the branch: all files are of the same state.
            source = {
                "repo_id": repository,
                "repo_type": repo_type,
                "revision": commit,
                "local_dir": folder,
            }

            def size_of(name: str) -> int:
                return int(api.hf_hub_download(filename=name, **source, dry_run=True).file_size)

            _check_size(size_of(SUMS), _LARGEST_TEXT, SUMS, repository)
            sums = read_sums(Path(api.hf_hub_download(filename=SUMS, **source)), repository)
            _check_size(size_of(CARD), _LARGEST_TEXT, CARD, repository)
            # All sizes before the first large file: a download that cannot fit never begins.
            free_bytes = shutil.disk_usage(folder).free
            _check_size(
                sum(map(size_of, sums)), free_bytes, f"the folder of {len(sums)} files", repository
            )
            # Not the whole repository: only names that read_sums has checked.
            for name in (*sums, CARD):
                api.hf_hub_download(filename=name, **source)
        # The client keeps records of its downloads there, which belong to no folder of ours.
        shutil.rmtree(folder / ".cache", ignore_errors=True)
        for name, expected in sums.items():
            if sha256_of(folder / name) != expected:
                raise ArtefactError(
                    f"{name} in '{repository}' differs from the hash in {SUMS}; nothing was "
                    "written."
                )
        try:
            shared = open_folder(folder)
        except WordCraftKGError as error:
            raise ArtefactError(str(error).replace(str(folder), repository)) from None
        # A file of the other kinds of folders would come along unread, such as a policy in a graph.
        unread = sorted(set(sums) - set(shared.files))
        if unread:
            raise ArtefactError(
                f"{SUMS} in '{repository}' lists '{unread[0]}', which does not belong to the "
                "folder. Pull from another repository, or ask its owner to push the folder again."
            )
    return str(commit)


def _check_size(size: int, most: int, what: str, repository: str) -> None:
    """Refuse a download of more bytes than are expected or free."""
    if size > most:
        raise ArtefactError(
            f"{what} in '{repository}' has {size:,} bytes; at most {most:,} fit here, so nothing "
            "was downloaded. Free some space, or pull from another repository."
        )


@contextmanager
def _transfer(repository: str, done: str) -> Iterator[None]:
    """Turn the client's errors into a FetchError.

    Their text is left out, since it may hold signed addresses, which let anyone in.
    """
    if not re.fullmatch(r"[\w.-]{1,96}/[\w.-]{1,96}", repository, re.ASCII):
        raise ConfigError(
            f"`repository` '{repository}': expected OWNER/NAME, such as me/kitchen-recipes."
        )
    from huggingface_hub.utils import disable_progress_bars

    disable_progress_bars()
    try:
        yield
    except WordCraftKGError:
        raise
    except Exception as error:  # HTTP errors are of another library in each version of the client
        status = getattr(getattr(error, "response", None), "status_code", None)
        kind = type(error).__name__ + (f", status {status}" if status else "")
        raise FetchError(
            f"'{repository}' could not be {done} ({kind}). Check the name, the revision and the "
            "network, and log in: hf auth login, or the variable HF_TOKEN."
        ) from None
