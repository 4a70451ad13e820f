# SPDX-License-Identifier: Apache-2.0
"""What a storage file of a recording holds, and the parts of it that cannot be read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import lz4.frame
import zstandard

from gsdf_registration.common.result import InputError

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
LZ4_MAGIC = b'\x04\x22\x4d\x18'
PIECE = 4096    # bytes that a decompressor is given at a time, so that little is lost at damage


class StoredMessage(NamedTuple):
    """A serialized message (CDR) and the time at which it was recorded, ns."""

    time: int
    topic: str
    msgtype: str
    data: bytes


@dataclass
class Contents:
    """
    The messages of one storage file.

    messages : in the order of the file
    counts : dict of (topic, type) to int, number of messages of every topic
    definitions : dict of str to str, text of the definition of a type, where the file has it
    defects : sentences on what cannot be read, with its place
    complete : whether nothing is missing
    """

    messages: list[StoredMessage] = field(default_factory=list)
    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    definitions: dict[str, str] = field(default_factory=dict)
    defects: list[str] = field(default_factory=list)
    complete: bool = True

    def miss(self, defect: str) -> None:
        """Add a sentence on a part that is missing."""
        self.defects.append(defect)
        self.complete = False


def decompressed(data: bytes) -> bytes:
    """Return a message as it was before rosbag2 compressed it; CDR never starts like that."""
    if not data.startswith((ZSTD_MAGIC, LZ4_MAGIC)):
        return data
    try:
        return b''.join(decompressed_pieces(iter([data]), _decompressor(data)))
    except (zstandard.ZstdError, RuntimeError) as error:
        raise InputError(f'a message cannot be decompressed: {error}') from None


def decompressed_pieces(pieces: Iterator[bytes],
                        decompress: Callable[[bytes], bytes]) -> Iterator[bytes]:
    """Yield what a truncated stream yields; errors of the library where it is damaged."""
    for piece in pieces:
        for begin in range(0, len(piece), PIECE):
            yield decompress(piece[begin:begin + PIECE])


def _decompressor(start: bytes) -> Callable[[bytes], bytes]:
    return zstd() if start.startswith(ZSTD_MAGIC) else lz4_frame()


def zstd() -> Callable[[bytes], bytes]:
    """Return a function that decompresses a stream piece by piece."""
    stream = zstandard.ZstdDecompressor().decompressobj()
    return lambda piece: b'' if stream.eof else stream.decompress(piece)


def lz4_frame() -> Callable[[bytes], bytes]:
    """Return a function that decompresses a stream piece by piece."""
    stream = lz4.frame.LZ4FrameDecompressor()
    return lambda piece: b'' if stream.eof else bytes(stream.decompress(piece))
