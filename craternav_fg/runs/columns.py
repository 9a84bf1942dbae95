"""Arrays as columns of Arrow tables: one fixed-size list per row."""

import numpy as np
import numpy.typing as npt
import pyarrow as pa

FloatArray = npt.NDArray[np.float64]


def list_column(rows: FloatArray) -> pa.Array:
    """Make a column of fixed-size lists.

    Parameters
    ----------
    rows : ndarray, shape (n, d)

    Returns
    -------
    pyarrow.FixedSizeListArray, shape (n,)
        Of lists of d numbers.
    """
    flat = pa.array(np.ascontiguousarray(rows).ravel(), pa.float64())
    return pa.FixedSizeListArray.from_arrays(flat, rows.shape[1])


def list_values(column: pa.ChunkedArray) -> FloatArray | None:
    """Read a column of fixed-size lists.

    Parameters
    ----------
    column : pyarrow.ChunkedArray, shape (n,)
        Of fixed-size lists of d numbers.

    Returns
    -------
    ndarray, shape (n, d), or None
        None when a row is null.
    """
    array = column.combine_chunks()
    if array.null_count:
        return None
    flat = array.flatten().to_numpy(zero_copy_only=False)
    return np.asarray(flat, dtype=np.float64).reshape(len(array), array.type.list_size)
