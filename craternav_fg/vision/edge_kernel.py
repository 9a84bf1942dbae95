"""Edge points along the normals of one rim, compiled; see `edges`."""

import numpy as np

from craternav_fg.vision.crest_asymmetry import bluntness, displacement_share, lift_of_flanks
from craternav_fg.vision.crest_tables import (
    CrestTables,
    crossing_parts,
    expected_fall,
    of_lambertian,
    turning,
)
from craternav_fg.vision.flank_kernel import (
    LEAST_STEEPNESS,
    MOST_STEEPNESS,
    NORMAL_TERMS,
    ROUNDS,
    flanks_of_steepness,
    keep,
    kept,
)
from craternav_fg.vision.ground_level import (
    evidence_of_level,
    level_at,
    levels_of_flanks,
)
from craternav_fg.vision.image_sampling import SATURATED_BRIGHTNESS
from craternav_fg.vision.normal_profile import (
    MAX_SIDE_SAMPLES,
    crossing_between,
    crossing_near,
    flank_samples,
    half_gaussian,
    mean_between,
    moved_crossing,
    sample_normal,
    sample_step,
    smooth_between,
    smoothing_px_at,
)
from craternav_fg.vision.rim_geometry import back_through_lens, distorts, rim_point, through_lens
from craternav_fg.vision.rim_shading import (
    RimShading,
    contrast_across,
    normal_view,
    reference_along,
    rim_light,
)
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Width of the second smoothing over that of the first: the crossing's displacement between them is observed.
SECOND_SMOOTHING_FACTOR = 2.2
# Share of a rim's largest slope contrast below which errors of the reference brightness and of the rim's own
# slope direction, which the prediction does not know, outweigh the noise of the pixels. Chosen on rendered
# ground.
_FLAT_CONTRAST_SHARE = 0.35
# Prior weight of the canonical crater's fall of the slope at the crest, 1/radii, for a slope contrast of 1
# all around; and the range of how narrow a crest is, see `crest_asymmetry.displacement_terms`.
_FALL_PRIOR = 1.0
_LEAST_NARROW, _MOST_NARROW, _MOST_NARROW_OF_BLIND = 0.2, 3.0, 2.0
# An edge is ambiguous if the second best one on its normal scores more than this share of the best.
_MAX_SECOND_SCORE = 0.75
# Share of the step from the outer slope to the inner wall at which an edge is searched without a reference,
# before the rim's own share is known. How much of such an edge's level may be missing from it, as a share of
# that of others: the level is known to be large, or the reference would have been crossed. Chosen in the
# second world (`tests/foreign`, ten descents a kind): on rough ground sizes are 0.19 % too small, with a half
# they are 0.28 % too small, and with 1 the smoother's position RMS is 5 % larger.
_CREST_SHARE, _LOST_SHARE = 0.25, 0.75


@njit(cache=True, error_model="numpy")
def _edge_between_flanks(
    raw: FloatArray, soft: FloatArray, reach: int, n_side: int, gap: int, deviation: float, least: float
) -> tuple[float, float, float, float]:
    """Find the edge of a normal (n,) by its flanks alone, whatever the reference.

    Parameters
    ----------
    raw, soft : ndarray, shape (n,)
        Brightness along the normal, the inner side bright, as it is and smoothed.
    reach, n_side, gap : int
        Half length of the search, length of the flanks, and their distance from the edge, in samples.
    deviation : float
        Standard deviation, in samples, of the weight of an edge over its distance from the prediction.
    least : float
        Least step between the flanks.

    Returns
    -------
    best, second : float
        Scores of the best edge and of the next; 0 without one.
    where, fall : float
        Place of the best, in samples, and how much the smoothed brightness falls there per sample.
    """
    best, second, where, fall, here = 0.0, 0.0, 0.0, 0.0, 0.0
    half = len(raw) // 2
    for i in range(half - reach, half + reach + 1):
        outer = mean_between(raw, i + 1 + gap, i + 1 + gap + n_side)
        step = mean_between(raw, i - gap - n_side + 1, i - gap + 1) - outer
        after = soft[i] - outer - _CREST_SHARE * step
        if here > 0.0 and after <= 0.0 and step > least and soft[i - 1] > soft[i]:
            place = i - 1 + here / (here - after)
            score = step * np.exp(-0.5 * ((place - half) / deviation) ** 2)
            if score > best:
                best, second, where, fall = score, best, place, soft[i - 1] - soft[i]
            elif score > second:
                second = score
        here = after
    return best, second, where, fall


