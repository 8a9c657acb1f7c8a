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
        if step is None:
            raise ConfigError(f"`columns` {text!r}: expected {GRAMMAR}.")
        if step[1] is not None:
            steps.append("." + re.sub(r"\\(.)", r"\1", step[1]))
        elif step[0] == KEY:
            steps += [VALUES, KEY]
        else:
            steps.append(step[0])
        at = step.end()
    if len(steps) > MOST_STEPS:
        raise ConfigError(f"`columns` {text[:80]!r}: more than {MOST_STEPS} steps.")
    return tuple(steps)


def path_text(path: Path, is_table: bool = False) -> str:
    """Return a path as the option has it: of a table, the name or number of a column."""
    if is_table:
        name = path[-1]
        return name[1:] if name.startswith(".") else str(int(name[1:-1]) + 1)
    steps = []
    for step in path:
        is_key = step.startswith(".")
        steps.append("." + re.sub(r"([.\[\]{}\\])", r"\\\1", step[1:]) if is_key else step)
    return "".join(steps).replace("{}{key}", KEY).removeprefix(".")


def fitted(path: Path, value: Any) -> Path:
    """Return a path with a ``[]`` wherever it meets a list, judged by a document's first values.

    Args:
        path: steps, in which ``[]`` may be left out.
        value: the document.
    """
    steps: list[str] = []
    samples = [value]
    for step in (*path, None):
        is_place = step is not None and step.startswith("[")
        while any(isinstance(each, list) for each in samples) and not is_place and step != KEY:
            if len(steps) > MOST_STEPS:
                break
            steps.append(EACH)
            samples = _next_samples(samples, EACH)
        if step is not None:
            steps.append(step)
            samples = _next_samples(samples, step)
    return tuple(steps)


def _next_samples(samples: Sequence[Any], step: str) -> list[Any]:
    inner = (found.value for each in samples for found in _step("", each, step))
    return list(islice((each for each in inner if each not in (None, [], {})), _MOST_SAMPLES))


def _step(place: str, value: Any, step: str) -> Iterator[Located]:
    """Yield what a step leads to, with places."""
    if step == EACH:
        if isinstance(value, list):
            for index, each in enumerate(value):
                yield Located(f"{place}[{index}]", each)
    elif step.startswith("["):
        index = int(step[1:-1])
        if isinstance(value, list) and index < len(value):
            yield Located(f"{place}{step}", value[index])
    elif step == VALUES:
        if isinstance(value, dict):
            for key, each in value.items():
                yield Located(f"{place}.{key}".removeprefix("."), each, key)
    elif isinstance(value, dict) and step[1:] in value:
        yield Located(f"{place}{step}".removeprefix("."), value[step[1:]])


def leaves(found: Located, path: Path) -> Iterator[Located]:
    """Yield all values at the end of a path.

    Args:
        found: the value at its begin.
        path: its steps.
    """
    if not path:
        yield found
    elif path[0] == KEY:
        yield Located(found.place, found.key)
    else:
        for inner in _step(found.place, found.value, path[0]):
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
    groups: dict[str, dict[int, Path]] = {}
    for column, path in paths.items():
        groups.setdefault(path[0] if path else "", {})[column] = path[1:]
    bound: Columns = {}
    several: list[list[Columns]] = []
    for step, inner in groups.items():
        first = next(iter(inner))
        whole = (step, *inner[first]) if step else ()
        if step in ("", KEY):
            bound |= {column: list(leaves(found, (step,) if step else ())) for column in inner}
        elif len(inner) > 1:
            each = _step(found.place, found.value, step)
            several.append(list(chain.from_iterable(_rows(one, inner, num_parts) for one in each)))
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
