"""Ways to spoil bytes, texts and values; all draws come from the generator that is passed in."""

import json

ODD_LABELS = (
    *(
        "",
        " ",
        "?",
        "-x",
        "a,b",
        'a"b',
        "a\tb",
        "a\nb",
        "a\x00b",
        "a\x1bb",
        "\ufeff",
        "é",
        "e\u0301",
        "İ",
        "ß",
        "𝒳",
    ),
    *(
        "👩‍🍳",
        "\u202eabc",
        "\u2028",
        "\ud800",
        "x" * 999,
        "x" * 1_001,
        "../../x",
        "/",
        "<&>]]>",
        "%s{0}",
        "nan",
    ),
    *("None", "true", "0", "=1+1", "#x", "http://x/?a=b#c", "\\", "'", "Water", "water "),
)
ODD_VALUES = (
    *(
        None,
        True,
        0,
        -1,
        1.5,
        2**31,
        2**63,
        2**64,
        10**400,
        1e308,
        1e-320,
        float("nan"),
        float("inf"),
        "",
        "text",
    ),
    *("1", "1979-05-27", "\ud800", "x" * 100_000, [], [[]], {}, {"a": 1}, [None], [1, "a", None]),
)


def spoilt_bytes(data, rng):
    """Flip, cut, insert, remove or repeat bytes."""
    at = rng.randrange(len(data) + 1)
    to = min(len(data), at + rng.choice((1, 2, 10, 1_000)))
    new = rng.choice(
        (b"\x00", b"\xff\xfe", b"\n", b'"', b",", b"\r", rng.randbytes(20), b"{", b"\xed\xa0\x80")
    )
    flipped = bytes(byte ^ (1 << rng.randrange(8)) for byte in data[at : at + 1])
    ways = {
        f"byte {at} flipped": data[:at] + flipped + data[at + 1 :],
        f"cut at {at}": data[:at],
        f"{new!r} at {at}": data[:at] + new + data[at:],
        f"without bytes {at} to {to}": data[:at] + data[to:],
        f"bytes {at} to {to} twice": data[:to] + data[at:],
        "with a byte order mark": b"\xef\xbb\xbf" + data,
        "zeros": bytes(len(data)),
        "as UTF-16": data.decode("utf-8", "replace").encode("utf-16"),
        "empty": b"",
    }
    what = rng.choice(list(ways))
    return what, ways[what]


def spoilt_lines(text, rng):
    """Move, repeat, remove or change lines and their cells."""
    lines = text.split("\n")
    at = rng.randrange(len(lines))
    line = lines[at]
    separator = "\t" if "\t" in line else ","
    cells = line.split(separator)
    cell = rng.randrange(len(cells))
    label = rng.choice(ODD_LABELS).encode("utf-8", "replace").decode()
    changes = (
        ("removed", lambda: []),
        ("twice", lambda: [line, line]),
        ("empty", lambda: ["", line]),
        ("a cell less", lambda: [separator.join(cells[:cell] + cells[cell + 1 :])]),
        ("a cell more", lambda: [separator.join([*cells, label])]),
        ("another cell", lambda: [separator.join([*cells[:cell], label, *cells[cell + 1 :]])]),
        ("an equal cell", lambda: [separator.join([*cells[:cell], cells[0], *cells[cell + 1 :]])]),
        ("another separator", lambda: [line.replace(separator, rng.choice((";", "\t", ",", " ")))]),
        ("an open quote", lambda: ['"' + line]),
        ("quoted", lambda: [separator.join(f'"{one}"' for one in cells)]),
        (
            "a directive",
            lambda: [
                rng.choice(("# base: ", "# entities: ", "#base:", "# base: ,,")) + label,
                line,
            ],
        ),
        ("a comment", lambda: ["# " + label, line]),
        ("a return", lambda: [line + "\r"]),
        ("a long one", lambda: [line + "x" * 200_000]),
        ("another place", lambda: [lines[rng.randrange(len(lines))]]),
    )
    what, change = rng.choice(changes)
    return f"line {at + 1}: {what} ({label[:20]!r})", "\n".join(
        [*lines[:at], *change(), *lines[at + 1 :]]
    )


def spoilt_value(value, rng):
    """Change one value somewhere in a tree of values: another type, another key, one more or one
    less."""
    what, new, _ = _spoilt(value, rng)
    return what, new


def _spoilt(node, rng):
    """Return what was done, the new value, and whether it is to be removed."""
    if not isinstance(node, dict | list) or not node or rng.random() > 0.75:
        return _changed(node, rng)
    key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
    what, new, is_gone = _spoilt(node[key], rng)
    copy = node.copy()
    if is_gone:
        del copy[key]
    else:
        copy[key] = new
    return f"{str(key)[:30]}: {what}", copy, False


def _changed(node, rng):
    odd = rng.choice(ODD_VALUES)
    ways = {
        **dict.fromkeys(("other", "another"), lambda: odd),
        "gone": lambda: None,
        "label": lambda: rng.choice(ODD_LABELS),
        "deep": lambda: json.loads("[" * 500 + "]" * 500),
        "list": lambda: [node],
    }
    if isinstance(node, dict):
        ways["more"] = lambda: {**node, "unheard": odd}
        ways["renamed"] = lambda: {
            (f"{key}x" if rng.random() < 0.3 else key): entry for key, entry in node.items()
        }
    elif isinstance(node, list):
        ways["repeated"] = lambda: node * rng.choice((2, 1_000))
        ways |= {"reversed": lambda: node[::-1], "shorter": lambda: node[: len(node) // 2]}
    elif isinstance(node, int | float) and not isinstance(node, bool):
        ways |= {
            "negative": lambda: -node - 1,
            "next": lambda: node + 1,
            "large": lambda: node * 10**9,
        }
        ways["float"] = lambda: 0.5 if abs(node) > 1e300 else node + 0.5
    elif isinstance(node, str):
        ways |= {"longer": lambda: node * 2, "upper": lambda: node.upper()}
    way = rng.choice(list(ways))
    new = ways[way]()
    return f"{way} {repr(new)[:40]}", new, way == "gone"


def as_json(value):
    """Write a value as JSON, surrogates and numbers without end included."""
    return json.dumps(value, ensure_ascii=False).encode("utf-8", "surrogatepass")


def toml_of(value):
    """Write a value as TOML as far as it can be; some come out as no TOML at all,
    which is meant."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml_of(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, float):
        return repr(value)
    return "1979-05-27" if value == "1979-05-27" else json.dumps(value)
