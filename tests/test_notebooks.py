"""Stored notebooks belong to the code of their sources, and the code runs."""

import json
import runpy
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "docs" / "make_notebooks.py"
pytest.importorskip("nbformat", reason="needs nbformat")
SOURCE = "# %% [markdown]\n# # A title\n#\n# Text.\n\n# %%\nsorted([2, 1])\n"


@pytest.fixture
def script(tmp_path, monkeypatch):
    """The script on a folder with a source and a stored notebook."""
    names = runpy.run_path(str(SCRIPT))
    monkeypatch.setitem(names["main"].__globals__, "HERE", tmp_path)
    (tmp_path / "one.py").write_text(SOURCE)
    executed = names["read_source"](tmp_path / "one.py")
    printed = {"output_type": "stream", "name": "stdout", "text": "[1, 2]\n"}
    log = {"output_type": "stream", "name": "stderr", "text": "/home/somebody took 3 seconds\n"}
    executed.cells[1].outputs = [names["nbformat"].from_dict(output) for output in (printed, log)]
    notebook = names["with_outputs"](names["read_source"](tmp_path / "one.py"), executed)
    (tmp_path / "one.ipynb").write_text(names["text_of"](notebook))

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["make_notebooks.py", *arguments])
        names["main"]()

    return call


def test_a_stored_notebook_has_its_sources_cells_and_stdout(script, tmp_path):
    """A stored notebook has the cells of its source and the outputs of stdout."""
    script("--check")
    stored = json.loads((tmp_path / "one.ipynb").read_text())
    assert ["".join(cell["source"]) for cell in stored["cells"]] == [
        "# A title\n\nText.",
        "sorted([2, 1])",
    ]
    assert [output["name"] for output in stored["cells"][1]["outputs"]] == ["stdout"]


def test_changed_code_is_refused_until_the_notebook_is_run_again(script, tmp_path):
    (tmp_path / "one.py").write_text(SOURCE.replace("[2, 1]", "[3, 1]"))
    for mode in ("--check", "--text"):
        with pytest.raises(
            SystemExit, match=r"one.ipynb was made by other code than one.py. Run it: .* one$"
        ):
            script(mode)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [path.stem for path in sorted((SCRIPT.parent / "notebooks").glob("*.py"))]
)
def test_a_notebook_runs_and_gives_the_kinds_of_outputs_that_are_stored(name):
    for module in ("nbclient", "ipykernel", "sb3_contrib", "transformers"):
        pytest.importorskip(module, reason="needs the extras docs, interop and text")
    names, source = runpy.run_path(str(SCRIPT)), SCRIPT.parent / "notebooks" / f"{name}.py"
    new, old = (
        names["code_cells"](one.cells)
        for one in (names["run"](source), names["read_stored"](source))
    )
    kinds = [
        [[output.output_type for output in cell.outputs] for cell in cells] for cells in (new, old)
    ]
    assert kinds[0] == kinds[1]
