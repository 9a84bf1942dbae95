"""Small tables as a run has them."""

from typing import Any

import numpy as np
import pyarrow as pa

from craternav_fg.runs.columns import list_column


def residuals(estimators: list[str], **columns: Any) -> pa.Table:
    """Residuals of one rim for each estimator, with further columns."""
    n = len(estimators)
    return pa.table(
        {
            "estimator": estimators,
            "stamp_ns": pa.array([0] * n, pa.int64()),
            "crater_id": ["A"] * n,
            "chart": list_column(np.zeros((n, 5))),
            "whitened": list_column(np.zeros((n, 5))),
            "chi2": [1.0] * n,
            "weight": pa.nulls(n, pa.float64()),
            "reassociated_with": pa.nulls(n, pa.string()),
            **columns,
        }
    )
