"""What the commands on single images print of a pose."""

from typing import Any

from craternav_fg.cli.terminal import say


def show_pose(pose: dict[str, Any], before: str = "") -> None:
    """Print a pose with its standard deviations, in three lines.

    Parameters
    ----------
    pose : dict
        `latitude_deg`, `longitude_deg`, `altitude_m`, `position_m`, `attitude_wxyz`, `position_sigma_m` and
        `attitude_sigma_deg`.
    before : str
        Begins the first line.
    """
    gP, attitude, sigma_m, sigma_deg = (
        ", ".join(f"{value:{form}}" for value in pose[name])
        for name, form in (
            ("position_m", ".2f"),
            ("attitude_wxyz", ".8f"),
            ("position_sigma_m", ".3g"),
            ("attitude_sigma_deg", ".3g"),
        )
    )
    say(
        f"{before}latitude {pose['latitude_deg']:.5f} deg, longitude {pose['longitude_deg']:.5f} deg, "
        f"altitude {pose['altitude_m']:.1f} m"
    )
    say(f"  position in g {gP} m; sigma {sigma_m} m")
    say(f"  attitude gRb (w, x, y, z) {attitude}; sigma in b {sigma_deg} deg")


def focal_text(values: dict[str, Any]) -> str:
    """Say by how much the focal length that the rims show differs from the camera's; empty when unknown.

    Parameters
    ----------
    values : dict
        `focal_scale` and `focal_scale_sigma`.

    Returns
    -------
    str
        A clause.
    """
    if values["focal_scale"] is None or values["focal_scale_sigma"] is None:
        return ""
    difference = 100.0 * (values["focal_scale"] - 1.0)
    return f"; focal length by the rims {difference:+.2g} +- {100.0 * values['focal_scale_sigma']:.2g} %"
