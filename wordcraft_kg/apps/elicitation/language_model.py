"""Tables from a causal language model: how probable is a label after a text about another label?

For each entity and prompt the model reads one text, in one forward pass without generation. A cell
is a pointwise mutual information: the label's log-probability after the text, minus its
log-probability after neutral texts.
"""

import hashlib
import json
import math
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np
import safetensors.torch
import torch
from torch import Tensor

from wordcraft_kg.apps.elicitation.foreign_code import (
    check_counts,
    check_size,
    loading,
    working,
)
from wordcraft_kg.base import (
    TEMPORARY,
    ArtefactError,
    ConfigError,
    Record,
    as_values,
    check_output,
    dump_json,
    parse_record,
    read_json,
    read_large_file,
    read_small_file,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.base.tensors import read_tensors
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.knowledge.knowledge_folder import (
    PLACES,
    KnowledgeRecord,
    KnowledgeTables,
    Role,
    TableInfo,
    write_knowledge,
)
from wordcraft_kg.runs.record import front_matter
from wordcraft_kg.runs.run_folder import Progress, locked_folder


class Prompt(Record, frozen=True, kw_only=True):
    """A text about an entity; the probabilities of the next words make a table.

    Attributes:
        name: name of the table.
        role: role of the table: ``part``, ingredient and result, or ``pair``, two ingredients.
        about: role of the entity in the text, ingredient or result; the next words have the other
            role.
        template: text with ``{e}``, a label, or ``{E}``, a label with a capital letter.
        neutral: texts with a general word, such as "something", in place of the label.
        phrase: evidence in explanations, with ``{ingredient}`` and ``{result}``, or ``{a}`` and
            ``{b}``.
    """

    name: str
    role: Role
    about: Literal["ingredient", "result"] = "ingredient"
    template: str
    neutral: tuple[str, ...]
    phrase: str

    def __post_init__(self) -> None:
        texts = (self.template, *self.neutral)
        if "{e}" not in self.template.lower():
            raise ValueError(
                f"template '{self.template}' has no {{e}}; expected a place for the label"
            )
        if not self.neutral or any(not text or text != text.strip() for text in texts):
            raise ValueError(
                f"prompt '{self.name}' needs neutral texts; texts neither start nor end with a "
                "blank"
            )
        if any(place not in self.phrase for place in PLACES[self.role]):
            raise ValueError(f"phrase '{self.phrase}' lacks {' or '.join(PLACES[self.role])}")

    def text(self, label: str) -> str:
        """Return the text about a label."""
        return self.template.replace("{e}", label).replace("{E}", label[:1].upper() + label[1:])


class _Prompts(Record, frozen=True):
    prompts: tuple[Prompt, ...]

    def __post_init__(self) -> None:
        names = {prompt.name for prompt in self.prompts}
        if not names or len(names) < len(self.prompts):
            raise ValueError("expected prompts with different names")


DEFAULT = Path(__file__).with_name("prompts.json")
"""Default prompts, a table each, chosen on validation recipes of Little Alchemy 2.

The splits have the seeds 10 and 11, so the results of other seeds are not tuned.
"""


def read_prompts(path: Path) -> tuple[Prompt, ...]:
    """Read prompts from a JSON file, ``{"prompts": [...]}``.

    Raises:
        ArtefactError: if the file is missing, not JSON, or a prompt is invalid.
    """
    return parse_record(read_small_file(path), _Prompts, path).prompts


def prompts_text(prompts: tuple[Prompt, ...]) -> str:
    """Return prompts as JSON text for :func:`read_prompts`."""
    return dump_json(as_values(_Prompts(prompts)))


_BATCH = 32
"""Texts in a forward pass; part of the result's last bits, so also of the key of saved rows."""
_LARGEST = 2**31
"""Bytes of all tables: 9,088 entities with the 13 default prompts."""


@dataclass(frozen=True, eq=False)
class LanguageModel:
    """An opened causal language model.

    Attributes:
        model: model of transformers, in float32 and ready for inference.
        tokenizer: its tokenizer.
        hashes: SHA-256 of the weights by file name.
        random_seed: seed of random weights; None if the model has its own weights.
    """

    model: Any
    tokenizer: Any
    hashes: dict[str, str]
    random_seed: int | None = None


def open_language_model(path: Path, random_seed: int | None = None) -> LanguageModel:
    """Load a language model: a model folder or a ``.gguf`` file.

    No code of the model is run, and no question about it is asked.

    Args:
        path: model folder with weights in safetensors, or a ``.gguf`` file.
        random_seed: seed for random weights in the same architecture, as a control; None for the
            model's weights.

    Returns:
        The model in float32, its tokenizer, and hashes.

    Raises:
        MissingExtraError: if a package is missing.
        ArtefactError: if the model is damaged, incomplete, not causal, needs code, or is far larger
            than its weights.
    """
    with loading(path, "a causal language model") as hashes:
        from transformers import AutoConfig, AutoModelForCausalLM, AutoTokenizer

        options: dict[str, Any] = {"trust_remote_code": False, "local_files_only": True}
        folder = path
        if path.is_file():
            options["gguf_file"] = path.name
            folder = path.parent
        else:
            check_counts(path, read_json(path / "config.json"))
        # A .gguf file has its settings inside, and transformers adds defaults: check these, too.
        config = AutoConfig.from_pretrained(str(folder), **options)
        check_counts(path, config.to_dict())
        build = partial(
            AutoModelForCausalLM.from_config, config, dtype=torch.float32, trust_remote_code=False
        )
        check_size(path, build)
        tokenizer = AutoTokenizer.from_pretrained(str(folder), **options)
        if random_seed is None:
            model, info = AutoModelForCausalLM.from_pretrained(
                str(folder),
                dtype=torch.float32,
                output_loading_info=True,
                use_safetensors=path.is_dir(),
                **options,
            )
            # Missing weights are drawn at random by transformers, which only warns.
            if info["missing_keys"]:
                raise ValueError(f"the weights lack {min(info['missing_keys'])}")
        else:
            with torch.random.fork_rng(devices=[]):  # transformers draws from the global generator
                torch.manual_seed(random_seed)
                model = build()
        model.eval()
        # A causal model predicts the same after token 0, whatever token follows.
        with torch.inference_mode():
            logits = model(input_ids=torch.tensor([[0, 1]])).logits[:, 0]
            other_logits = model(input_ids=torch.tensor([[0, 2]])).logits[:, 0]
        if not torch.allclose(logits, other_logits, rtol=1e-3, atol=1e-3):
            raise ValueError("a prediction depends on later tokens")
    return LanguageModel(model, tokenizer, hashes, random_seed)


def label_tokens(tokenizer: Any, label: str) -> list[int]:
    """Return the tokens that stand for a label: the first token of each word after a blank.

    The mean of their log-probabilities is the label's log-probability. A mean, because the words of
    a label would otherwise make long labels improbable; only first tokens, because one forward pass
    predicts one token.

    Raises:
        ConfigError: if a word has no token, or only the token for unknown words.
    """
    before = len(tokenizer("a", add_special_tokens=False).input_ids)
    tokens = []
    for word in label.split():
        # Behind another word: tokenizers write the blank into the token.
        token = tokenizer(f"a {word}", add_special_tokens=False).input_ids[before : before + 1]
        if not token or token[0] == tokenizer.unk_token_id:
            raise ConfigError(
                f"the label '{label}' has no tokens in this language model's vocabulary. Use a "
                "`model` for the labels' language, or rename the entity."
            )
        tokens += token
    return tokens


class _LabelProbabilities:
    """Log-probabilities of all labels after texts."""

    def __init__(self, language_model: LanguageModel, labels: Sequence[str]):
        self.model = language_model.model
        self.tokenizer = language_model.tokenizer
        self.size = len(labels)
        with working(self.tokenizer.name_or_path):
            label_ids = [label_tokens(self.tokenizer, label) for label in labels]
        counts = torch.tensor(list(map(len, label_ids)))
        # The tokens of all labels in one list, with the label and the number of tokens for each.
        self.tokens = torch.tensor(list(chain.from_iterable(label_ids)))
        self.owners = torch.arange(self.size).repeat_interleave(counts)
        self.counts = counts.repeat_interleave(counts)

    def read(self, texts: Iterable[str]) -> list[list[int]]:
        """Return the tokens of texts."""
        with working(self.tokenizer.name_or_path):
            return [self.tokenizer(text).input_ids for text in texts]

    @torch.inference_mode()
    def after(self, texts: Sequence[Sequence[int]]) -> Tensor:
        """Return log-probabilities after B texts with equal numbers of tokens.

        Returns:
            shape (B, E), in nats: the mean over the tokens of each label.
        """
        # Only the logits of the last position are computed: the others are (B, T, vocabulary).
        with working(self.tokenizer.name_or_path):  # such as tokens beyond the rows of the weights
            output = self.model(input_ids=torch.tensor(texts), logits_to_keep=1)
        logits = output.logits[:, -1].float()
        # Each token's share of its label's mean; index_add_ sums the shares of a label.
        parts = logits.log_softmax(-1)[:, self.tokens] / self.counts
        return torch.zeros(len(texts), self.size).index_add_(1, self.owners, parts)


def _batches(texts: Sequence[list[int]]) -> Iterator[tuple[list[int], list[list[int]]]]:
    """Divide texts into batches that need no padding; the batches depend on the texts only.

    Yields:
        Places of at most ``_BATCH`` texts with equal numbers of tokens, and these texts.
    """
    # Padding would change the last bits of a row with the other texts of its batch.
    order = sorted(range(len(texts)), key=lambda row: len(texts[row]))
    for _, same_length in groupby(order, key=lambda row: len(texts[row])):
        rows = list(same_length)
        for start in range(0, len(rows), _BATCH):
            batch = rows[start : start + _BATCH]
            yield batch, [texts[row] for row in batch]


def elicit_knowledge(
    out: Path,
    graph: RecipeGraph,
    language_model: LanguageModel,
    prompts: tuple[Prompt, ...],
    *,
    report: Progress | None = None,
    force: bool = False,
) -> KnowledgeTables:
    """Write a knowledge folder with a table for each prompt, and return the tables.

    Rows are saved in a hidden folder beside ``out``: a call after an interruption computes only the
    remaining rows.

    Args:
        out: folder to write.
        graph: graph with E entities; recipes are not used.
        language_model: see :func:`open_language_model`.
        prompts: prompts, a table each.
        report: called with the numbers of finished and of all texts, and no metrics; None for no
            progress.
        force: replace an existing output.

    Returns:
        The tables, each of shape (E, E), float16, in nats.

    Raises:
        ConfigError: if the tables are too large, or a label has no tokens.
        ArtefactError: if a probability is not finite.
        OutputExistsError: if ``out`` exists and ``force`` is False.
        KeyboardInterrupt: after Ctrl-C, with the number of saved texts.
    """
    out = with_a_name(out)
    check_output(out, force=force)
    size = graph.num_entities
    num_bytes = 2 * len(prompts) * size**2  # float16 has two bytes
    if num_bytes > _LARGEST:
        raise ConfigError(
            f"{len(prompts)} tables of {size:,} x {size:,} entities need {num_bytes:,} bytes; "
            f"expected at most {_LARGEST:,}. Use a smaller graph, or fewer `prompts`."
        )
    text = prompts_text(prompts)
    inputs = {
        "graph": graph.hash,
        "prompts": hashlib.sha256(text.encode()).hexdigest(),
        **language_model.hashes,
    }
    source = "language model"
    if language_model.random_seed is not None:
        inputs["random weights, seed"] = str(language_model.random_seed)
        source = "language model with random weights"
    probabilities = _LabelProbabilities(language_model, graph.entities)
    texts = [probabilities.read(map(prompt.text, graph.entities)) for prompt in prompts]
    # Everything that decides about the rows is in the name of their folder: another model, prompt
    # or graph has another one, and so never takes these rows. A tokenizer's files have no hash.
    key = json.dumps([inputs, _BATCH, probabilities.tokens.tolist(), texts])
    digest = hashlib.sha256(key.encode()).hexdigest()[:16]
    folder = out.parent / f".{out.name}.{digest}{TEMPORARY}"
    infos = tuple(
        TableInfo(name=prompt.name, role=prompt.role, phrase=prompt.phrase) for prompt in prompts
    )
    record = KnowledgeRecord(source=source, entities=graph.entities, tables=infos)
    with locked_folder(folder, "written"):
        knowledge = KnowledgeTables(record, _tables(probabilities, texts, prompts, folder, report))
        files = {"prompts.json": text, "README.md": _card(graph, knowledge, inputs, prompts)}
        write_knowledge(out, "elicit", knowledge, inputs=inputs, files=files, force=force)
        # Only after the knowledge folder is complete.
        shutil.rmtree(folder)
    return knowledge


def _tables(
    probabilities: _LabelProbabilities,
    texts: Sequence[list[list[int]]],
    prompts: tuple[Prompt, ...],
    folder: Path,
    report: Progress | None,
) -> tuple[Tensor, ...]:
    """Return a table for each prompt, from rows saved in ``folder`` or computed and saved there.

    Args:
        probabilities: the language model, for E labels.
        texts: for each of P prompts the tokens of E texts.
        prompts: P prompts.
        folder: folder of saved rows, a file for each batch.
        report: called with the numbers of finished and of all texts; None for no report.

    Returns:
        P tables of shape (E, E), float16, in nats.

    Raises:
        ArtefactError: if a probability is not finite.
        KeyboardInterrupt: after Ctrl-C, with the number of saved texts.
    """
    size = probabilities.size
    tables = torch.zeros(len(prompts), size, size, dtype=torch.half)
    num_done = 0
    try:
        for table, prompt, prompt_texts in zip(tables, prompts, texts, strict=True):
            neutral = _neutral(probabilities, prompt.neutral)
            for rows, batch in _batches(prompt_texts):
                table[rows] = _rows(probabilities, batch, neutral, folder / str(num_done))
                num_done += len(rows)
                if report:
                    report(num_done, len(prompts) * size, {})
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; {num_done:,} of {len(prompts) * size:,} texts are saved. Repeat the "
            "command to continue."
        ) from None
    return tuple(map(_oriented, tables, prompts))


