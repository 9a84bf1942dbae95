"""Options that say how well a camera is known."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.camera import Camera
from craternav_fg.dataset.sensor_files import read_intrinsics_sigmas
from craternav_fg.resection.intrinsics import FOCAL_SIGMA, PRINCIPAL_SIGMA_PX, IntrinsicsPrior


@dataclass(frozen=True)
class IntrinsicsOptions:
    """How well the camera's intrinsics are known."""

    focal_sigma_percent: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=10.0,
            help="Standard deviation of the focal length; 0 if exact.",
            show_default="that of the camera's file, else 0.3",
        ),
    ] = None
    principal_sigma_px: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=100.0,
            help="Standard deviation of each coordinate of the principal point; 0 if exact.",
            show_default="that of the camera's file, else 0.5",
        ),
    ] = None

    def prior(self, path: Path, camera: Camera) -> IntrinsicsPrior:
        """Return the sigmas of these options, else those of the camera's file, else the usual ones.

        Parameters
        ----------
        path : Path
            The camera's sensor.yaml.
        camera : Camera
            The same, read.

        Returns
        -------
        IntrinsicsPrior

        Raises
        ------
        InputError
            When the file is wrong.
        """
        focal, principal_px = read_intrinsics_sigmas(path)
        if self.focal_sigma_percent is not None:
            focal = 0.01 * self.focal_sigma_percent
        if self.principal_sigma_px is not None:
            principal_px = self.principal_sigma_px
        return IntrinsicsPrior(
            camera.focal_px,
            FOCAL_SIGMA if focal is None else focal,
            PRINCIPAL_SIGMA_PX if principal_px is None else principal_px,
            focal_stated=focal is not None,
        )