@njit(cache=True, error_model="numpy")
def _crossing_shapes(
    tables: CrestTables, lommel_share: float, normals: FloatArray, blurs: FloatArray, narrow: float,
    lift_share: float, steepness: float,
) -> FloatArray:  # fmt: skip
    """Compute outward displacements (n, 4) of crossings, px, of the canonical crest but for its wear.

    What the asymmetry does, what the second order and the lift do; the same for the motion from the first
    smoothing to the second. Views (n, 9) are those of `keep`; blurs (n, 2) are standard deviations, in
    radii; of what the lift does a share counts.
    """
    out = np.empty((len(blurs), 4))
    narrow = min(max(narrow, _LEAST_NARROW), _MOST_NARROW)
    lift_share = max(lift_share, _LEAST_NARROW)
    steepness = min(max(steepness, LEAST_STEEPNESS), MOST_STEEPNESS)
    for i in range(len(blurs)):
        view, h = kept(normals[i]), normals[i, 8]
        for k in range(2):
            odd, bent, lifted = crossing_parts(
                tables, of_lambertian(view), view.lift, blurs[i, k], steepness, lommel_share
            )
            out[i, 2 * k], out[i, 2 * k + 1] = h * odd, h * (narrow * bent + lift_share * lifted)
        out[i, 2] -= out[i, 0]
        out[i, 3] -= out[i, 1]
    return out


