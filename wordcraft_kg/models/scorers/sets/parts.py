"""Parts of entities, with amounts: from a table, or by a parser of labels.

Parts are letters for a spelling game, nutrients for a kitchen, elements for a laboratory. Chemical
formulas are read by the library ``periodictable``.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import ConfigError, check_file, counted, reason, refuse
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.graphs.recipes import label_fault

NO_PARTS = "none"
"""Name for a model that knows entities by their words alone."""
_COLUMNS = ("label", "part", "amount")
_SHOWN = 5
"""Most unreadable labels in an error."""
_MAX_SIZE = 2**28
"""Most bytes of a table of parts, and of all amounts."""
_ANYTHING = "anything"
"""The single part of all entities in a model without parts."""
_HYDRATE = re.compile(r"[·•∙⋅*]\s*")
"""Signs before the water of a hydrate; the library writes a plus."""
_NOT_OF_FORMULAS = re.compile(r"[/%:@]|\[\d+\]")
"""Signs of mixtures, densities and isotopes, which the library reads as something else."""
_BRACKETS = str.maketrans("[]", "()")


@cache
def parse_formula(label: str) -> Mapping[str, float]:
    """Return the elements in a formula and their amounts.

    Args:
        label: a formula, with brackets of both kinds, decimals and hydrates.

    Raises:
        ConfigError: if the library cannot read it, as with ``x`` for an amount.
        MissingExtraError: if the library is not installed.

    Example:
        >>> parse_formula("BaTi0.9Zr0.1O3")
        {'Ba': 1, 'Ti': 0.9, 'Zr': 0.1, 'O': 3}
    """
    # Not within: a missing library is no fault of the formula.
    check_extra("chemistry")
    from periodictable import formula

    sign = _NOT_OF_FORMULAS.search(label)
    text = _HYDRATE.sub("+", label.translate(_BRACKETS))
    # The library's parser raises errors of several kinds, some of which are plain ones.
    try:
        if sign:
            raise ValueError(f"it has {sign[0]}")
        atoms = formula(text).atoms
        # Ions and isotopes are parts of their own names; amounts may be anything that was typed.
        amounts = {str(atom): float(amount) for atom, amount in atoms.items() if amount > 0}
        if not amounts:
            raise ValueError("no element")
    except Exception as error:
        raise ConfigError(
            f"'{label}' is no chemical formula ({reason(error)}); expected one "
            "such as BaTi0.9Zr0.1O3, without x or y. Write amounts as numbers, or give `parts` as "
            "a table."
        ) from None
    return amounts


PARSERS: dict[str, Callable[[str], Mapping[str, float]]] = {"formulas": parse_formula}
"""Functions that read the parts of an entity in its label, by the name that a user chooses."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of entities.

    Attributes:
        labels: names of the parts, P of them, sorted.
        amounts: shape (E, P), float32: each part's share of an entity; rows without a part are 0.
    """

    labels: tuple[str, ...]
    amounts: NDArray[np.float32]

    @classmethod
    def of(
        cls, parts_of_entity: Sequence[Mapping[str, float]], labels: Sequence[str] = ()
    ) -> "Parts":
        """Make shares of amounts.

        Args:
            parts_of_entity: amounts by part, for each entity.
            labels: names of the parts, others are left out; none takes all that occur.

        Raises:
            ConfigError: if the table of all amounts would be too large.
        """
        names = tuple(labels) or tuple(
            sorted({part for parts in parts_of_entity for part in parts})
        )
        num_bytes = 4 * len(names) * len(parts_of_entity)
        if num_bytes > _MAX_SIZE:
            raise ConfigError(
                f"{len(names):,} parts of {len(parts_of_entity):,} entities take "
                f"{num_bytes / 2**20:,.0f} MiB; expected at most {_MAX_SIZE / 2**20:,.0f}."
            )
        column = {name: place for place, name in enumerate(names)}
        amounts = np.zeros((len(parts_of_entity), len(names)), dtype=np.float32)
        for row, parts in enumerate(parts_of_entity):
            total = sum(parts.values())
            for part, amount in parts.items():
                if part in column:
                    amounts[row, column[part]] = amount / total
        return cls(names, amounts)

    @classmethod
    def nothing(cls, num_entities: int) -> "Parts":
        """Return a single part that all entities have, for a model without parts."""
        return cls((_ANYTHING,), np.ones((num_entities, 1), dtype=np.float32))

    @property
    def sha256(self) -> str:
        """Hash of names and amounts, for run records."""
        digest = sha256("\n".join(self.labels).encode())
        digest.update(self.amounts.astype("<f4").tobytes())
        return digest.hexdigest()


def read_parts(source: str, labels: Sequence[str], *, allow_missing: bool = False) -> Parts:
    """Return the shares of parts of entities by their labels.

    Args:
        source: as in :func:`parts_of_labels`, or :data:`NO_PARTS`.
        labels: the entities.
        allow_missing: whether entities may have no parts.

    Raises:
        ConfigError: also if all entities have the same single part, which tells none apart.
    """
    if source == NO_PARTS:
        return Parts.nothing(len(labels))
    parts = Parts.of(parts_of_labels(source, labels, allow_missing=allow_missing))
    if len(parts.labels) == 1:
        raise ConfigError(
            f"`parts` {source}: '{parts.labels[0]}' is the only part, which tells no entities "
            f"apart; expected two parts or more. Use `parts` {NO_PARTS} to train without."
        )
    return parts


def parts_of_labels(
    source: str, labels: Sequence[str], *, allow_missing: bool = False
) -> list[Mapping[str, float]]:
    """Return the amounts of the parts of entities by their labels.

    Args:
        source: a parser in :data:`PARSERS`, or a CSV file with the columns label, part, amount.
        labels: labels of the entities, in id order.
        allow_missing: whether entities may lack parts.

    Raises:
        ConfigError: if the source is neither a known name nor a file, a label has no parts, with
            examples, or the file has a wrong line.
        MissingExtraError: if the parser's library is not installed.
    """
    if source not in PARSERS and not Path(source).is_file():
        names = " or ".join((NO_PARTS, *PARSERS))
        raise refuse("parts", source, f"{names}, or a table with the columns label, part, amount")
    parse = PARSERS[source] if source in PARSERS else _read_table(Path(source)).get
    parts_of_entity: list[Mapping[str, float]] = []
    for label in labels:
        try:
            parts_of_entity.append(parse(label) or {})
        except ConfigError:
            # A single label has an error of its own, which says more.
            if len(labels) == 1:
                raise
            parts_of_entity.append({})
    missing = [label for label, parts in zip(labels, parts_of_entity, strict=True) if not parts]
    if len(missing) == len(labels) or (missing and not allow_missing):
        examples = ", ".join(f"'{label}'" for label in missing[:_SHOWN])
        raise ConfigError(
            f"`parts` {source}: {counted(len(missing), 'label')} of {len(labels):,} without parts, "
            f"such as {examples}. Correct them, give a table with the columns label, part, amount, "
            "or use `allow_missing`."
        )
    return parts_of_entity


def _read_table(path: Path) -> dict[str, dict[str, float]]:
    """Return amounts by part and label from a CSV file."""
    check_file(path, _MAX_SIZE)
    try:
        rows = csv.DictReader(io.StringIO(path.read_text("utf-8-sig"), newline=""), strict=True)
        if tuple(rows.fieldnames or ()) != _COLUMNS:
            raise ValueError(f"its header is {rows.fieldnames}")
        table: dict[str, dict[str, float]] = {}
        for row in rows:
            label, part, amount = (row[name] or "" for name in _COLUMNS)
            try:
                number = float(amount)
            except ValueError:
                number = math.nan
            is_sound = label and label_fault(part) is None and 0 < number < math.inf
            if not is_sound or None in row:
                raise ValueError(f"line {rows.line_num} is {label!r}, {part!r}, {amount!r}")
            parts = table.setdefault(label, {})
            parts[part] = parts.get(part, 0) + number
    except (ValueError, csv.Error) as error:
        raise ConfigError(
            f"{path}: no table of parts ({error}); expected UTF-8 with the columns label, part and "
            "amount, a number above 0."
        ) from None
    return table
