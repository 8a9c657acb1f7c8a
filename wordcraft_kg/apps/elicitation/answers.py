"""Stored language-model answers: a small file for each request, named by the request's SHA-256."""

import hashlib
import logging
from pathlib import Path
from typing import Literal

from wordcraft_kg.apps.elicitation.prompts import Request
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError, OutputExistsError
from wordcraft_kg.base.records import Hash, Record, as_values, read_record


class Answer(Record, frozen=True, kw_only=True):
    """A language model's answer to a request.

    Attributes:
        text: text of the answer.
        model: the answering model's name; empty if unknown.
        finish: reason for the end of the text, such as ``stop`` or ``length``; empty if unknown.
    """

    text: str
    model: str = ""
    finish: str = ""

    @property
    def hash(self) -> str:
        """SHA-256 of the text, in hexadecimal."""
        return hashlib.sha256(self.text.encode(errors="surrogatepass")).hexdigest()


class _KeptAnswer(Record, frozen=True, kw_only=True):
    format: Literal["wordcraft-kg answer 2"] = "wordcraft-kg answer 2"
    request: Request
    answer: Answer
    sha256: Hash

    @classmethod
    def of(cls, request: Request, answer: Answer) -> "_KeptAnswer":
        content = dump_json([request.hash, as_values(answer)])
        return cls(request=request, answer=answer, sha256=hashlib.sha256(content.encode()).hexdigest())


class Answers:
    """A folder with the stored answers of language models, one file per request; :meth:`open` creates the folder."""

    def __init__(self, folder: Path):
        self.folder = folder

    def open(self) -> None:
        """Create the folder of answers.

        Raises:
            OutputExistsError: if the path is a file.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            text = f"'{self.folder}' is a file, but `answers` need a folder. Choose another path."
            raise OutputExistsError(text) from None

    def find(self, request: Request) -> Answer | None:
        """Return the stored answer to a request; None if missing or, with a warning, if the file is damaged."""
        path = self._path(request)
        if not path.exists():
            return None
        try:
            kept = read_record(path, _KeptAnswer)
            if kept.request != request:
                raise ArtefactError(f"{path} answers another prompt.")
            if kept != _KeptAnswer.of(request, kept.answer):
                raise ArtefactError(f"{path} is damaged or was edited: the hash of the answer differs.")
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s It is ignored, and the prompt is sent again.", error)
            return None
        return kept.answer

    def keep(self, request: Request, answer: Answer) -> None:
        """Store the answer to a request in an atomically written file."""
        kept = as_values(_KeptAnswer.of(request, answer))
        write_atomically(self._path(request), dump_json(kept), durable=True)

    def _path(self, request: Request) -> Path:
        return self.folder / f"{request.hash}.json"
