"""Files: what has no end is not read, what is not finite is not a weight, and no device is
replaced."""

import gzip
import io
import os
import socket
import stat
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

from wordcraft_kg.base.artefacts import (
    LARGE_FILE,
    SMALL_FILE,
    ZipArchive,
    gunzip,
    made_folder,
    read_large_file,
    read_lines,
    read_small_file,
    staged_file,
    staged_folder,
    write_atomically,
)
from wordcraft_kg.base.errors import (
    ArtefactError,
    ConfigError,
    OutputExistsError,
    RecipeFileError,
)
from wordcraft_kg.base.tensors import read_tensors
from wordcraft_kg.graphs.book_files import read_book
from wordcraft_kg.graphs.book_files.files import MAX_BOOK_SIZE
from wordcraft_kg.models.scorers.features import make_features


def pipe(path):
    os.mkfifo(path)


def device(path):
    path.symlink_to("/dev/zero")


@pytest.fixture(params=[pipe, device, Path.mkdir])
def endless(request, tmp_path):
    """A path that must not be opened."""
    path = tmp_path / "book.csv"
    request.param(path)
    return path


@pytest.mark.parametrize("read", [read_small_file, read_large_file])
def test_only_regular_files_are_read(endless, read):
    with pytest.raises(ArtefactError, match=r"book\.csv is damaged: not a regular file"):
        read(endless)


@pytest.mark.parametrize(
    ("read", "largest"), [(read_small_file, SMALL_FILE), (read_large_file, LARGE_FILE)]
)
def test_a_file_that_is_too_large_is_not_read(tmp_path, read, largest):
    path = tmp_path / "hole"
    path.touch()
    os.truncate(path, largest + 1)
    with pytest.raises(
        ArtefactError, match=rf"hole is damaged: {largest + 1:,} bytes; the limit is {largest:,}"
    ):
        read(path)


def test_what_a_user_names_is_not_read_either_if_it_has_no_end(endless):
    with pytest.raises(RecipeFileError, match=r"not a regular file|is an empty folder"):
        read_book(endless)
    with pytest.raises((ConfigError, ArtefactError), match="expected a file"):
        make_features(str(endless), ["water"])


def test_a_book_larger_than_any_is_refused(tmp_path):
    path = tmp_path / "book.csv"
    path.touch()
    os.truncate(path, MAX_BOOK_SIZE + 1)
    with pytest.raises(RecipeFileError, match="the limit is 1,073,741,824"):
        read_book(path)


@pytest.mark.parametrize("dtype", [torch.float8_e4m3fn, torch.bfloat16, torch.int16])
def test_weights_of_types_that_are_not_written_are_refused_by_name(dtype):
    tensors = {"sound": torch.zeros(3), "entity_real": torch.zeros(3).to(dtype)}
    with pytest.raises(ArtefactError, match=f"'entity_real' has type {dtype}; expected one of"):
        read_tensors(Path("model.safetensors"), safetensors.torch.save(tensors))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 3e38, -1.1e6])
def test_weights_that_are_not_finite_are_refused_by_name(value):
    tensors = {"sound": torch.zeros(3), "entity_real": torch.tensor([[0.0, value]])}
    with pytest.raises(ArtefactError, match="the tensor 'entity_real' holds NaN, infinity"):
        read_tensors(Path("model.safetensors"), safetensors.torch.save(tensors))
    del tensors["entity_real"]
    assert list(read_tensors(Path("model.safetensors"), safetensors.torch.save(tensors))) == [
        "sound"
    ]


def shape(path):
    """A path's kind, and its content or its target: what a refused write must leave as it was."""
    mode = path.lstat().st_mode
    return stat.S_IFMT(mode), os.readlink(path) if path.is_symlink() else path.lstat().st_rdev


def char_device(path):
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except OSError:
        pytest.skip("needs the right to make devices")


def socket_file(path):
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def link_to_a_pipe(path):
    os.mkfifo(path.with_name("pipe"))
    path.symlink_to("pipe")


def dangling(path):
    path.symlink_to("missing")


def looping(path):
    path.symlink_to(path.name)


def to_a_folder(out, text="new", *, force=True, meanwhile=lambda: None):
    with staged_folder(out, force=force) as folder:
        (folder / "graph.json").write_text(text)
        meanwhile()


def to_a_file(out, text="new", *, force=True, meanwhile=lambda: None):
    with staged_file(out, force=force) as file:
        file.write_text(text)
        meanwhile()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (pipe, "device, a pipe or a socket"),
        (char_device, "device, a pipe or a socket"),
        (socket_file, "device, a pipe or a socket"),
        (link_to_a_pipe, "device, a pipe or a socket"),
        (dangling, r"'.*out' is a link to '.*missing', which does not exist"),
        (looping, "loop of links"),
    ],
)
@pytest.mark.parametrize("write", [to_a_folder, to_a_file])
def test_an_output_never_replaces_a_device_pipe_or_dead_link(
    tmp_path, monkeypatch, make, says, write
):
    """An output never replaces a device a pipe or a link that leads nowhere."""
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    make(Path("out"))
    before = {path.name: shape(path) for path in Path().iterdir()}
    with pytest.raises(OutputExistsError, match=says):
        write(Path("out").absolute())
    assert {path.name: shape(path) for path in Path().iterdir()} == before


