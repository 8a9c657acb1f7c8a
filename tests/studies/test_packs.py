"""Packs of cells: read as loose cells are, the same bytes each time, and refused by name if damaged
or hostile."""

import zipfile

import pytest
from small_study import pretend, run_small, small_plan

from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.studies.cells import read_cell
from wordcraft_kg.studies.engine import estimated_hours
from wordcraft_kg.studies.packs import CellFiles, pack_files, write_pack
from wordcraft_kg.studies.store import collect_study

ONE, TWO = "runs/0123456789abcdef", "scorers/0123456789abcdef"


@pytest.fixture
def store(tmp_path):
    """A store with the loose cells of a study that was pretended to run."""
    run_small(tmp_path / "first", work=pretend, store=tmp_path / "cells")
    return tmp_path / "cells"


def the_run():
    plan = small_plan()
    return plan.tasks[plan.runs[-1]]


def packed(store, name="small.zip"):
    """Move all loose cells of a store into a pack, and return its path."""
    cells = CellFiles(store)
    contents = {address: cells.read(address) for address in cells.addresses()}
    assert write_pack(store / name, contents)
    for address in contents:
        cells.loose(address).unlink()
    return store / name


def archive(path, *members, method=zipfile.ZIP_DEFLATED):
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w", method) as file:
        for name, content in members:
            file.writestr(name, content)
    return path


def test_packed_cells_give_the_results_of_loose_ones(tmp_path, store):
    """Packed cells give the results of loose ones and nothing is extracted."""
    plan = small_plan()
    assert run_small(tmp_path / "loose", work=pretend, store=store).began == []
    loose = collect_study(tmp_path / "loose", "small")
    hours = estimated_hours(plan, tmp_path / "packed", store)
    path = packed(store)
    assert estimated_hours(plan, tmp_path / "packed", store) == hours
    assert hours < estimated_hours(plan, tmp_path / "packed")
    assert run_small(tmp_path / "packed", work=pretend, store=store).began == []
    assert collect_study(tmp_path / "packed", "small") == loose
    files = [path for path in store.rglob("*") if path.is_file()]
    assert files == [path]


def test_the_same_cells_give_the_same_bytes_in_any_order(tmp_path):
    cells = {TWO: b"two", ONE: b"one"}
    assert write_pack(tmp_path / "a.zip", cells)
    assert write_pack(tmp_path / "b.zip", dict(reversed(cells.items())))
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert not write_pack(tmp_path / "a.zip", cells), "nothing to change"
    assert write_pack(tmp_path / "a.zip", {ONE: b"other"})
    (tmp_path / "b.zip").unlink()
    assert CellFiles(tmp_path).read(ONE) == b"other"


def test_a_loose_cell_comes_before_a_packed_one(tmp_path):
    write_pack(tmp_path / "a.zip", {ONE: b"packed", TWO: b"packed"})
    cells = CellFiles(tmp_path)
    assert cells.read(ONE) == b"packed"
    cells.loose(ONE).parent.mkdir()
    cells.loose(ONE).write_bytes(b"loose")
    assert (cells.read(ONE), cells.read(TWO)) == (b"loose", b"packed")
    assert cells.where(ONE) == str(tmp_path / f"{ONE}.json")
    assert cells.addresses() == {
        ONE: tmp_path / f"{ONE}.json",
        TWO: tmp_path / "a.zip",
    }
    assert cells.where("runs/" + "f" * 16) is None


def test_a_damaged_packed_cell_is_trained_again_and_the_loose_one_counts(tmp_path, store, caplog):
    path = packed(store)
    member = f"{the_run().address}.json"
    content = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as file:
        begin = file.getinfo(member).header_offset + 30 + len(member)
    content[begin + 40] ^= 0xFF
    path.write_bytes(content)
    began = run_small(tmp_path / "second", work=pretend, store=store).began
    assert the_run().title in began
    assert f"{path}, member '{member}', is damaged" in caplog.text
    cells = CellFiles(store)
    assert cells.where(the_run().address) == str(cells.loose(the_run().address))
    assert read_cell(the_run(), cells) is not None


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ([("../runs/0123456789abcdef.json", "")], "'../runs/0123456789abcdef.json' is no cell"),
        ([("/runs/0123456789abcdef.json", "")], "is no cell"),
        ([("runs/", "")], "is no cell"),
        ([("runs/0123456789abcdef.json\n", "")], "is no cell"),
        ([("graphs/0123456789abcdef.json", "")], "is no cell"),
    ],
)
def test_an_archive_with_other_members_is_refused_before_anything_starts(
    tmp_path, members, message
):
    path = archive(tmp_path / "cells" / "theirs.zip", *members)
    with pytest.raises(ArtefactError, match=r"theirs\.zip is no pack of cells") as raised:
        run_small(tmp_path / "results", work=pretend, store=path.parent)
    assert message in str(raised.value)
    assert not (tmp_path / "results").exists()


def test_members_are_checked_before_any_is_read(tmp_path):
    archive(tmp_path / "a.zip", (f"{ONE}.json", b"0" * (2**24 + 1)))
    with pytest.raises(ArtefactError, match="has 16,777,217 bytes; the limit is 16,777,216"):
        CellFiles(tmp_path)


@pytest.mark.parametrize("keep", [0, 10, -30])
def test_a_cut_archive_is_refused_by_name(tmp_path, keep):
    path = archive(tmp_path / "cut.zip", (f"{ONE}.json", "1"), (f"{TWO}.json", "2"))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ArtefactError, match=r"cut\.zip is damaged"):
        CellFiles(tmp_path)


def test_a_cell_in_two_packs_is_refused_and_so_is_a_folder(tmp_path):
    write_pack(tmp_path / "a.zip", {ONE: b"1"})
    write_pack(tmp_path / "b.zip", {ONE: b"1"})
    with pytest.raises(ArtefactError, match=r"b\.zip has the cell .*, and so has .*a\.zip"):
        CellFiles(tmp_path)
    (tmp_path / "b.zip").unlink()
    (tmp_path / "b.zip").mkdir()
    with pytest.raises(ArtefactError, match=r"b\.zip is damaged: not a regular file"):
        CellFiles(tmp_path)


def test_a_cell_too_large_for_a_pack_leaves_the_pack_as_it_is(tmp_path):
    write_pack(tmp_path / "a.zip", {ONE: b"1"})
    before = (tmp_path / "a.zip").read_bytes()
    with pytest.raises(ArtefactError, match="the most for a pack"):
        write_pack(tmp_path / "a.zip", {ONE: b"1", TWO: b"0" * (2**24 + 1)})
    assert (tmp_path / "a.zip").read_bytes() == before
    assert pack_files(tmp_path) == [tmp_path / "a.zip"]
