"""Types that several modules name."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

PathLike = str | os.PathLike[str]
Record = dict[str, Any]
"""A record of a trace, as a dictionary."""
Image = NDArray[np.uint8]
"""Height x width x 3, RGB."""
Layer = NDArray[np.uint16]
"""Height x width: depth in millimetres, or instance ids."""