@pytest.mark.parametrize("make", [pipe, char_device])
def test_an_atomic_write_never_replaces_a_device_or_a_pipe(tmp_path, make):
    make(tmp_path / "out")
    before = shape(tmp_path / "out")
    with pytest.raises(OutputExistsError, match="device, a pipe or a socket"):
        write_atomically(tmp_path / "out", "new")
    assert shape(tmp_path / "out") == before
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]


@pytest.mark.parametrize("write", [to_a_folder, to_a_file])
def test_an_output_through_links_replaces_the_end_and_keeps_the_links(tmp_path, write):
    far = tmp_path / "disk" / "far"
    write(far)
    (tmp_path / "near").symlink_to("disk/far")
    (tmp_path / "out").symlink_to(tmp_path / "near")
    end = far / "graph.json" if far.is_dir() else far
    end.write_text("old")
    write(tmp_path / "out")
    assert end.read_text() == "new"
    assert (os.readlink(tmp_path / "near"), (tmp_path / "out").is_symlink()) == ("disk/far", True)
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["far"]


def refuse_link(source, target):
    """Link as on a file system without hard links."""
    raise PermissionError


@pytest.mark.parametrize("link", [os.link, refuse_link])
@pytest.mark.parametrize("write", [to_a_folder, to_a_file])
def test_of_two_outputs_at_once_the_second_is_refused_unless_it_is_forced(
    tmp_path, monkeypatch, write, link
):
    """Both have checked that nothing is there before either is complete."""
    monkeypatch.setattr(os, "link", link)
    out = tmp_path / "out"
    with pytest.raises(OutputExistsError, match=r"another process has written '.*out'"):
        write(out, "second", force=False, meanwhile=lambda: write(out, "first", force=False))
    end = out / "graph.json" if out.is_dir() else out
    assert end.read_text() == "first"
    write(out, "second", meanwhile=lambda: write(out, "third"))
    assert end.read_text() == "second"
    assert list(tmp_path.iterdir()) == [out]


def test_a_file_that_appears_at_the_last_moment_is_not_replaced(tmp_path, monkeypatch):
    link = os.link

    def link_late(source, target):
        Path(target).write_text("first")
        link(source, target)

    monkeypatch.setattr(os, "link", link_late)
    with pytest.raises(OutputExistsError, match="another process"):
        to_a_file(tmp_path / "out", force=False)
    assert (tmp_path / "out").read_text() == "first"


def test_a_file_never_takes_the_place_of_a_folder_that_was_written_meanwhile(tmp_path):
    with pytest.raises(IsADirectoryError):
        to_a_file(tmp_path / "out", meanwhile=lambda: to_a_folder(tmp_path / "out"))
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "graph.json"]


def test_the_working_folder_may_be_replaced(tmp_path, monkeypatch):
    to_a_folder(tmp_path, "old")
    monkeypatch.chdir(tmp_path)
    to_a_folder(Path())
    assert (tmp_path / "graph.json").read_text() == "new"


def test_a_folder_that_cannot_be_written_leaves_the_earlier_one(tmp_path, monkeypatch):
    def replace(staged, target):
        raise PermissionError("busy")

    to_a_folder(tmp_path / "out", "old")
    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(PermissionError):
        to_a_folder(tmp_path / "out")
    assert (tmp_path / "out/graph.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_folders_of_a_failed_output_disappear_and_those_with_content_stay(tmp_path):
    def fail(*written):
        with made_folder(tmp_path / "a" / "b" / "c"):
            for name in written:
                (tmp_path / name).write_text("")
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        fail()
    assert not list(tmp_path.iterdir())
    with pytest.raises(OSError, match="full"):
        fail("a/b/run.json")
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "b", "run.json"]


def test_a_link_inside_a_folder_is_replaced_not_followed(tmp_path):
    """A run folder of somebody else may hold a link to any file of the user's."""
    (tmp_path / "private").write_text("private")
    (tmp_path / "metrics.json").symlink_to("private")
    write_atomically(tmp_path / "metrics.json", "new")
    assert (tmp_path / "private").read_text() == "private"
    assert (tmp_path / "metrics.json").read_text() == "new"


PATH = Path("from-elsewhere.zip")

CONTENT = b"one line\n" * 100


