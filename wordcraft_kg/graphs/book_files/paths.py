"""Paths in JSON, as the option `columns` names ingredients and results: ``recipes[].out.name``.

A path has keys after points, ``[]`` for each element of a list, ``[0]`` for its first one, ``{}``
for each value of an object, and ``{key}`` at its end for the keys of an object. A backslash takes
a sign in a key as it is. Paths that begin alike go through the same lists together.
"""

import math
import re
from collections.abc import Iterator, Sequence
from itertools import chain, islice, product
from typing import Any, NamedTuple

from wordcraft_kg.base.errors import ConfigError

GRAMMAR = (
    "a path of keys, with [] for each element of a list, [0] for the first, {} for each value of "
    "an object and {key} for its keys, such as 'recipes[].parts[],recipes[].out.name'"
)
EACH = "[]"
VALUES = "{}"
KEY = "{key}"
LOOPS = (EACH, VALUES)
Path = tuple[str, ...]
"""Steps: ``.name``, ``[]``, ``[3]``, ``{}``, and ``{key}`` for the key that ``{}`` is at."""
_STEP = re.compile(r"\[\d*\]|\{(?:key)?\}|\.?((?:\\.|[^.\[\]{}\\])+)")
MOST_STEPS = 50
"""Steps of the longest path."""
_MOST_SAMPLES = 200
_MOST_ROWS = 1_000_000  # of lists that are combined with each other


class Located(NamedTuple):
    """A value with its place, and the key at which an object has it."""

    place: str
    value: Any
    key: str = ""


def parse_path(text: str) -> Path:
    """Return the steps of a path.

    Raises:
        ConfigError: if the text is no path; the message has the grammar.
    """
    steps: list[str] = []
    at = 0
    while at < len(text):
        step = _STEP.match(text, at)
        if step is None or len(steps) > MOST_STEPS:
            raise ConfigError(f"`columns` {text[:80]!r}: expected {GRAMMAR}.")
        if step[1] is not None:
            steps.append("." + re.sub(r"\\(.)", r"\1", step[1]))
        else:
            steps += [VALUES, KEY] if step[0] == KEY else [step[0]]
        at = step.end()
    return tuple(steps)


def path_text(path: Path, is_table: bool = False) -> str:
    """Return a path as the option has it: of a table, the name or number of a column."""
    if is_table:
        name = path[-1]
        return name[1:] if name.startswith(".") else str(int(name[1:-1]) + 1)
    keys = ("." + re.sub(r"([.\[\]{}\\])", r"\\\1", step[1:]) for step in path)
    steps = (key if step.startswith(".") else step for key, step in zip(keys, path, strict=True))
    return "".join(steps).replace("{}{key}", KEY).removeprefix(".")


def fitted(path: Path, value: Any) -> Path:
    """Return a path with a ``[]`` wherever it meets a list, judged by a document's first values.

    Args:
        path: steps, in which ``[]`` may be left out.
        value: the document.
    """
    steps: list[str] = []
    samples = [Located("", value)]
    for step in (*path, None):
        is_place = step is not None and (step.startswith("[") or step == KEY)
        while not is_place and any(isinstance(each.value, list) for each in samples):
            if len(steps) > MOST_STEPS:
                break
            steps.append(EACH)
            samples = _samples(samples, EACH)
        if step is not None:
            steps.append(step)
            samples = _samples(samples, step)
    return tuple(steps)


def _samples(samples: Sequence[Located], step: str) -> list[Located]:
    inner = chain.from_iterable(_step(each, step) for each in samples)
    return list(islice((each for each in inner if each.value), _MOST_SAMPLES))


def _step(found: Located, step: str) -> Iterator[Located]:
    """Yield what a step leads to, with places."""
    place, value, _ = found
    if step == KEY:
        yield Located(place, found.key)
    elif step == EACH and isinstance(value, list):
        yield from (Located(f"{place}[{index}]", each) for index, each in enumerate(value))
    elif step == VALUES and isinstance(value, dict):
        for key, each in value.items():
            yield Located(f"{place}.{key}".removeprefix("."), each, key)
    elif step.startswith("[") and step != EACH and isinstance(value, list):
        index = int(step[1:-1])
        yield from (Located(f"{place}{step}", each) for each in value[index : index + 1])
    elif step.startswith(".") and isinstance(value, dict) and step[1:] in value:
        yield Located(f"{place}{step}".removeprefix("."), value[step[1:]])


def leaves(found: Located, path: Path) -> Iterator[Located]:
    """Yield all values at the end of a path.

    Args:
        found: the value at its begin.
        path: its steps.
    """
    if not path:
        yield found
    else:
        for inner in _step(found, path[0]):
            yield from leaves(inner, path[1:])


Columns = dict[int, list[Located]]
"""The values of each column in a row."""


def _rows(found: Located, paths: dict[int, Path], num_parts: int) -> Iterator[Columns]:
    """Yield the values of columns, whose paths go through the same lists together.

    Args:
        found: where the paths begin.
        paths: the rest of each column's path.
        num_parts: number of columns of ingredients, which are the first ones. A single one has a
            row for each list at its end.
    """
    groups: dict[Path, dict[int, Path]] = {}
    for column, path in paths.items():
        groups.setdefault(path[:1], {})[column] = path[1:]
    bound: Columns = {}
    several: list[list[Columns]] = []
    for step, inner in groups.items():
        first = next(iter(inner))
        whole = (*step, *inner[first])
        if not any(inner.values()):
            bound |= {column: list(leaves(found, step)) for column in inner}
        elif len(inner) > 1:
            each = (_rows(one, inner, num_parts) for one in _step(found, step[0]))
            several.append(list(chain.from_iterable(each)))
        elif num_parts == 1 and first == 0:
            loops = [i for i, step in enumerate(whole) if step in LOOPS]
            last = loops[-1] if loops else len(whole)
            lists = leaves(found, whole[:last])
            several.append([{0: list(leaves(one, whole[last:]))} for one in lists])
        else:
            bound[first] = list(leaves(found, whole))
    if len(several) > 1 and math.prod(map(len, several)) > _MOST_ROWS:
        raise ConfigError("`columns`: these paths go through different lists; name one list.")
    for combined in product(*several):
        row = dict(bound)
        for columns in combined:
            row |= columns
        yield row


def rows_of_paths(
    document: Any, parts: Sequence[Path], results: Sequence[Path]
) -> Iterator[tuple[str, list[Any], list[Any]]]:
    """Yield place, ingredients and results of each row, all of them values of JSON.

    Args:
        document: the document.
        parts: paths of ingredients.
        results: paths of the results.
    """
    columns = dict(enumerate([*parts, *results]))
    for row in _rows(Located("", document), columns, len(parts)):
        values = list(chain.from_iterable(row.get(i, []) for i in range(len(parts))))
        made = list(chain.from_iterable(row.get(i, []) for i in range(len(parts), len(columns))))
        place = (*values, *made, Located("", None))[0].place
        yield place, [found.value for found in values], [found.value for found in made]
