"""Images as the model reads them. Training and serving both go through `shrink`, so equal pixels give equal inputs."""

import io
import pathlib

import numpy
from PIL import Image

HEIGHT, WIDTH = 480, 640  # pixels of Reel's camera


def decode(data: bytes) -> numpy.ndarray:
    """The image [height, width, 3] of a PNG, WebP or JPEG file.

    Fails with `ValueError` if the bytes are no image, or not one of 640 x 480 pixels.
    """
    try:
        with Image.open(io.BytesIO(data)) as image:
            pixels = numpy.asarray(image.convert("RGB"))
    except (OSError, SyntaxError) as error:
        raise ValueError(f"not an image: {error}") from error
    if pixels.shape != (HEIGHT, WIDTH, 3):
        raise ValueError(f"an image of {pixels.shape[1]} x {pixels.shape[0]} pixels; the model reads {WIDTH} x {HEIGHT} (export with --max-pixels 0)")
    return pixels


def shrink(pixels: numpy.ndarray, height: int, width: int) -> numpy.ndarray:
    """The mean of each tile of pixels, in bytes; `height` and `width` divide those of the camera."""
    rows, columns = HEIGHT // height, WIDTH // width
    if (height * rows, width * columns) != (HEIGHT, WIDTH):
        raise ValueError(f"{width} x {height} does not divide {WIDTH} x {HEIGHT}")
    return numpy.asarray(Image.fromarray(pixels).reduce((columns, rows)))


def load(path: pathlib.Path, height: int, width: int) -> numpy.ndarray:
    """The image of a file, shrunk."""
    return shrink(decode(path.read_bytes()), height, width)
