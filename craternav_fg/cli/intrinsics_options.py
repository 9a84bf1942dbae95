"""Options that say how well a camera is known."""

from dataclasses import dataclass, replace
from typing import Annotated

import typer

from craternav_fg.camera import Camera


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

    def of(self, camera: Camera) -> Camera:
        """Return a camera that states the sigmas of these options, else its own.

        Parameters
        ----------
        camera : Camera

        Returns
        -------
        Camera
        """
        given = {name: value for name, value in vars(self).items() if value is not None}
        return replace(camera, **given)
