"""TFRecord: records laid end to end, each with its length and two checksums.

::

    8 bytes  payload length n, little-endian      4 bytes  masked CRC-32C of the length
    n bytes  payload                              4 bytes  masked CRC-32C of the payload

The file is plain, or gzip around the whole stream, by its first two bytes. Offsets are positions in
the unpacked stream.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import google_crc32c

from deepmf_sumo import files
from deepmf_sumo.errors import ReaderError

HEADER: Final = 12
FOOTER: Final = 4
LARGEST_RECORD: Final = 32 * 2**20
"""Bytes. The largest known scene has 4 MB; a larger length is damage, not data."""
LARGEST_FILE: Final = 2**40
"""Bytes, unpacked. A file is never in memory as a whole; this only sets an end."""

_PIECE: Final = 2**20


@dataclass(frozen=True, slots=True, kw_only=True)
class TfRecord:
    """One whole record, and where it starts."""

    index: int
    offset: int
    payload: bytes

    @property
    def end(self) -> int:
        """Where the next one starts."""
        return self.offset + HEADER + len(self.payload) + FOOTER


@dataclass(frozen=True, slots=True, kw_only=True)
class Broken:
    """A record that cannot be read; ``end`` is None if the rest of the file is lost, too."""

    index: int
    offset: int
    reason: str
    end: int | None = None


def framed(payload: bytes) -> bytes:
    """The payload as one record."""
    length = struct.pack("<Q", len(payload))
    return length + _masked_crc(length) + payload + _masked_crc(payload)


def looks_framed(path: Path) -> bool:
    """Whether the file starts with a length and its checksum."""
    try:
        with _stream(path) as stream:
            header = stream.read(HEADER)
    except OSError:
        return False
    return len(header) == HEADER and _masked_crc(header[:8]) == header[8:]


def records(path: Path) -> Iterator[TfRecord | Broken]:
    """All records in order; damaged ones as `Broken`.

    After a payload with a wrong checksum the next record is read, since its position is known. A
    wrong length, or a file that ends too early, ends the iteration.
    """
    offset, index = 0, 0
    try:
        with _stream(path) as stream:
            while True:
                found = _next(stream, index, offset)
                if found is None:
                    return
                yield found
                if found.end is None:
                    return
                offset, index = found.end, index + 1
    except OSError as error:
        reason = f"cannot be read further ({files.reason(error)}); copy or download the file again"
        yield Broken(index=index, offset=offset, reason=reason)


def record_at(path: Path, offset: int, index: int) -> TfRecord:
    """The record that starts at an offset of the decompressed stream.

    Raises ReaderError if there is no whole record. A gzip file is decompressed up to it.
    """
    try:
        with _stream(path) as stream:
            _skip(stream, offset)
            found = _next(stream, index, offset)
    except OSError as error:
        raise ReaderError(
            f"{path} record {index}: cannot be read ({files.reason(error)})."
        ) from None
    if isinstance(found, TfRecord):
        return found
    reason = found.reason if found else f"{_ENDS if offset else _EMPTY}; copy or download it again"
    raise ReaderError(f"{path} record {index}: {reason}.")


_ENDS: Final = "the file ends before it"
_EMPTY: Final = "the file contains no scene"


def _next(stream: BinaryIO, index: int, offset: int) -> TfRecord | Broken | None:
    """The record at the stream's position; None at the end of the file."""
    header = stream.read(HEADER)
    if not header:
        return None
    if len(header) < HEADER:
        return _truncated(index, offset, len(header), HEADER)
    (length,) = struct.unpack("<Q", header[:8])
    damage = _damage(header, length)
    if damage:
        return Broken(index=index, offset=offset, reason=damage)
    body = stream.read(length + FOOTER)
    if len(body) < length + FOOTER:
        return _truncated(index, offset, HEADER + len(body), HEADER + length + FOOTER)
    payload = body[:length]
    if _masked_crc(payload) != body[length:]:
        reason = "the checksum of its content is wrong; copy or download the file again"
        end = offset + HEADER + len(body)
        return Broken(index=index, offset=offset, reason=reason, end=end)
    return TfRecord(index=index, offset=offset, payload=payload)


def _damage(header: bytes, length: int) -> str:
    """What is wrong with a record's header; empty if nothing is."""
    if _masked_crc(header[:8]) != header[8:]:
        return (
            "the checksum of its length is wrong, so that neither it nor what follows can be "
            "found; copy or download the file again"
        )
    if length > LARGEST_RECORD:
        return f"claims {length} bytes, more than the {LARGEST_RECORD} that a scene may have"
    return ""


def _truncated(index: int, offset: int, there: int, needed: int) -> Broken:
    reason = f"is cut off: {there} of its {needed} bytes are there; copy or download the file again"
    return Broken(index=index, offset=offset, reason=reason)


def _masked_crc(content: bytes) -> bytes:
    """CRC-32C rotated by 15 bits plus a constant, so that a record can contain checksums itself."""
    crc = google_crc32c.value(content)
    return struct.pack("<I", (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF)


def _stream(path: Path) -> BinaryIO:
    with files.opened(path) as file:
        packed = file.read(len(files.GZIP)) == files.GZIP
    return files.unpacked(path, LARGEST_FILE) if packed else files.opened(path)


def _skip(stream: BinaryIO, count: int) -> None:
    """Skip a number of bytes, or to the end; a packed stream is unpacked for that."""
    if stream.seekable():
        stream.seek(count)
        return
    while count and (piece := stream.read(min(count, _PIECE))):
        count -= len(piece)
