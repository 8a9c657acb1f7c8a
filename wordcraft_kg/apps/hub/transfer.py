"""Push a folder to a model hub as one commit, and pull a folder, checked, as a new folder."""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wordcraft_kg.apps.hub.folders import CARD, SHARED, SharedFolder, open_folder
from wordcraft_kg.base.artefacts import staged_folder
from wordcraft_kg.base.errors import ArtefactError, ConfigError, FetchError, WordCraftKGError
from wordcraft_kg.base.progress import stage


@stage("uploading")
def push(
    shared: SharedFolder,
    card: str,
    repository: str,
    *,
    private: bool,
    revision: str | None,
) -> str:
    """Commit the files of a folder to a repository, created if necessary.

    All files are one commit, so a reader never sees a part of them.

    Args:
        shared: the checked folder.
        card: README.md with a licence.
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
        files.append(CommitOperationAdd(CARD, card.encode()))
        commit = api.create_commit(
            **target, operations=files, revision=revision, commit_message="wordcraft-kg hub push"
        )
        return str(commit.commit_url)


@stage("downloading")
def pull(repository: str, out: Path, revision: str | None) -> str:
    """Write a pushed folder to ``out``, a new folder, and return the commit's hash.

    Only files that :func:`push` shares are downloaded. The folder is opened before it is written,
    which compares all files with the hashes in its record, or with its graph.

    Args:
        repository: OWNER/NAME on the hub.
        out: new folder.
        revision: branch, tag or commit; None for the main branch.

    Raises:
        ConfigError: if ``repository`` is not OWNER/NAME.
        FetchError: if the hub cannot be reached or refuses.
        ArtefactError: if the files are no whole folder of ours, or would not fit; ``out`` is then
            not written.
        OutputExistsError: if ``out`` exists.
    """
    with staged_folder(out) as folder:
        with _transfer(repository, "pulled"):
            from huggingface_hub import HfApi
            from huggingface_hub.errors import RepositoryNotFoundError

            api = HfApi(library_name="wordcraft-kg")
            source = {"repo_id": repository, "revision": revision, "files_metadata": True}
            # Models and datasets have names of their own on the hub; a name does not tell the kind.
            try:
                state = api.repo_info(**source, repo_type="model")
                repo_type = "model"
            except RepositoryNotFoundError:
                state = api.repo_info(**source, repo_type="dataset")
                repo_type = "dataset"
            files = [file for file in state.siblings or () if file.rfilename in SHARED]
            num_bytes = sum(file.size or 0 for file in files)
            # Before the first file: a download that cannot fit never begins.
            free_bytes = shutil.disk_usage(folder).free
            if num_bytes > free_bytes:
                raise ArtefactError(
                    f"'{repository}' has {num_bytes:,} bytes; at most {free_bytes:,} fit here, so "
                    "nothing was downloaded. Free some space, or pull from another repository."
                )
            for file in files:
                # The commit, not the branch: all files are of the same state.
                api.hf_hub_download(
                    repository,
                    file.rfilename,
                    repo_type=repo_type,
                    revision=state.sha,
                    local_dir=folder,
                )
        # The client keeps records of its downloads there, which belong to no folder of ours.
        shutil.rmtree(folder / ".cache", ignore_errors=True)
        try:
            shared = open_folder(folder)
        except WordCraftKGError as error:
            raise ArtefactError(str(error).replace(str(folder), repository)) from None
        # A file of the other kinds of folders would come along unread, such as a policy in a graph.
        unread = sorted({file.rfilename for file in files} - {CARD, *shared.files})
        if unread:
            raise ArtefactError(
                f"'{repository}' has the file '{unread[0]}', which does not belong to the folder. "
                "Pull from another repository, or ask its owner to push the folder again."
            )
    return str(state.sha)


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