@njit(cache=True, error_model="numpy")
def trace_rim(
    image: ImageArray, chart_px: FloatArray, shading: RimShading, reach_px: float, smoothing_share: float,
    smoothing_px: float, psf_px: float, min_slope_contrast: float, min_step: float, noise_step: float,
    count: int, tables: CrestTables, lens: FloatArray, ground: FloatArray, thorough: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, int, FloatArray, FloatArray]:  # fmt: skip
    """Find the edge points of one rim.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    chart_px : ndarray, shape (5,)
        Predicted rim, chart in pixels of the camera without distortion, as all results.
    shading : RimShading
    reach_px : float
        Half length of the searched normals.
    smoothing_share, smoothing_px : float
        Standard deviation of the Gaussian smoothing along the normal: smoothing_share of the radius, at least
        smoothing_px.
    psf_px : float
        Standard deviation of the point-spread function.
    min_slope_contrast : float
        Least absolute slope contrast across the rim of a normal that is searched.
    min_step : float
        Least relative brightness step across the edge, for a slope contrast of 1.
    noise_step : float
        Least relative brightness step between two pixels that noise does not explain; means over several
        pixels on both sides scatter less.
    count : int
        Normals around the rim.
    tables : CrestTables
        For the same smoothing and point-spread function.
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.
    ground : ndarray, shape (5,)
        Level of the ground around the rim that the edge is searched at, see `ground_level.smooth_level`; zero
        for the reference all around.
    thorough : bool
        See `edges.find_edge_points`.

    Returns
    -------
    points : ndarray, shape (n, 2)
        Pixels.
    sigma_ratio : ndarray, shape (n,)
        Standard deviations relative to one another: an edge is the less certain the smaller the slope
        contrast, by itself and relative to the rim's largest.
    motion : ndarray, shape (n, 2)
        Motion of the points, px, per relative change of the reference brightness.
    tried : int
        Normals with enough contrast that lie in the image.
    level : ndarray, shape (n,)
        Brightness of level ground at the points, relative to the level searched at, less 1; see
        `ground_level`. Times `motion` it takes the points to where the brightness crosses that level.
    evidence : ndarray, shape (2,)
        See `ground_level.evidence_of_level`.
    """
    points = np.empty((count, 2))
    ratio = np.empty(count)
    motion = np.empty((count, 2))
    normal = np.empty((count, 2))
    first = np.empty(count)
    contrasts = np.empty(count)
    normals, blurs, moved = np.empty((count, NORMAL_TERMS)), np.empty((count, 2)), np.empty(count)
    angles = np.empty(count)
    flanks, slopes, bends = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2))
    near = np.empty((count, 2 * MAX_SIDE_SAMPLES + 2))
    sides = np.empty(count, np.int64)
    offsets = np.empty(count)
    steps = np.empty(count)
    falls = np.empty(count)
    lost = np.zeros(count, np.bool_)
    found, tried, largest = 0, 0, 0.0
    seen_fall, canonical = _FALL_PRIOR, _FALL_PRIOR
    q = np.empty(6)
    bent = distorts(lens)
    light = rim_light(chart_px, shading)
    shrinks = 1.0
    samples, soft = np.empty(0), np.empty(0)
    width, kernel, wide_kernel = -1.0, samples, samples
    for k in range(count):
        angle = 2.0 * np.pi * (k + 0.5) / count
        rim_point(chart_px, angle, q)
        contrast = contrast_across(shading.contrast_px, q)
        if np.abs(contrast) < min_slope_contrast:
            continue
        view = normal_view(chart_px, light, shading.curvature_px, angle, q)
        local = shading.reference * reference_along(shading.gradient, chart_px, q)
        if bent:
            shrinks = through_lens(q, lens)
        h = q[4]
        step = sample_step(h)
        smooth = smoothing_px_at(h, smoothing_px, smoothing_share)
        gap, n_side = flank_samples(h, step, smooth, psf_px)
        side = n_side * step
        half = int(np.ceil((reach_px + side + 4.0 * smooth) / step))
        if 2 * half + 1 > len(samples):
            samples, soft = np.empty(4 * half), np.empty(4 * half)
        raw = samples[: 2 * half + 1]
        inside = True
        sign = 1.0 if contrast > 0.0 else -1.0
        if not sample_normal(image, q, step, raw):
            continue
        local *= 1.0 + level_at(ground, angle)
        for i in range(2 * half + 1):
            raw[i] = sign * (raw[i] / local - 1.0)
            inside = inside and not np.isnan(raw[i])
        if not inside:
            continue
        tried += 1
        least = max(min_step * np.abs(contrast), noise_step / np.sqrt(side))
        n_reach = int(np.ceil(reach_px / step))
        best, second, where, fall = 0.0, 0.0, 0.0, 0.0
        if smooth / step != width:
            width = smooth / step
            kernel, wide_kernel = (
                half_gaussian(width),
                half_gaussian(SECOND_SMOOTHING_FACTOR * smooth / step),
            )
        smooth_between(raw, half - n_reach - n_side, half + n_reach + n_side + 1, kernel, soft)
        here = soft[half - n_reach]
        for i in range(half - n_reach, half + n_reach):
            after = soft[i + 1]
            if here > 0.0 and after <= 0.0:
                inner, outer = 0.0, 0.0
                for j in range(n_side):
                    inner += raw[i - j]
                    outer += raw[i + 1 + j]
                place = i + here / (here - after)
                t = (place - half) * step
                score = (inner - outer) / n_side
                if score > least:
                    # Of two equal edges the one nearer to the prediction.
                    score *= np.exp(-0.5 * (t / reach_px) ** 2)
                    if score > best:
                        second = best
                        best = score
                        where = place
                        fall = (here - after) / step
                    elif score > second:
                        second = score
            here = after
        lost[found] = thorough and best == 0.0
        if lost[found]:
            best, second, where, fall = _edge_between_flanks(
                raw, soft, n_reach, n_side, gap, reach_px / step, least
            )
            fall /= step
        if not (best > 0.0 and second < _MAX_SECOND_SCORE * best):
            continue
        if thorough and not lost[found]:
            i = int(where)
            where = i + crossing_between(soft[i - 1], soft[i], soft[i + 1], soft[i + 2])
        brightest = 0.0
        for j in range(int(where) - n_side, int(where) + n_side + 2):
            brightest = max(brightest, local * (1.0 + sign * raw[j]))
        if brightest > SATURATED_BRIGHTNESS:
            continue
        blur = np.sqrt(smooth * smooth + psf_px * psf_px) / h
        blurs[found, 0] = blur
        if not lost[found]:
            seen_fall += np.abs(contrast) * fall * h
        wide = SECOND_SMOOTHING_FACTOR * smooth
        again = crossing_near(raw, where, n_side + n_side // 2, wide_kernel, thorough)
        blurs[found, 1] = np.sqrt(wide * wide + psf_px * psf_px) / h
        moved[found] = (again - where) * step - h * (turning(view, blurs[found, 1]) - turning(view, blur))
        points[found, 0] = q[0]
        points[found, 1] = q[1]
        normal[found, 0] = q[2]
        normal[found, 1] = q[3]
        first[found] = (where - half) * step + 0.5 * psf_px * psf_px * q[5] - h * turning(view, blur)
        ratio[found] = shrinks
        contrasts[found] = contrast
        largest = max(largest, np.abs(contrast))
        motion[found, 0] = -sign * q[2] / fall
        motion[found, 1] = -sign * q[3] / fall
        angles[found] = angle
        middle = int(where)
        flanks[found, 0] = sign * mean_between(raw, middle - gap - n_side + 1, middle - gap + 1)
        flanks[found, 1] = sign * mean_between(raw, middle + 1 + gap, middle + 1 + gap + n_side)
        keep(view, h, normals[found])
        for j in range(2 * n_side + 2):
            near[found, j] = soft[middle - n_side + j]
        sides[found] = n_side
        offsets[found] = where - middle
        steps[found] = step
        falls[found] = sign * fall
        found += 1
    rounds = ROUNDS if thorough else 1
    steepness = flanks_of_steepness(tables, light, normals[:found], flanks[:found], slopes, bends, rounds)
    share = light.lommel_share
    for i in range(found):
        if not lost[i]:
            view, of_law = kept(normals[i]), share if thorough else 0.0
            fall = expected_fall(tables, of_lambertian(view), blurs[i, 0], steepness, of_law)
            canonical += view.contrast * view.contrast * fall
    fall_share = seen_fall / canonical
    narrow = fall_share / max(steepness, LEAST_STEEPNESS)
    if thorough:
        bends_share, lift_share, scale = narrow, 1.0, steepness
        lifted = lift_of_flanks(steepness, narrow)
        for i in range(found):
            bends[i] += lifted * normals[i, 2] * normals[i, 5]
    else:
        bends_share = lift_share = min(fall_share / max(steepness, 1.0), _MOST_NARROW_OF_BLIND)
        scale = 1.0
    shapes = _crossing_shapes(tables, share, normals[:found], blurs[:found], bends_share, lift_share, scale)
    blunt = bluntness(moved[:found], shapes[:, 2], shapes[:, 3], contrasts[:found])
    displaced = displacement_share(blunt, narrow) if thorough else blunt
    first[:found] -= displaced * shapes[:, 0] + shapes[:, 1]
    level = np.zeros(found)
    evidence = np.zeros(2)
    if found > 0:
        found_level = levels_of_flanks(flanks[:found], contrasts[:found], slopes[:found], bends[:found])
        contrasts = np.abs(contrasts)
        shifts = np.zeros(found)
        crossings = np.empty(found)
        for i in range(found):
            sign = np.sign(falls[i])
            shifts[i] = steps[i] * moved_crossing(
                near[i, : 2 * sides[i] + 2], sides[i] + offsets[i], sign * found_level[i]
            )
            if lost[i]:
                # Where the reference would be crossed if the brightness fell on as it does at the crest.
                first[i] += shifts[i]
                shifts[i] = -_LOST_SHARE * found_level[i] / falls[i]
                first[i] -= shifts[i]
            crossings[i] = first[i]
            level[i] = -falls[i] * shifts[i]
        seen = ~lost[:found]
        evidence = evidence_of_level(
            angles[:found][seen], contrasts[:found][seen], crossings[seen], shifts[seen]
        )
    for i in range(found):
        flat = _FLAT_CONTRAST_SHARE * largest / contrasts[i]
        ratio[i] *= np.sqrt(1.0 + flat * flat) / contrasts[i]
        points[i, 0] += first[i] * normal[i, 0]
        points[i, 1] += first[i] * normal[i, 1]
        if bent:
            back_through_lens(points[i], motion[i], lens)
    return points[:found], ratio[:found], motion[:found], tried, level, evidence
