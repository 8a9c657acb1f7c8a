"""Run the notebooks and store their outputs; a hook for the website renders the stored outputs.

    python docs/make_notebooks.py [NAME ...]           run all notebooks, or the named ones (`make notebooks`)
    python docs/make_notebooks.py --text               write changed texts into the stored notebooks; run nothing
    python docs/make_notebooks.py --check              exit with 1 if a stored notebook differs from its source

A source is a Python file in docs/notebooks/: ``# %%`` begins a code cell, ``# %% [markdown]`` a text cell in comments.
The notebook with all outputs is stored next to the source, with the code's SHA-256.
"""

import argparse
import hashlib
import os
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import nbformat

from wordcraft_kg.base.artefacts import write_atomically

ROOT = Path(__file__).resolve().parents[1]
HERE = ROOT / "docs" / "notebooks"
HASH = "code_sha256"
PLAIN = re.compile(
    r'<style scoped>.*?</style>\n| border="1" class="dataframe"| style="text-align: \w+;"',
    re.DOTALL,
)
"""A data frame's looks, left out so that the table looks like all tables on the website."""


class StaleError(ValueError):
    """A stored notebook does not belong to the source."""


def read_source(path: Path) -> Any:
    """Return a source's notebook without outputs, with the code's hash."""
    _, *parts = re.split(r"^# %%(.*)\n", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    cells = []
    for number, (kind, text) in enumerate(zip(parts[::2], parts[1::2], strict=True)):
        if "[markdown]" in kind:
            text = re.sub(r"^# ?", "", text.strip(), flags=re.MULTILINE)
            cells.append(nbformat.v4.new_markdown_cell(text, id=f"cell-{number}"))
        else:
            cells.append(nbformat.v4.new_code_cell(text.strip(), id=f"cell-{number}"))
    code = "\n# %%\n".join(cell.source for cell in code_cells(cells))
    metadata = {
        "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"},
        "language_info": {"name": "python"},
        HASH: hashlib.sha256(code.encode()).hexdigest(),
    }
    return nbformat.v4.new_notebook(cells=cells, metadata=metadata)


def code_cells(cells: Any) -> list[Any]:
    """Return the code cells."""
    return [cell for cell in cells if cell.cell_type == "code"]


def with_outputs(notebook: Any, executed: Any) -> Any:
    """Put an executed notebook's outputs into a notebook with the same code."""
    cells = zip(code_cells(notebook.cells), code_cells(executed.cells), strict=True)
    for number, (new, old) in enumerate(cells, 1):
        # Logs on stderr name folders and seconds of one run.
        new.outputs = [output for output in old.outputs if output.get("name") != "stderr"]
        new.execution_count = number
        for output in new.outputs:
            if "text/html" in output.get("data", {}):
                output["data"]["text/html"] = PLAIN.sub("", output["data"]["text/html"])
    return notebook


def read_stored(source: Path) -> Any:
    """Return a source's notebook with the stored outputs; StaleError if the code has changed."""
    notebook, path = read_source(source), source.with_suffix(".ipynb")
    again = f"Run it: python docs/make_notebooks.py {source.stem}"
    try:
        stored = nbformat.read(path, as_version=4)
        if stored.metadata.get(HASH) == notebook.metadata[HASH]:
            return with_outputs(notebook, stored)
    except (OSError, ValueError, AttributeError) as error:
        raise StaleError(
            f"{path.name} is missing or damaged ({type(error).__name__}). {again}"
        ) from None
    problem = (
        "was made by other code than" if HASH in stored.metadata else "has no hash for the code in"
    )
    raise StaleError(f"{path.name} {problem} {source.name}. {again}")


def run(source: Path) -> Any:
    """Return a source's notebook, executed in a new folder with links to the
    repository's folders.
    """
    from nbclient import NotebookClient

    executed = read_source(source)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("examples", "leaderboard"):
            (Path(folder) / name).symlink_to(ROOT / name)
        client = NotebookClient(
            executed, timeout=900, coalesce_streams=True, resources={"metadata": {"path": folder}}
        )
        client.extra_arguments = ["--IPKernelApp.log_level=40"]
        client.execute()
    return with_outputs(read_source(source), executed)


def text_of(notebook: Any) -> str:
    """Return a notebook's text in the stored form."""
    return nbformat.writes(notebook) + "\n"


def on_files(files: Any, *, config: Any) -> Any:
    """Add a page for each notebook to the website; an error if a stored notebook is stale."""
    from mkdocs.exceptions import PluginError
    from mkdocs.structure.files import File
    from nbconvert import MarkdownExporter

    for source in sorted(HERE.glob("*.py")):
        name = source.stem
        try:
            body, resources = MarkdownExporter().from_notebook_node(
                read_stored(source), {"unique_key": name}
            )
        except StaleError as error:
            raise PluginError(str(error)) from None
        for picture, data in resources["outputs"].items():
            title = re.search(r"<title>(.*?)</title>", data.decode())
            body = body.replace(f"![svg]({picture})", f"![{title[1] if title else ''}]({picture})")
            files.append(File.generated(config, f"notebooks/{picture}", content=data))
        body += f"\n\n[This notebook]({name}.ipynb), executed by `make notebooks`.\n"
        files.append(File.generated(config, f"notebooks/{name}.md", content=body))
    return files


def main() -> None:
    """Run notebooks, write texts, or check."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME")
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--text", action="store_true")
    mode.add_argument("--check", action="store_true")
    given = parser.parse_args()
    sources = {path.stem: path for path in sorted(HERE.glob("*.py"))}
    if unknown := set(given.names) - set(sources):
        sys.exit(f"no notebook {', '.join(sorted(unknown))}; expected {', '.join(sources)}.")
    os.environ["OMP_NUM_THREADS"] = "1"  # the same results for any number of cores
    stale = []
    for source in (sources[name] for name in given.names or sources):
        path, start = source.with_suffix(".ipynb"), time.perf_counter()
        try:
            text = text_of(read_stored(source) if given.text or given.check else run(source))
        except StaleError as error:
            stale.append(str(error))
            continue
        if given.check and text != path.read_text(encoding="utf-8"):
            stale.append(
                f"{path.name} has other texts than {source.name}. Run: python "
                "docs/make_notebooks.py --text"
            )
        elif not given.check:
            write_atomically(path, text)
        if not (given.check or given.text):
            sys.stderr.write(f"{source.stem}: {time.perf_counter() - start:.0f} s\n")
    if stale:
        sys.exit("\n".join(stale))


if __name__ == "__main__":
    main()
