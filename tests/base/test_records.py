"""Records as plain values: what JSON has, within the bounds of their types, and nothing else."""

import json
from typing import Annotated

import jsonschema
import msgspec
import numpy as np
import pytest

from wordcraft_kg.base import (
    ArtefactError,
    Count,
    Record,
    Share,
    as_values,
    checked_values,
    parse_record,
    records,
    schema_of,
)
from wordcraft_kg.models.links.link_config import ComplExConfig


class Row(Record, omit_defaults=True):
    name: str
    counts: tuple[Count, ...]
    share: Share | None = None
    at_one: Share | None = msgspec.field(default=None, name="hits@1")


class Table(Record):
    """A table.

    Attributes:
        rows: all rows,
            in order.
        by_name, other: rows again.

    Example:
        >>> rows: no entry
    """

    rows: Annotated[tuple[Row, ...], msgspec.Meta(min_length=1)]
    by_name: dict[str, Row]


ROW = Row("a", (1, 2), share=0.5)


def test_values_are_those_that_json_gives_back():
    values = as_values(Table((ROW, Row("b", (), at_one=1.0)), {"a": ROW}))
    assert values == {
        "rows": [
            {"name": "a", "counts": [1, 2], "share": 0.5},
            {"name": "b", "counts": [], "hits@1": 1.0},
        ],
        "by_name": {"a": {"name": "a", "counts": [1, 2], "share": 0.5}},
    }
    assert json.loads(json.dumps(values)) == values


@pytest.mark.parametrize("number", [float("nan"), float("inf"), np.float64(0.5), np.int64(1)])
def test_what_json_does_not_have_is_refused(number):
    with pytest.raises((TypeError, ValueError)):
        as_values(Row("a", (), share=number))


@pytest.mark.parametrize(
    ("table", "field"),
    [
        (Table((Row("a", (), share=1.5),), {}), r"rows\[0\]\.share"),
        (Table((Row("a", (1, -1)),), {}), r"counts\[1\]"),
        (Table((), {}), "rows"),
        (Table((Row(1, ()),), {}), "name"),
    ],
)
def test_a_value_out_of_bounds_is_refused_by_the_name_of_its_field(table, field):
    with pytest.raises(ValueError, match=field):
        checked_values(table)
    schema = schema_of(Table, "urn:table", "table")
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(as_values(table), schema)


def test_good_values_pass_the_check_and_the_schema():
    table = Table((ROW,), {"a": ROW})
    assert checked_values(table) == as_values(table)
    schema = schema_of(Table, "urn:table", "table")
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(as_values(table), schema)
    for other in ({"rows": as_values(table)["rows"]}, as_values(table) | {"surprise": 1}):
        with pytest.raises(jsonschema.ValidationError, match=r"by_name|surprise"):
            jsonschema.validate(other, schema)
    assert (schema["$id"], schema["title"]) == ("urn:table", "table")


def test_the_schema_has_the_docstring_of_each_record():
    definitions = schema_of(Table, "urn:table", "table")["$defs"]
    first, attributes, _ = definitions["Table"]["description"].split("\n\n")
    assert (first, attributes.splitlines()[1]) == ("A table.", "    rows: all rows,")
    assert "description" not in definitions["Row"]


def test_a_field_is_named_in_quotes_because_backticks_are_for_settings():
    with pytest.raises(ArtefactError) as of_bytes:
        parse_record(b'{"name": 1, "counts": []}', Row, "row.json")
    with pytest.raises(ArtefactError) as of_values:
        records.as_record({"dim": -1}, ComplExConfig, "config.toml")
    assert str(of_bytes.value) == (
        "row.json is damaged: Expected 'str', got 'int' - at '$.name'. Make it again, or restore a "
        "copy."
    )
    assert str(of_values.value) == (
        "config.toml is damaged: 'dim' -1: expected a whole number, 1 or more. Make it again, or "
        "restore a copy."
    )
