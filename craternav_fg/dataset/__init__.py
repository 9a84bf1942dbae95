"""Data sets on disk, in the EuRoC/ASL layout; `layout` describes every file with an example."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from craternav_fg.dataset.measurements import ground_sun_direction
    from craternav_fg.dataset.reader import Dataset
    from craternav_fg.dataset.recording import Recording
    from craternav_fg.dataset.sun import SunVectors
    from craternav_fg.dataset.writer import write_dataset
else:
    from factors.lazy import names

    __getattr__ = names(
        __name__,
        {
            "Dataset": "reader",
            "Recording": "recording",
            "SunVectors": "sun",
            "ground_sun_direction": "measurements",
            "write_dataset": "writer",
        },
    )

__all__ = ["Dataset", "Recording", "SunVectors", "ground_sun_direction", "write_dataset"]