def _rows(
    probabilities: _LabelProbabilities, texts: list[list[int]], neutral: Tensor, file: Path
) -> Tensor:
    """Return the rows of texts, shape (B, E), from a file, or computed and saved there."""
    # A file may be missing, or cut short by a power failure.
    with suppress(ArtefactError):
        return read_tensors(file, read_large_file(file))["rows"]
    rows = (probabilities.after(texts) - neutral).half()
    if not rows.isfinite().all():
        raise ArtefactError(
            "the language model gives probabilities that are not finite. Use another."
        )
    # Atomic: a batch is either saved or not, even after a kill.
    write_atomically(file, safetensors.torch.save({"rows": rows}))
    return rows


def _neutral(probabilities: _LabelProbabilities, texts: Sequence[str]) -> Tensor:
    """Return the log of each label's mean probability after neutral texts, shape (E,)."""
    rows = torch.cat(
        [probabilities.after(batch) for _, batch in _batches(probabilities.read(texts))]
    )
    # A mean of probabilities, in log space: exp of a small log-probability would be 0.
    return rows.logsumexp(0) - math.log(len(texts))


def _oriented(table: Tensor, prompt: Prompt) -> Tensor:
    """Return a table with a row per text in the direction of its role, with a diagonal of 0.

    Tables of parts have ingredients as rows and results as columns. Tables of pairs are symmetric,
    the mean of both directions: a recipe has no order. A label after a text about itself is
    repetition, not knowledge, so the diagonal says nothing.
    """
    if prompt.role == "pair":
        table = ((table.float() + table.float().T) / 2).half()
    elif prompt.about == "result":
        table = table.T
    return table.clone().fill_diagonal_(0)


