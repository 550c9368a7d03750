"""Decode text files as people keep them: also those that were edited on Windows."""

import codecs

from estimator.contracts.errors import BadInput

_LOOKED_AT = 4096  # Characters of a text that are read: no line that is shown is as long


def utf8_of(data: bytes) -> bytes:
    """Return bytes without a byte order mark, in UTF-8 if theirs is of UTF-16; others stay as they are."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace").encode("utf-8", "replace")
    return data.removeprefix(codecs.BOM_UTF8)


def text_of(data: bytes, where: str) -> str:
    """Return a file's text: of UTF-8, or of UTF-16 with its byte order mark; its lines end in line feeds.

    Args:
        where: the file, for errors.

    Raises:
        BadInput: it is neither.
    """
    try:
        text = utf8_of(data).decode("utf-8")
    except UnicodeDecodeError as why:
        raise BadInput(f"{where}: not UTF-8 text (byte {why.start})") from why
    if "\0" in text[:_LOOKED_AT]:
        raise BadInput(f"{where}: not UTF-8 text (a zero byte): save it as UTF-8 if it is UTF-16 without a byte order mark")
    return text.replace("\r\n", "\n")
