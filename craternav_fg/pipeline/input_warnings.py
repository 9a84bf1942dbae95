"""Warnings of what a data set holds: logs that are not used, wrong images and mountings."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.dataset import layout
from craternav_fg.imu import ImuLog
from craternav_fg.pipeline.processed_images import ProcessedImages
from factors.arrays import FloatArray

if TYPE_CHECKING:
    # The commands for one image name their mounting here, and detect nothing.
    from craternav_fg.pipeline.detected_intrinsics import DetectedIntrinsics

# Departure of the sun from its place among the stars that a warning names: what a tilt in the image shows.
_MAX_DEPARTURE_RAD = math.radians(2.0)
# Images that a warning names.
_MAX_LISTED = 5
# Blur beyond what the camera states, px and as a ratio, that is told. On right data, also of other renderers,
# up to 0.5 px more shows where the ground is smooth, in photographs none.
_MORE_BLUR_PX, _MORE_BLUR = 0.65, 1.5
# Rows in a row that may be equal by chance of digits are fewer; of the others, at most this share.
_MIN_FROZEN_ROWS, _MAX_REPEATED_SHARE = 20, 0.02
# Rows in a row at the limit of a sensor's range: at least so many, and times as many as of any other value.
_MIN_SATURATED_ROWS, _SATURATED_OVER_OTHERS = 6, 3
# Different values between the limits of an axis that measures something.
_MIN_VALUES = 10
# No lander carries a sensor farther than this from its body origin.
_MAX_LEVER_ARM_M = 50.0
# Lever arms of cameras on landers are of this order: one that was left out shows in smaller errors than that.
_USUAL_LEVER_ARM_M = 1.0


def unknown_sensors(ignored: Sequence[str]) -> list[str]:
    """Warn of sensors' folders that were not read.

    Parameters
    ----------
    ignored : sequence of str
        Names of folders below `mav0`.

    Returns
    -------
    list of str
    """
    if not ignored:
        return []
    return [
        f"not used: mav0/{', mav0/'.join(ignored)}: unknown sensor (`craternav sensors` lists the known ones)"
    ]


def dead_imu(imu: ImuLog | None) -> list[str]:
    """Warn of an IMU that measured nothing, or stopped measuring: its rows are zero, or repeat one another.

    Parameters
    ----------
    imu : ImuLog or None

    Returns
    -------
    list of str
    """
    if imu is None or len(imu.stamps_ns) < _MIN_FROZEN_ROWS:
        return []
    values = {"angular velocities": imu.gyro_rad_s, "specific forces": imu.accelerometer_m_s2}
    dead = [f"imu: all its {name} are zero" for name, rows in values.items() if not rows.any()]
    rows = np.concatenate(list(values.values()), axis=1)
    repeats = np.concatenate([[False], (rows[1:] == rows[:-1]).all(axis=1), [False]])
    # Runs of rows that repeat the one before.
    ends = np.flatnonzero(repeats[1:] != repeats[:-1]).reshape(-1, 2)
    lengths = ends[:, 1] - ends[:, 0]
    if dead or not len(lengths):
        return dead
    longest = int(np.argmax(lengths))
    begin, end = (int(row) for row in ends[longest])
    # Logs without noise repeat themselves all along.
    others = int(lengths.sum() - lengths[longest])
    if lengths[longest] < _MIN_FROZEN_ROWS or others > _MAX_REPEATED_SHARE * len(rows):
        return []
    first_s = 1e-9 * float(imu.stamps_ns[begin] - imu.stamps_ns[0])
    return [
        f"imu: from {first_s:.6g} s after its first row on, {end - begin + 1} rows repeat the same values: "
        "has the log stopped there?"
    ]


def saturated_imu(imu: ImuLog | None) -> list[str]:
    """Warn of an IMU that reached the limit of its range: an axis stays at its largest or smallest value.

    Parameters
    ----------
    imu : ImuLog or None

    Returns
    -------
    list of str
    """
    if imu is None or not len(imu.stamps_ns):
        return []
    found = []
    names = (*layout.GYRO, *layout.ACCELEROMETER)
    units = (*3 * ["rad/s"], *3 * ["m/s^2"])
    columns = np.concatenate([imu.gyro_rad_s, imu.accelerometer_m_s2], axis=1).T
    for name, unit, values in zip(names, units, columns, strict=True):
        least, most = float(values.min()), float(values.max())
        inside = values[(values > least) & (values < most)]
        # Of few values, as of a coarse log at rest, two are the largest and the smallest.
        if len(np.unique(inside)) < _MIN_VALUES:
            continue
        # Runs of equal values.
        begins = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
        lengths = np.diff(np.append(begins, len(values)))
        # Logs without noise, and coarse ones, repeat other values as well.
        within = (values[begins] > least) & (values[begins] < most)
        other = int(lengths[within].max())
        # A sensor's range reaches beyond zero: what stays there measures nothing.
        for which, limit in (("largest", max(most, 0.0)), ("smallest", min(least, 0.0))):
            there = values[begins] == limit
            longest = int(lengths[there].max(initial=0))
            if limit != 0.0 and longest >= max(_MIN_SATURATED_ROWS, _SATURATED_OVER_OTHERS * other):
                rows = int(lengths[there].sum())
                found.append(
                    f"imu: {name} is at its {which} value, {limit:.6g} {unit}, in {rows} rows, {longest} of "
                    "them in a row: is the sensor saturated? Nothing allows for what it then missed"
                )
    return found


def empty_logs(samples: Mapping[str, int]) -> list[str]:
    """Warn of sensors whose logs hold nothing.

    Parameters
    ----------
    samples : mapping of str to int
        Number of samples of each sensor.

    Returns
    -------
    list of str
    """
    return [
        f"the log of {name} has no sample between the first image and the last"
        for name, count in samples.items()
        if not count
    ]


def colour_images(count: int) -> list[str]:
    """Tell that images are in colour.

    Parameters
    ----------
    count : int
        Such images of the data set.

    Returns
    -------
    list of str
    """
    if not count:
        return []
    return [f"{count} images are in colour: their luma is used"]


def departing_sun(departure_rad: float) -> list[str]:
    """Warn of a sun that does not keep its place among the stars, as one direction on a spinning body.

    Parameters
    ----------
    departure_rad : float
        See `SunVectors.departure_rad`, from the first frame to the last.

    Returns
    -------
    list of str
    """
    if departure_rad < _MAX_DEPARTURE_RAD:
        return []
    return [
        f"sun.csv: at the last frame the sun is {math.degrees(departure_rad):.3g} deg from where the body's "
        "spin takes it from the first one: give a row for each frame, in g, and check spin_rad_s"
    ]


def repeated_images(repeated: Mapping[str, str]) -> list[str]:
    """Warn of images that are copies of earlier ones.

    Parameters
    ----------
    repeated : mapping of str to str
        See `Reconstruction.repeated`.

    Returns
    -------
    list of str
    """
    if not repeated:
        return []
    pairs = [f"{name} (same pixels as {first})" for name, first in repeated.items()]
    return [
        f"copies of earlier images, which were not taken at their stamps: {listed(pairs)}; their rims are "
        "left out"
    ]


def equalised_images(processed: ProcessedImages) -> list[str]:
    """Warn of images whose contrasts are no longer those of the ground.

    Parameters
    ----------
    processed : ProcessedImages
        See `processed_images.processed_images`.

    Returns
    -------
    list of str
    """
    count = processed.equalised or processed.locally_equalised
    if not count:
        return []
    shown = (
        "have all grey levels equally often, as after histogram equalisation"
        if processed.equalised
        else "lack grey levels in their corners that they have elsewhere, as after local equalisation (CLAHE)"
    )
    return [
        f"{count} of {processed.looked_at} images that were looked at {shown}: brightness no longer follows "
        "the slopes of the ground, rims are measured beside their place and covariances are too small; give "
        "the images before that, or with a contrast that is the same for all grey levels"
    ]


def blurred_images(processed: ProcessedImages, psf_px: float) -> list[str]:
    """Warn of images that are blurrier than the camera states.

    Sharper ones are not told: compressed images look sharper than they are.

    Parameters
    ----------
    processed : ProcessedImages
        See `processed_images.processed_images`.
    psf_px : float
        Width of the camera's point-spread function.

    Returns
    -------
    list of str
    """
    width = processed.blur_px
    if width is None or width < max(psf_px + _MORE_BLUR_PX, _MORE_BLUR * psf_px):
        return []
    return [
        f"the images are blurred by about {width:.1f} px, but psf_sigma_px is {psf_px:.2g}: check focus, "
        "motion and resampling of the images, or state their width in the camera's sensor.yaml; otherwise "
        "sizes of rims err by percents"
    ]


def repeated_lines(processed: ProcessedImages) -> list[str]:
    """Warn of images whose rows or columns are there several times.

    Parameters
    ----------
    processed : ProcessedImages
        See `processed_images.processed_images`.

    Returns
    -------
    list of str
        One sentence for rows and columns.
    """
    if not processed.repeated:
        return []
    lines = " and ".join(
        f"{count} have each of their {name} {factor:.3g} times"
        for name, (count, factor) in processed.repeated.items()
    )
    return [
        f"of {processed.looked_at} images that were looked at, {lines}, as in a single field of interlaced "
        "video or after an enlargement that repeats pixels: rims are measured beside their place and "
        "covariances are too small; give images of the camera's own resolution, with its intrinsics"
    ]


def widened_prior(sigma_factor: float) -> list[str]:
    """Warn of an initial state that measured rims contradict.

    Parameters
    ----------
    sigma_factor : float
        See `Reconstruction.sigma_factor`.

    Returns
    -------
    list of str
    """
    if sigma_factor == 1.0:
        return []
    return [
        "the rims of the first frames contradict the initial state, which is "
        f"{sigma_factor:.2g} times as far off as it states: the sigmas of its position, attitude and "
        "velocity were multiplied by that; check it and its frame, longitudes and latitudes in the "
        "catalogue, T_BS and the intrinsics of the camera"
    ]


def disbelieved_frames(disbelieved: Mapping[int, str]) -> list[str]:
    """Warn of frames whose rims were left out, as they contradict the track.

    Parameters
    ----------
    disbelieved : mapping of int to str
        See `Reconstruction.disbelieved`.

    Returns
    -------
    list of str
    """
    if not disbelieved:
        return []
    names = [f"{frame} ({name})" for frame, name in disbelieved.items()]
    return [
        f"the craters identified in frame {listed(names)} contradict the IMU and other frames, and no "
        "later frame confirms them: their rims are left out; check that the image is the one of its stamp, "
        "and if this happens often, the IMU's units and axes"
    ]


def listed(names: Sequence[str]) -> str:
    """List the first of many names.

    Parameters
    ----------
    names : sequence of str

    Returns
    -------
    str
    """
    shown = ", ".join(names[:_MAX_LISTED])
    return shown if len(names) <= _MAX_LISTED else f"{shown} and {len(names) - _MAX_LISTED} more"


def deviating_intrinsics(found: "DetectedIntrinsics | None") -> list[str]:
    """Warn of intrinsics that detected rims contradict, and name by how much.

    Parameters
    ----------
    found : DetectedIntrinsics or None
        See `detected_intrinsics.detected_intrinsics`.

    Returns
    -------
    list of str
    """
    parts = []
    if found is not None and found.focal_is_off:
        parts.append(
            f"a focal length {100.0 * abs(found.focal_share):.2g} +- {100.0 * found.focal_sigma_share:.1g} % "
            f"{'larger' if found.focal_share > 0.0 else 'smaller'} than the camera's"
        )
    if found is not None and found.principal_point_is_off:
        (x, y), (dx, dy) = found.shift_px, found.shift_sigma_px
        parts.append(f"a principal point ({x:.2g} +- {dx:.1g}, {y:.2g} +- {dy:.1g}) px from the camera's")
    if found is None or not parts:
        return []
    return [
        f"rims that are detected in {found.images} images and identified by themselves show "
        f"{' and '.join(parts)}: check the intrinsics, the lens and the resolution in its sensor.yaml"
    ]


def long_lever_arms(mountings: Mapping[str, FloatArray]) -> list[str]:
    """Warn of sensors that are farther from the body's origin than a lander is long.

    Parameters
    ----------
    mountings : mapping of str to ndarray
        Poses (4, 4) of the sensors in b, m, by name.

    Returns
    -------
    list of str
    """
    arms_m = {name: float(np.linalg.norm(bTs[:3, 3])) for name, bTs in mountings.items()}
    return [
        f"{name}: its lever arm in T_BS is {arm:.4g} m; expected metres, is it in millimetres?"
        for name, arm in arms_m.items()
        if arm > _MAX_LEVER_ARM_M
    ]


def missing_lever_arm(camera: Camera, position_sigma_m: float) -> list[str]:
    """Warn of a camera at the body's origin, as it is where nobody gave its lever arm.

    Parameters
    ----------
    camera : Camera
    position_sigma_m : float
        Smallest standard deviation of a position that was estimated.

    Returns
    -------
    list of str
        None where the lever arm's standard deviation is stated, or would not matter.
    """
    stated = camera.bTc[:3, 3].any() or camera.lever_arm_sigma_m is not None
    if stated or not position_sigma_m < _USUAL_LEVER_ARM_M:
        return []
    return [
        f"camera: its lever arm in T_BS is zero, and positions are stated to {position_sigma_m:.2g} m: a "
        "lever arm that is left out shifts them, and nothing else shows it; give it, or lever_arm_sigma_m "
        "(0 if the IMU is in the camera)"
    ]


def mounting_of_image(camera: Camera, position_sigma_m: float) -> list[str]:
    """Warn of the camera's mounting where it gives the pose of a single image.

    Parameters
    ----------
    camera : Camera
        Where T_BS is the identity, b is the camera: nothing is left out.
    position_sigma_m : float
        See `missing_lever_arm`.

    Returns
    -------
    list of str
    """
    turned = not np.array_equal(camera.bTc[:3, :3], np.eye(3))
    missing = missing_lever_arm(camera, position_sigma_m) if turned else []
    return [*long_lever_arms({"camera": camera.bTc}), *missing]
