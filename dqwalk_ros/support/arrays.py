"""The types of arrays in signatures; docstrings give shape and unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers."""
Mask = NDArray[np.bool_]
"""Which of several things, such as joints."""
