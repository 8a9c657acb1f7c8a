import gzip
import io
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from wordcraft_kg.base.artefacts import ZipArchive, gunzip, read_lines
from wordcraft_kg.base.errors import ConfigError

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
    "encrypted": (changed(8, 1, "<H"), "'a.json', is encrypted"),
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
def test_lines_come_with_their_numbers_without_a_byte_order_mark(tmp_path, pack):
    path = tmp_path / "lines"
    path.write_bytes(pack(b"\xef\xbb\xbffirst\n\nlast"))
    assert list(read_lines(path)) == [(1, b"first\n"), (2, b"\n"), (3, b"last")]


def test_empty_lines_are_bounded_before_they_take_long(tmp_path):
    (tmp_path / "lines").write_bytes(gzip.compress(b"\n" * 2**18))
    with pytest.raises(ConfigError, match="line 65,537: more than 200 bytes"):
        list(read_lines(tmp_path / "lines", ConfigError))


def test_a_line_that_would_fill_the_memory_is_refused(tmp_path):
    (tmp_path / "lines").write_bytes(b"short\n" + b"0" * 2**21)
    with pytest.raises(ConfigError, match="line 2: 1,048,576 bytes or more"):
        list(read_lines(tmp_path / "lines", ConfigError))
