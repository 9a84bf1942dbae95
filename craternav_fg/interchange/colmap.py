"""Cameras and poses as a text model of COLMAP: `cameras.txt`, `images.txt` and `points3D.txt`."""

from pathlib import Path

from craternav_fg import frames, lens
from craternav_fg.camera import Camera
from craternav_fg.files import replacing_folder
from craternav_fg.trajectory import Trajectory

CAMERAS, IMAGES, POINTS = "cameras.txt", "images.txt", "points3D.txt"


def write_colmap(folder: Path, trajectory: Trajectory, camera: Camera, names: tuple[str, ...]) -> None:
    """Write a model with known poses, to triangulate or to view.

    Parameters
    ----------
    folder : Path
        Replaced when it is empty or such a model.
    trajectory : Trajectory
        Its frame g becomes COLMAP's world, m.
    camera : Camera
    names : tuple of str, length k
        Names of the images.

    Raises
    ------
    InputError
        When the folder holds something else, or cannot be written.
    ValueError
        When there is not one name for each pose.
    """
    cTg = frames.inverse(camera.gTc(trajectory.gTb))
    q = frames.to_quaternion_wxyz(cTg[:, :3, :3])
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then its points"]
    for k, (rotation, T, name) in enumerate(zip(q, cTg, names, strict=True)):
        numbers = " ".join(repr(float(x)) for x in (*rotation, *T[:3, 3]))
        lines += [f"{k + 1} {numbers} 1 {name}", ""]
    with replacing_folder(folder, marker=CAMERAS, ours=(CAMERAS, IMAGES, POINTS)) as temporary:
        (temporary / CAMERAS).write_text(_camera(camera), encoding="utf-8")
        (temporary / IMAGES).write_text("\n".join(lines) + "\n", encoding="utf-8")
        (temporary / POINTS).write_text("# none: the poses are known\n", encoding="utf-8")


def _camera(camera: Camera) -> str:
    """Compose cameras.txt: COLMAP's pixel (0, 0) is the corner of the first pixel, ours its centre."""
    k = camera.distortion
    focal = [camera.fx_px, camera.fy_px, camera.cx_px + 0.5, camera.cy_px + 0.5]
    if camera.lens_model == lens.FISHEYE:
        model, values = "OPENCV_FISHEYE", [*focal, *k]
    elif not camera.distorts:
        model, values = "PINHOLE", focal
    elif any(k[4:]):
        model, values = "FULL_OPENCV", [*focal, *k, *[0.0] * (8 - len(k))]
    else:
        model, values = "OPENCV", [*focal, *k[:4]]
    numbers = " ".join(repr(float(v)) for v in values)
    head = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS"
    return f"{head}\n1 {model} {camera.width_px} {camera.height_px} {numbers}\n"