def strongest(knowledge: KnowledgeTables, most: int = 3) -> dict[str, list[str]]:
    """Return each table's largest cells as phrases, such as "bread needs flour (+3.1)".

    Args:
        knowledge: tables over E entities.
        most: maximum number of cells per table.

    Returns:
        phrases by table name, the largest cell first.
    """
    labels = knowledge.record.entities
    shown: dict[str, list[str]] = {}
    for info, table in zip(knowledge.record.tables, knowledge.tables, strict=True):
        if info.role == "pair":  # symmetric: each pair would be shown twice
            table = table.triu()
        values, places = table.flatten().topk(min(most, table.numel()))
        rows, columns = np.unravel_index(places.numpy(), table.shape)
        shown[info.name] = [
            f"{info.words(labels[row], labels[column])} ({value:+.1f})"
            for row, column, value in zip(rows, columns, values.tolist(), strict=True)
        ]
    return shown


def _card(
    graph: RecipeGraph,
    knowledge: KnowledgeTables,
    inputs: Mapping[str, str],
    prompts: Sequence[Prompt],
) -> str:
    """Return the text of README.md."""
    cells = {name: "; ".join(phrases) for name, phrases in strongest(knowledge).items()}
    tables = "".join(
        f"| {prompt.name} | {prompt.role} | {prompt.template} | {cells[prompt.name]} |\n"
        for prompt in prompts
    )
    hashes = "".join(f"- {name}: `{value}`\n" for name, value in inputs.items())
    return f"""{front_matter("knowledge-graph", "language-model")}
# Knowledge of a {knowledge.record.source} for {graph.name}

Tables over {graph.num_entities:,} entities in `tables.safetensors` (float16, nats): the \
log-probability of a label
after a text, minus the label's log-probability after neutral texts (`prompts.json`). \
Rows are ingredients; columns are
results (part) or other ingredients (pair). No recipe was used.

| table | role | text | largest cells |
|---|---|---|---|
{tables}
SHA-256 hashes:

{hashes}"""
