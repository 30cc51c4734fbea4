"""Types of arrays, the same words everywhere: shapes stand in the docstrings, dtypes here.

Public: other packages annotate with them too (``from planner.arrays import Array``).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Flags", "Indices"]

# Real numbers of any shape, in the unit that the name they annotate carries.
Array: TypeAlias = NDArray[np.float64]
# Whole numbers: indices of stations, pieces, pairs; counts.
Indices: TypeAlias = NDArray[np.int64]
# Yes or no, one an entry.
Flags: TypeAlias = NDArray[np.bool_]
