"""Columns of the Parquet files of a run."""

from dataclasses import fields

import pyarrow as pa

from craternav_fg.measurements import RimQuality
from craternav_fg.tables.parquet import filled


def _numbers(size: int) -> pa.DataType:
    return pa.list_(pa.float64(), size)


_KEYS = (filled("estimator", pa.string()), filled("stamp_ns", pa.int64()))
STATES = pa.schema(
    [
        *_KEYS,
        filled("position_m", _numbers(3)),
        filled("quaternion_wxyz", _numbers(4)),
        filled("velocity_m_s", _numbers(3)),
        filled("bias", _numbers(6)),
    ]
)
"""States, one row per estimator and frame."""
COVARIANCES = pa.schema(
    [
        ("pose_covariance", _numbers(36)),
        ("velocity_covariance", _numbers(9)),
        ("bias_covariance", _numbers(36)),
    ]
)
"""Beside the states; null for estimators without covariances."""
RESIDUALS = pa.schema(
    [
        *_KEYS,
        filled("crater_id", pa.string()),
        filled("chart", _numbers(5)),
        filled("whitened", _numbers(5)),
        filled("chi2", pa.float64()),
        ("weight", pa.float64()),
        ("reassociated_with", pa.string()),
    ]
)
"""Residuals, see `craternav_fg.runs.residuals`."""
RESIDUALS_OF_IMAGES = pa.schema([(field.name, pa.float64()) for field in fields(RimQuality)])
"""Beside the residuals, of rims that were measured in an image."""
