"""Images of the robot's camera as pixels."""

import io
import pathlib

import numpy
from PIL import Image

HEIGHT, WIDTH = 480, 640  # pixels of Reel's camera


def decode(data: bytes) -> numpy.ndarray:
    """The image [height, width, 3] in bytes of a PNG, WebP or JPEG file.

    Fails with `ValueError` if the bytes are no image, or not one of 640 x 480 pixels.
    """
    try:
        with Image.open(io.BytesIO(data)) as image:
            pixels = numpy.array(image.convert("RGB"))
    except (OSError, SyntaxError) as error:
        raise ValueError(f"not an image: {error}") from error
    if pixels.shape != (HEIGHT, WIDTH, 3):
        raise ValueError(f"an image of {pixels.shape[1]} x {pixels.shape[0]} pixels; the model reads {WIDTH} x {HEIGHT} (export with --max-pixels 0)")
    return pixels


def load(path: pathlib.Path) -> numpy.ndarray:
    """The image of a file."""
    return decode(path.read_bytes())
