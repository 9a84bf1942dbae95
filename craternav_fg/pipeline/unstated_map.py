"""Catalogues that state no errors and have some: the rims tell how large they are, and are measured again."""

from dataclasses import replace

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import NUMERICAL_ERRORS
from craternav_fg.estimators.instruments import RIMS
from craternav_fg.pipeline.detected_intrinsics import detected_intrinsics
from craternav_fg.pipeline.intrinsics_check import contradicted_intrinsics, contradicted_lens, to_be_averaged
from craternav_fg.pipeline.map_errors import filtered_poses, with_tilts
from craternav_fg.pipeline.measuring import Measuring, Prepared, expected_rims
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.pipeline.rim_mistakes import likely_rim_mistake
from craternav_fg.resection.estimated_errors import EstimatedErrors
from craternav_fg.resection.map_variances import estimated_errors, place_equations
from craternav_fg.resection.shifted_group import ShiftedGroup, shifted_group
from craternav_fg.vision.error_model.correlated import map_variances
from factors.arrays import FloatArray

# The first estimate is of rims that were found near an exact map. Those that are farther off are found with
# twice these errors, and give the second estimate. It may grow further, as more rims are found.
_WIDER, _MEASUREMENTS, _SETTLED = 2.0, 4, 1.2
# Share of the frames that should show so many craters in which so many must be found: chance finds them in
# few, and in more if it is searched farther around. Share of the frames with rims that must have some then.
_CRATERS, _LEAST_FOUND, _LEAST_KEPT = 3, 1.0 / 3.0, 0.75


def with_unstated_errors(first: Prepared, measuring: Measuring) -> tuple[Prepared, EstimatedErrors | None]:
    """Estimate the errors of a catalogue that states none, and measure its rims with them.

    Parameters
    ----------
    first : Prepared
        With the catalogue as exact.
    measuring : Measuring

    Returns
    -------
    prepared : Prepared
        The same where the catalogue states errors, the rims do not contradict it, or another mistake explains
        why they do.
    errors : EstimatedErrors or None
        What was assumed.

    Raises
    ------
    InputError
        When an image cannot be read.
    """
    catalog = first.dataset.catalog
    stated = map_variances(np.arange(len(catalog)), catalog, measuring.options.correlated_errors)
    if catalog.errors is not None or stated.any() or RIMS in measuring.without:
        return first, None
    near = _near(first)
    errors = None if near is None or _by_chance(first, near) else _estimated(first, near)
    if near is None or errors is None or _explained(first, near, errors):
        return first, None
    try:
        return _measured_again(first, measuring, errors)
    except EstimationError:
        # What was measured with the map as exact is there.
        return first, None


def with_aligned_group(
    prepared: Prepared, errors: EstimatedErrors | None, measuring: Measuring, given: Dataset
) -> tuple[Prepared, EstimatedErrors | None, ShiftedGroup | None]:
    """Align craters of a catalogue that are displaced alike, and measure its rims again.

    Parameters
    ----------
    prepared : Prepared
    errors : EstimatedErrors or None
        What was assumed of the catalogue, see `with_unstated_errors`.
    measuring : Measuring
    given : Dataset
        Without errors that were assumed.

    Returns
    -------
    prepared : Prepared
        The same where there is no such group, or the catalogue states a common shift of its places.
    errors : EstimatedErrors or None
        What is assumed of the aligned catalogue.
    group : ShiftedGroup or None

    Raises
    ------
    InputError
        When an image cannot be read.
    """
    shift, descent = given.catalog.common_shift, prepared.problems[0]
    stated = shift is not None and not np.isnan(shift.place_m).all()
    near = None if stated or RIMS in measuring.without else _near(prepared)
    if near is None:
        return prepared, errors, None
    try:
        # Of sizes and heights that are wrong by more than stated, rims would seem to be displaced.
        known = _estimated(prepared, near) if errors is None and given.catalog.errors is not None else errors
        frames = prepared.without_map_errors()
        # Errors that craters keep would seem to be displacements that many frames confirm.
        alike = to_be_averaged([frame.rims for frame in frames], descent.catalog)
        frames = tuple(replace(frame, rims=rims) for frame, rims in zip(frames, alike, strict=True))
        equations = place_equations(frames, near, descent.camera, descent.catalog, known)
        group = None if equations is None else shifted_group(equations, given.catalog)
        if group is None:
            return prepared, errors, None
        dataset = replace(given, catalog=group.aligned(given.catalog))
        again = measuring.prepared(dataset, Relocaliser(dataset))
    except (EstimationError, *NUMERICAL_ERRORS):
        return prepared, errors, None
    return *with_unstated_errors(again, measuring), group


