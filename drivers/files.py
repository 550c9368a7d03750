"""The one door for files that others made: plain files alone, none larger than its kind has a use for, opened without a wait.

A device may have no end and a pipe no beginning; a file of some kilobytes may unpack to gigabytes, or keep a library at work for
days. What is bounded by no size alone is read in a process of its own (`drivers/confined.py`).

What is packed, wrapped or empty is named here, before a reader of what should be in it sees it.
"""

import os
import re
import stat
import sys
from enum import Enum
from io import BufferedReader
from pathlib import Path

from estimator.contracts.errors import BadInput, file_errors, refused

_HEAD = 512  # bytes at the begin of a file that show what it is


class Largest(Enum):
    """The largest size of a file by what it is for, bytes, and why."""

    SETTINGS = 1_000_000, "text of people, such as settings, pads and cameras: a hundred times the longest"
    BOARD = 200_000, "a board of tags: a thousand of them; YAML is read slowly"
    DRAWING = 2_000_000, "SVG: a drawing of plain paint has some kilobytes"
    CERTIFICATE = 1_000_000, "PEM: the certificates of all authorities there are have 300 kB"
    NETWORK = 2_000_000, "weights of a network that flies or looks"
    PICTURE = 256 << 20, "an encoded image: the largest one that is decoded, without any compression"
    TABLE = 64 << 20, "a table of times or attitudes, parameters, a snapshot: a million lines"
    LOG = 4 << 30, "a flight's log, which is read into memory as a whole: no card of FAT has a larger file"
    RECORDING = 1 << 63, "recordings, videos and bags are read piece by piece, whatever their size"

    @property
    def most_bytes(self) -> int:
        """The largest size, bytes."""
        return self.value[0]


_UNPACK = "unpack it first, and give what is in it"
_WRAPPED = (
    (rb"\x1f\x8b", f"it is packed (gzip): {_UNPACK}"),
    (rb"BZh[1-9]1AY", f"it is packed (bzip2): {_UNPACK}"),
    (rb"\xfd7zXZ\0", f"it is packed (xz): {_UNPACK}"),
    (rb"\x28\xb5\x2f\xfd", f"it is packed (zstd): {_UNPACK}"),
    (rb"PK(\x03\x04|\x05\x06)", f"it is a zip archive, or an office program's document: {_UNPACK}, or save it as plain text"),
    (rb"7z\xbc\xaf\x27\x1c", f"it is a 7z archive: {_UNPACK}"),
    (rb"Rar!\x1a\x07", f"it is a RAR archive: {_UNPACK}"),
    (rb".{257}ustar", f"it is a tar archive: {_UNPACK}"),
    (rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "it is an office program's document: save it as plain text (CSV)"),
    (rb".{4}ftyp(hei[cxms]|hev[cxms]|mif1|msf1|avi[fs])", "it is a HEIC or AVIF photograph: save it as JPEG or PNG"),
    (rb"\xff\x0a|\0\0\0\x0cJXL ", "it is a JPEG XL picture: save it as JPEG or PNG"),
    (rb"\0\x05\x16[\0\x07]\0[\x01\x02]\0\0", "it is what a Mac keeps beside a file (._NAME): give the file itself"),
    (rb"%PDF-|%!PS-Adobe|\xc5\xd0\xd3\xc6", "it is a PDF or PostScript document: save it as SVG or PNG"),
    (rb"8BPS\0", "it is a document of Photoshop: save it as PNG"),
    (rb"(?i:(\xef\xbb\xbf)?\s*<(!doctype\s+html|html)\b)", "it is a web page: download the file itself"),
    (rb"version https://git-lfs\.", "it is a pointer of Git LFS: fetch the file itself, with `git lfs pull`"),
)
"""Patterns of the first bytes of packed and wrapped files, each with what such a file is and what to do."""
_MAGICS = tuple((re.compile(magic, re.DOTALL), words) for magic, words in _WRAPPED)
_MAY_BE_EMPTY = (Largest.SETTINGS, Largest.CERTIFICATE, Largest.NETWORK)
"""Kinds whose readers say themselves what is missing, or whose own format is an archive."""


def _refuse_wrapped(head: bytes, largest: Largest, where: str) -> None:
    """Refuse what is packed, wrapped or empty, by its first bytes. Raises BadInput."""
    if largest is Largest.NETWORK:
        return
    if not head and largest not in _MAY_BE_EMPTY:
        raise BadInput(f"{where}: it is empty")
    for magic, words in _MAGICS:
        if magic.match(head):
            raise BadInput(f"{where}: {words}")


def seen_in(folder: Path) -> list[Path]:
    """Return the files of a folder in order of their names, but for those that a system keeps beside them (._NAME, .DS_Store).

    Raises:
        OSError: the folder cannot be read.
    """
    return sorted(path for path in folder.iterdir() if not path.name.startswith(".") and path.is_file())


def refuse_special(path: Path, largest: Largest, where: str = "") -> None:
    """Refuse what is no plain file of its kind's size, before a library opens it.

    Args:
        where: the setting that names it, for errors; empty for the path.

    Raises:
        BadInput: it does not exist, is a folder, a device or a pipe, is larger, packed, wrapped or empty.
    """
    opened(path, largest, where).close()


def opened(path: Path, largest: Largest, where: str = "") -> BufferedReader:
    """Return a file, open to be read; see `refuse_special` for the arguments. The caller closes it.

    Raises:
        BadInput: as for `refuse_special`, or it may not be read.
        Recoverable: the disk fails.
    """
    where = where or str(path)
    with file_errors(where), refused(where, ValueError):
        # Without a wait: what was a file a moment ago may be a pipe without a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _check(os.fstat(descriptor), largest, where)
        with file_errors(where):
            _refuse_wrapped(os.pread(descriptor, _HEAD, 0), largest, where)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def bytes_of(path: Path, largest: Largest, where: str = "") -> bytes:
    """Return what is in a file; the arguments and errors are those of `opened`."""
    where = where or str(path)
    with opened(path, largest, where) as file, file_errors(where):
        # Files of the kernel say that they are empty, and are not; others may grow.
        content = file.read(largest.most_bytes + 1) if largest.most_bytes < sys.maxsize else file.read()
    if len(content) > largest.most_bytes:
        raise _too_large(len(content), largest, where)
    return content


def _check(found: os.stat_result, largest: Largest, where: str) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise BadInput(f"{where}: Is a directory")
    if not stat.S_ISREG(found.st_mode):
        raise BadInput(f"{where}: not a file, but a device or a pipe")
    if found.st_size > largest.most_bytes:
        raise _too_large(found.st_size, largest, where)


def _too_large(size: int, largest: Largest, where: str) -> BadInput:
    return BadInput(f"{where}: {size} bytes; such a file has at most {largest.most_bytes}")