def zipped(*members, method=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a name that is written twice
        for name, content in members:
            archive.writestr(name, content)
    return buffer.getvalue()


def changed(at, value, form="<I", data=None):
    """Change a field of the first entry in the archive's list, see section 4.3.12 of the format."""
    data = bytearray(data or zipped(("a.json", CONTENT)))
    struct.pack_into(form, data, data.index(b"PK\1\2") + at, value)
    return bytes(data)


REFUSED = {
    "empty": (b"", "is damaged: BadZipFile"),
    "cut": (zipped(("a.json", CONTENT))[:-30], "is damaged: BadZipFile"),
    "a member is missing": (zipped(("b.json", CONTENT)), "'a.json', is missing"),
    "LZMA": (zipped(("a.json", CONTENT), method=zipfile.ZIP_LZMA), "compression method 14"),
    "encrypted": (changed(8, 1, "<H"), "is encrypted, password required"),
    "patched": (changed(8, 0x20, "<H"), "is damaged: NotImplementedError"),
    "version": (changed(6, 99, "<H"), "is damaged: NotImplementedError"),
    "a place behind the end": (changed(42, 2**31), "is damaged"),
    "smaller than claimed": (changed(24, 950), r"is damaged: EOFError: 900 of 950"),
    "larger than claimed": (changed(24, 10), "is damaged: BadZipFile: Bad CRC-32"),
    "too large": (changed(24, 1001), "has 1,001 bytes; the limit is 1,000"),
    "no data": (changed(20, 0), "is damaged"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_damaged_archive_is_an_error_of_the_readers_class(case):
    data, message = REFUSED[case]
    with pytest.raises(ConfigError, match=message):
        ZipArchive(PATH, data, ConfigError).read("a.json", 1000)


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (zipped(("a.json", "1"), ("a.json", "2")), r"a\.json"),
        (changed(46, 0, "<B"), ""),  # a name ends at its first zero
    ],
    ids=["twice", "empty"],
)
def test_a_name_that_is_empty_or_occurs_twice_is_refused(data, name):
    with pytest.raises(ConfigError, match=rf"'{name}', has no name of its own"):
        ZipArchive(PATH, data, ConfigError)


def test_no_more_than_the_claim_is_asked_from_the_decompressor(monkeypatch):
    sizes = []
    read = zipfile.ZipExtFile._read1

    def counting(file, number):
        sizes.append(number)
        return read(file, number)

    monkeypatch.setattr(zipfile.ZipExtFile, "_read1", counting)
    archive = ZipArchive(PATH, changed(24, 100, data=zipped(("a.json", b"0" * 2**23))))
    with pytest.raises(ValueError, match="is damaged: BadZipFile"):
        archive.read("a.json", 1000)
    assert sizes == [100]


def test_archives_with_any_byte_changed_are_read_or_refused():
    rng = np.random.default_rng(0)
    packed = {
        "zip": zipped(("a.json", CONTENT), ("b.json", b"x")),
        "gzip": gzip.compress(CONTENT, mtime=0),
    }
    refused = 0
    for _ in range(1000):
        for kind, data in packed.items():
            damaged = bytearray(data)
            for at in rng.integers(len(data), size=rng.integers(1, 4)):
                damaged[at] = rng.integers(256)
            try:
                if kind == "gzip":
                    gunzip(PATH, bytes(damaged), 10**6, ConfigError)
                else:
                    ZipArchive(PATH, bytes(damaged), ConfigError).read("a.json", 10**6)
            except ConfigError:
                refused += 1
    assert refused > 500


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (gzip.compress(CONTENT, mtime=0)[:-1], "is damaged: EOFError"),
        (gzip.compress(CONTENT, mtime=0) + b"more", "is damaged: BadGzipFile"),
        (gzip.compress(CONTENT, mtime=0), "more than 899 bytes"),
        (gzip.compress(bytes(2**21), mtime=0), "at most 200 from a compressed byte"),
    ],
)
def test_damaged_or_large_gzip_data_is_refused(data, message):
    with pytest.raises(ConfigError, match=message):
        gunzip(PATH, data, 899 if message.startswith("more") else 2**30, ConfigError)


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_lines_come_with_their_numbers_without_a_byte_order_mark(put, pack):
    path = put(pack(b"\xef\xbb\xbffirst\n\nlast"), "lines")
    assert list(read_lines(path)) == [(1, b"first\n"), (2, b"\n"), (3, b"last")]


def test_empty_lines_are_bounded_before_they_take_long(tmp_path):
    (tmp_path / "lines").write_bytes(gzip.compress(b"\n" * 2**18))
    with pytest.raises(ConfigError, match="line 65,537: more than 200 bytes"):
        list(read_lines(tmp_path / "lines", ConfigError))


def test_a_line_that_would_fill_the_memory_is_refused(tmp_path):
    (tmp_path / "lines").write_bytes(b"short\n" + b"0" * 2**21)
    with pytest.raises(ConfigError, match="line 2: 1,048,576 bytes or more"):
        list(read_lines(tmp_path / "lines", ConfigError))
