"""Images of displays, small enough to be part of the page."""

from __future__ import annotations

import base64
import importlib.util
import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from .._reel import ReelError
from .._types import Image

if TYPE_CHECKING:
    from .._episode import Episode

BYTES_MAX = 1_400_000
"""Largest size of the images in one display, bytes of base64."""
RENDERED_MAX = 16
"""Images that are rendered again for the strip of a trace without images."""


def encoded(image: Image, reduce: int = 1, quality: int = 80) -> tuple[str, bytes]:
    """An image as a file and its type: JPEG by Pillow where it is installed, else PNG with five
    bits a channel.

    Args:
        image: height x width x 3, uint8, RGB.
        reduce: factor by which both sides get smaller.
        quality: of JPEG, 1 to 95.
    """
    if importlib.util.find_spec("PIL") is not None:
        import io

        from PIL import Image as Pillow

        pillow_image = Pillow.fromarray(image)
        if reduce > 1:
            pillow_image = pillow_image.reduce(reduce)
        out = io.BytesIO()
        pillow_image.save(out, "JPEG", quality=quality)
        return "image/jpeg", out.getvalue()
    return "image/png", png(reduced(image, reduce) & np.uint8(0xF8))


def reduced(image: Image, factor: int) -> Image:
    """An image with sides smaller by a factor: means of blocks."""
    if factor == 1:
        return image
    height, width = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor, 3)
    return blocks.mean(axis=(1, 3)).round().astype(np.uint8)


def png(image: Image) -> bytes:
    """An RGB image as a PNG file."""
    height, width, _ = image.shape
    # filter 2: each line as the difference to the one above
    lines = np.empty((height, 1 + width * 3), dtype=np.uint8)
    lines[:, 0] = 2
    flat = image.reshape(height, width * 3)
    lines[0, 1:] = flat[0]
    lines[1:, 1:] = flat[1:] - flat[:-1]

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    packed = chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + packed + chunk(b"IEND", b"")


def data_uri(image: Image, reduce: int, quality: int) -> str:
    """An image as an address that holds it."""
    kind, data = encoded(image, reduce, quality)
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


SIZES = ((2, 78), (4, 72), (5, 65), (8, 60))
"""Reductions and qualities that are tried, the best first."""


def data_uris(images: Mapping[int, Image], bytes_max: int = BYTES_MAX) -> dict[int, str]:
    """Images as addresses, as good as fit; if even the smallest do not fit, evenly spread ones."""
    keys = list(images)
    if not keys:
        return {}
    probe = keys[:: max(1, len(keys) // 4)]
    for reduce, quality in SIZES:
        estimate = sum(len(data_uri(images[key], reduce, quality)) for key in probe) / len(probe)
        if estimate * len(keys) > bytes_max * 1.1:
            continue
        made = {key: data_uri(image, reduce, quality) for key, image in images.items()}
        if sum(map(len, made.values())) <= bytes_max:
            return made
    reduce, quality = SIZES[-1]
    made = {key: data_uri(image, reduce, quality) for key, image in images.items()}
    count = len(keys)
    while sum(map(len, made.values())) > bytes_max:
        count = count * 3 // 4
        wanted = {keys[round(place * (len(keys) - 1) / max(count - 1, 1))] for place in range(count)}
        made = {key: address for key, address in made.items() if key in wanted}
    return made


def frames_of(episode: Episode, calls: Iterable[int]) -> dict[int, Image]:
    """The images that calls returned (-1: before the first), as far as there are any. Of traces
    without images only some are rendered; none if the episode cannot be executed again."""
    wanted = list(calls)
    if not episode._trace.image_count:
        wanted = wanted[:: max(1, -(-len(wanted) // RENDERED_MAX))]
    found: dict[int, Image] = {}
    for call in wanted:
        try:
            image = episode.frame(None if call < 0 else call)
        except ReelError:
            # a robot's episode, or one of another simulator version: its texts are shown
            if not episode._trace.image_count:
                return found
            continue
        if image is not None:
            found[call] = image
    return found


__all__ = ["data_uri", "data_uris", "encoded", "frames_of", "reduced"]
