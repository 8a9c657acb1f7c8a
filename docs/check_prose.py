"""Measure the words that make English hard to read, for each kind of text; fail where a rate is above its limit.

Rates are counts per 1,000 words. PyKEEN's docstrings, for comparison: "of" 21, what- 0.2, pronouns 6.

Usage: ``python docs/check_prose.py`` prints all rates; ``python docs/check_prose.py docstrings pronouns`` prints the
phrases behind one rate.
"""

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
WORDS = {
    "of": r"of",
    "what-": r"what|whatever|whoever|whose|whom",
    "pronouns": r"those|that of|others?|ones?|them|it|its|itself|each other",
    "told": r"told|tells|said|says|asked|asks|judged|beside|stands?",
    "is no": r"(?:is|are) (?:none|no)",
}
LIMITS = {"of": 30.0, "what-": 1.5, "pronouns": 12.0, "told": 0.5, "is no": 0.4}
EXCEPTIONS: dict[tuple[str, str], tuple[float, str]] = {
    ("prompts", "pronouns"): (
        15,
        "the rule 'combine an item with itself' occurs in several prompts",
    ),
    ("prompts", "is no"): (
        2.2,
        "two plain sentences, such as 'There is no goal item.', among about 1,000 words",
    ),
}
"""Other limits: kind of text and rate, limit and reason."""
NAMES = ("found", "there", "asked", "told", "said", "beside", "judged")
MOST_NAMES = 0
"""Variables and parameters with one of :data:`NAMES`, which say nothing about their values."""
PROMPTS = (
    "wordcraft_kg/envs/words.py",
    "wordcraft_kg/apps/text_agents/knowledge.py",
    "wordcraft_kg/apps/text_agents/mcp_server.py",
)
"""Modules whose strings language models read; people read the templates of ``apps/people``."""


def texts() -> Iterator[tuple[str, Path, str]]:
    """Yield each text with its kind and its file."""
    for path in sorted(ROOT.glob("wordcraft_kg/**/*.py")):
        source = path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        yield from (("docstrings", path, text) for text in docstrings(tree))
        yield from (("errors", path, text) for text in errors(tree))
        yield from (("comments", path, text) for text in comments(source))
        if path.relative_to(ROOT).as_posix() in PROMPTS:
            yield from (("prompts", path, text) for text in strings(tree))
    for path in sorted(ROOT.glob("wordcraft_kg/**/*.html.j2")):
        text = re.sub(
            r"\{#.*?#\}|\{%.*?%\}|\{\{.*?\}\}|<[^>]*>",
            " ",
            path.read_text(encoding="utf-8"),
            flags=re.S,
        )
        yield "prompts" if "people" in path.relative_to(ROOT).parts else "templates", path, text
    for path in sorted(ROOT.glob("docs/notebooks/*.py")):
        text = "".join(
            re.findall(r"^# (?!%%)(?!    )(.*\n)", path.read_text(encoding="utf-8"), flags=re.M)
        )
        yield "guides", path, re.sub(r"`[^`\n]*`|\]\([^)]*\)", " ", text)
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = path.read_text(encoding="utf-8")
        if path.name == "commands.md":
            yield (
                "help",
                path,
                re.sub(r"```.*?```|`[^`\n]*`|<[^>]*>|\]\([^)]*\)", " ", text, flags=re.S),
            )
        else:
            yield (
                "guides",
                path,
                re.sub(r"```.*?```|`[^`\n]*`|^\|[^\n]*$|\]\([^)]*\)", " ", text, flags=re.S | re.M),
            )


def docstrings(tree: ast.Module) -> Iterator[str]:
    """Yield the docstrings of a module, without code."""
    for node in ast.walk(tree):
        kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        if isinstance(node, kinds) and (text := ast.get_docstring(node)):
            yield re.sub(r"``[^`]*``|:\w+:`[^`]*`", " ", text)


def errors(tree: ast.Module) -> Iterator[str]:
    """Yield the messages of errors that a module raises."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and re.search(
            r"Error$|^refuse", getattr(node.func, "id", "")
        ):
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield re.sub(r"`[^`]*`", " ", part.value)


def strings(tree: ast.Module) -> Iterator[str]:
    """Yield the strings of a module with a blank in them, without docstrings."""
    expressions = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        value = (
            node.value if isinstance(node, ast.Constant) and id(node) not in expressions else None
        )
        if isinstance(value, str) and " " in value.strip():
            yield value


def comments(source: str) -> Iterator[str]:
    """Yield the comments of a module."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and not re.match(r"# (?:noqa|type:|ruff)", token.string):
            yield token.string.lstrip("# ")


def uninformative_names() -> Counter[str]:
    """Return the number of variables and parameters in each file whose name is one of :data:`NAMES`."""
    counts: Counter[str] = Counter()
    for path in ROOT.glob("wordcraft_kg/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            is_new = (
                isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in NAMES
            )
            if is_new or (isinstance(node, ast.arg) and node.arg in NAMES):
                counts[path.relative_to(ROOT).as_posix()] += 1
    return counts


def main() -> int:
    """Print the rates of each kind of text, or the files behind one; return 1 if a limit is exceeded."""
    if len(sys.argv) == 3:
        return show(*sys.argv[1:])
    words: Counter[str] = Counter()
    counts: Counter[tuple[str, str]] = Counter()
    for kind, _, text in texts():
        words[kind] += len(re.findall(r"[a-z']+", text.lower()))
        for name, pattern in WORDS.items():
            counts[kind, name] += len(re.findall(rf"\b(?:{pattern})\b", text.lower()))
    exceeded = False
    for kind, number in words.items():
        cells = []
        for name in WORDS:
            rate, limit = (
                1000 * counts[kind, name] / number,
                EXCEPTIONS.get((kind, name), (LIMITS[name], ""))[0],
            )
            exceeded |= rate > limit
            cells.append(f"{name} {rate:.1f}{f' (at most {limit:g})' if rate > limit else ''}")
        print(f"{kind:10} {number:7,} words  {'  '.join(cells)}")
    names = uninformative_names().total()
    print(
        f"variables called {', '.join(NAMES)}: {names}{f' (at most {MOST_NAMES})' if names > MOST_NAMES else ''}"
    )
    return 1 if exceeded or names > MOST_NAMES else 0


def show(kind: str, name: str) -> int:
    """Print where the words of one rate are in one kind of text; ``names`` prints the files with such variables."""
    if name == "names":
        print(
            *(f"{number:4} {path}" for path, number in uninformative_names().most_common()),
            sep="\n",
        )
        return 0
    for text_kind, path, text in texts():
        if text_kind == kind:
            for match in re.finditer(
                rf"(?i)[^.\n]{{0,60}}\b(?:{WORDS[name]})\b[^.\n]{{0,40}}", text
            ):
                print(f"{path.relative_to(ROOT)}: {match[0].strip()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