def _measured_again(
    first: Prepared, measuring: Measuring, errors: EstimatedErrors
) -> tuple[Prepared, EstimatedErrors | None]:
    """Measure with the errors of a first estimate, and with better ones."""
    if first.dataset.measurements is not None:
        return _again(first, measuring, errors), errors
    found: EstimatedErrors | None = errors.scaled(_WIDER)
    for measurement in range(_MEASUREMENTS):
        if found is None or (measurement > 1 and not found.exceed(errors, _SETTLED)):
            break
        errors, final = found, _again(first, measuring, found)
        found = _estimated(final, _near(final))
        if found is not None:
            # The rims hold the slopes already, unlike the other errors: what is found is beside them.
            found = replace(found, tilt_rad=float(np.hypot(errors.tilt_rad, found.tilt_rad)))
    confirmed = _frames_with_rims(final) >= _LEAST_KEPT * _frames_with_rims(first)
    return (final, errors) if confirmed else (first, None)


def _near(prepared: Prepared) -> FloatArray | None:
    """Poses (k, 4, 4) near those of the frames; None where the filter finds none."""
    measured = prepared.measured
    if measured.guides is not None:
        return measured.guides
    try:
        poses = filtered_poses(prepared.problems)
    except (EstimationError, *NUMERICAL_ERRORS):
        return None
    return np.array([poses[frame.stamp_ns] for frame in measured.frames])


def _by_chance(prepared: Prepared, near: FloatArray) -> bool:
    """Whether rims were found in so few images that they may be others than the catalogue's."""
    counts = np.array([len(frame.rims) for frame in prepared.measured.frames])
    expected = expected_rims(prepared.dataset, near, prepared.measured.limits)
    if expected is None:
        return False
    should = np.array(expected) >= _CRATERS
    return bool((counts[should] >= _CRATERS).sum() < _LEAST_FOUND * should.sum())


def _estimated(prepared: Prepared, near: FloatArray | None) -> EstimatedErrors | None:
    descent = prepared.problems[0]
    if near is None:
        return None
    try:
        return estimated_errors(prepared.without_map_errors(), near, descent.camera, descent.catalog)
    except NUMERICAL_ERRORS:
        return None


def _explained(prepared: Prepared, near: FloatArray, errors: EstimatedErrors) -> bool:
    """Whether the camera, or a mistake in the tables of rims and craters, explains why rims do not agree."""
    descent, measured = prepared.problems[0], prepared.measured
    frames = measured.frames
    if errors.tilted:
        # Rims on slopes that count as level contradict the intrinsics, too; a wrong camera shows no slopes.
        frames = with_tilts(frames, near, descent.camera, descent.catalog, errors.tilt_rad)
    if any(
        check(frames, near, descent.camera, descent.catalog)
        for check in (contradicted_intrinsics, contradicted_lens)
    ):
        return True
    if measured.guides is None:
        return bool(likely_rim_mistake(descent))
    expected = expected_rims(prepared.dataset, near, measured.limits)
    of_detected = detected_intrinsics(prepared.dataset, prepared.relocaliser, measured.frames, expected, near)
    return of_detected is not None and (of_detected.focal_is_off or of_detected.principal_point_is_off)


def _again(first: Prepared, measuring: Measuring, errors: EstimatedErrors) -> Prepared:
    """Measure with errors of the map."""
    catalog = first.dataset.catalog
    catalog = replace(catalog, errors=errors.of(catalog), common_shift=errors.common_shift(catalog))
    dataset = replace(first.dataset, catalog=catalog)

    def report(what: str, done: int, total: int) -> None:
        measuring.report(f"{what} again, with the map's errors", done, total)

    if errors.tilted:
        correlated = measuring.options.correlated_errors
        tilt_rad = float(np.hypot(correlated.map_tilt_rad, errors.tilt_rad))
        options = replace(measuring.options, correlated_errors=replace(correlated, map_tilt_rad=tilt_rad))
        measuring = replace(measuring, options=options, tilt_rad=errors.tilt_rad)
    return replace(measuring, report=report).prepared(
        dataset, first.relocaliser.sharing_index(dataset), lowered=first.lowered
    )


def _frames_with_rims(prepared: Prepared) -> int:
    return sum(len(frame.rims) > 0 for frame in prepared.measured.frames)
