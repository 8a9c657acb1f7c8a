"""The files of a store of cells: loose JSON files, and packs with the cells of a study on a book.

A store is a folder. A cell, the result of one training, lies in ``runs/<hash>.json`` or
``scorers/<hash>.json``: as a file of its own, or as a member of that name in a pack, a zip archive
in the folder itself. New cells are written as loose files; :func:`write_pack` gathers them, so that
a repository holds a file for each study and not for each training. A loose cell comes before a
packed one of the same name: a training that was repeated because its packed cell is damaged
replaces that cell.

A store may come from a stranger. So nothing is extracted to the disk, a member counts under the
name of a cell only, and the sizes of archives and members are bounded before they are read.
"""

import io
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from wordcraft_kg.base.archives import ZipArchive
from wordcraft_kg.base.artefacts import check_file, read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError

_NAME = re.compile(r"(?:runs|scorers)/[0-9a-f]{16}\.json")
"""Name of a cell: the address of its task, and ``.json``."""
_LARGEST_PACK = 2**24
"""Bytes of the largest archive: some twenty thousand cells of a book with 700 entities."""
_LARGEST_CELL = 2**24
"""Bytes of the largest cell after decompression; a cell usually has about a thousand."""
_FIRST_DATE = (1980, 1, 1, 0, 0, 0)
"""The date of all members, the earliest of the format: equal cells give equal bytes."""


class CellFiles:
    """The files of a store of cells.

    The lists of members of all packs are read once, at the start.
    """

    def __init__(self, folder: Path):
        """Read which cells the packs in a folder hold.

        Args:
            folder: the store, which may be new.

        Raises:
            ConfigError: if ``folder`` is a file.
            ArtefactError: if a pack is damaged, has members that are not cells or are too large, or
                if a cell lies in two packs, so that it is not clear which one counts.
        """
        if folder.is_file():
            raise ConfigError(
                f"`store` '{folder}' is a file; expected a folder of cells, which may be new."
            )
        self.folder = folder
        self._packs: dict[str, ZipArchive] = {}
        for path in pack_files(folder):
            archive = _open_pack(path)
            for name in archive.members:
                if name in self._packs:
                    raise ArtefactError(
                        f"{path} has the cell '{name}', and so has {self._packs[name].path}; "
                        "expected the cell in one of the packs. Remove one of the two."
                    )
                self._packs[name] = archive

    def loose(self, address: str) -> Path:
        """Return the path of the loose file for the cell of an address, if it exists or not."""
        return self.folder / f"{address}.json"

    def where(self, address: str) -> str | None:
        """Return in words where the cell of an address lies; None if the store lacks the cell.

        Error messages begin with these words. So a member ends with a comma, as in "pack.zip,
        member runs/2f65aebd52224b51.json, is damaged".
        """
        if self.loose(address).exists():
            return str(self.loose(address))
        if f"{address}.json" in self._packs:
            return f"{self._packs[f'{address}.json'].path}, member '{address}.json',"
        return None

    def read(self, address: str) -> bytes:
        """Return the bytes of a cell; a loose file comes before a pack.

        The loose file is the newer one: it may repeat a training whose packed cell is damaged.

        Args:
            address: address of the cell's task, such as ``runs/2f65aebd52224b51``.

        Raises:
            ArtefactError: if the store lacks the cell, or its file or its member of a pack cannot
                be read.
        """
        name = f"{address}.json"
        loose = self.loose(address)
        if loose.exists() or name not in self._packs:
            return read_small_file(loose)
        return self._packs[name].read(name, _LARGEST_CELL)

    def addresses(self) -> dict[str, Path]:
        """Return the sorted addresses of all cells, each with its file.

        If there are two files, it is the loose one.
        """
        found = {name.removesuffix(".json"): pack.path for name, pack in self._packs.items()}
        for path in self.folder.glob("*/*.json"):
            name = path.relative_to(self.folder).as_posix()
            if _NAME.fullmatch(name):
                found[name.removesuffix(".json")] = path
        return dict(sorted(found.items()))


def pack_files(folder: Path) -> list[Path]:
    """Return the packs in a store of cells, sorted by name."""
    return sorted(folder.glob("*.zip"))


def _open_pack(path: Path) -> ZipArchive:
    """Open an archive and check its list of members; the members are neither read nor extracted."""
    check_file(path, _LARGEST_PACK)
    # From memory: another process may replace the pack meanwhile.
    archive = ZipArchive(path, path.read_bytes())
    for name in archive.members:
        if not _NAME.fullmatch(name):
            raise ArtefactError(
                f"{path} is no pack of cells: its member {name[:80]!r} is no cell; expected a name "
                "such as 'runs/2f65aebd52224b51.json'. Remove the file."
            )
        archive.check(name, _LARGEST_CELL)
    return archive


def write_pack(path: Path, cells: Mapping[str, bytes]) -> bool:
    """Write a pack, unless it has exactly these cells already.

    Members are sorted and have a fixed date, so that equal cells give equal bytes.

    Args:
        path: the archive, in an existing folder.
        cells: bytes of each cell, by the address of its task.

    Returns:
        Whether the file was written.

    Raises:
        ArtefactError: if the pack would be too large to be read again; nothing is written.
    """
    members = {f"{address}.json": cells[address] for address in sorted(cells)}
    if path.exists():
        before = _open_pack(path)
        # Compared by content: another version of zlib may compress the same cells to other bytes.
        if list(before.members) == list(members):
            with suppress(ArtefactError):  # a damaged pack is replaced
                if all(
                    before.read(name, _LARGEST_CELL) == content for name, content in members.items()
                ):
                    return False
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, content in members.items():
            info = zipfile.ZipInfo(name, _FIRST_DATE)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.create_system = 3  # Unix, on each system
            info.external_attr = 0o644 << 16
            if len(content) > _LARGEST_CELL:
                raise ArtefactError(
                    f"the cell '{name}' has {len(content):,} bytes; the most for a pack are "
                    f"{_LARGEST_CELL:,}."
                )
            archive.writestr(info, content)
    packed = buffer.getvalue()
    if len(packed) > _LARGEST_PACK:
        raise ArtefactError(
            f"{path} would have {len(packed):,} bytes; the most are {_LARGEST_PACK:,}."
        )
    write_atomically(path, packed)
    return True
