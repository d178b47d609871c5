"""The type of arrays in signatures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array"]

Array = NDArray[np.float64]
"""Real numbers; docstrings give shape and unit."""
