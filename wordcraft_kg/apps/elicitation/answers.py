"""The answers of an endpoint on disk: a small file each, named by the SHA-256 of what was asked."""

import hashlib
import logging
from pathlib import Path
from typing import Literal

from wordcraft_kg.apps.elicitation.prompts import Request
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError, OutputExistsError
from wordcraft_kg.base.records import Count, Hash, Record, as_values, read_record


class Answer(Record, frozen=True, kw_only=True):
    """What an endpoint said.

    Attributes:
        text: its words.
        model: the model that it says has answered; empty if it does not say.
        finish: why it ended, such as ``stop`` or ``length``; empty if it does not say.
        tokens_in: tokens that it has counted, None if it does not say.
        tokens_out: those of the answer.
    """

    text: str
    model: str = ""
    finish: str = ""
    tokens_in: Count | None = None
    tokens_out: Count | None = None

    @property
    def hash(self) -> str:
        """SHA-256 of the words, in hexadecimal."""
        return hashlib.sha256(self.text.encode(errors="surrogatepass")).hexdigest()


class KeptAnswer(Record, frozen=True, kw_only=True):
    """A file of an answer: with what was asked, so that it cannot pass for the answer to something else."""

    format: Literal["wordcraft-kg answer 1"] = "wordcraft-kg answer 1"
    request: Request
    answer: Answer
    sha256: Hash


class Answers:
    """A folder of answers.

    A file that is damaged, or that is the answer to something else, is not used: a warning says so, and the prompt
    counts as not answered.
    """

    def __init__(self, folder: Path):
        """Take a folder, which :meth:`open` makes."""
        self.folder = folder

    def open(self) -> None:
        """Make the folder, if there is none, before anything is asked that could not be kept.

        Raises:
            OutputExistsError: if something else is there.
        """
        if self.folder.exists() and not self.folder.is_dir():
            raise OutputExistsError(
                f"'{self.folder}' is a file, but `answers` are kept in a folder. Choose another one."
            )
        self.folder.mkdir(parents=True, exist_ok=True)

    def path_of(self, request: Request) -> Path:
        """Return where the answer to a request is, or would be."""
        return self.folder / f"{request.hash}.json"

    def find(self, request: Request) -> Answer | None:
        """Return the answer to a request; None if it is not there, or not sound."""
        path = self.path_of(request)
        if not path.exists():
            return None
        try:
            kept = read_record(path, KeptAnswer)
            if kept.request != request:
                raise ArtefactError(f"{path} is the answer to another prompt.")
            if kept.sha256 != kept.answer.hash:
                raise ArtefactError(f"{path} is damaged or was edited: the answer does not match its hash.")
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s It is not used, and the prompt is asked again.", error)
            return None
        return kept.answer

    def keep(self, request: Request, answer: Answer) -> None:
        """Write an answer; it is there as a whole, or not at all."""
        kept = KeptAnswer(request=request, answer=answer, sha256=answer.hash)
        write_atomically(self.path_of(request), dump_json(as_values(kept)), durable=True)
