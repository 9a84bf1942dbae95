"""The families of fitted constants, by name."""

from collections.abc import Callable, Mapping
from pathlib import Path

from craternav_fg.calibration.arcs import arcs
from craternav_fg.calibration.blind_detection import blind_quality, candidates
from craternav_fg.calibration.catalogue_errors import catalogue_errors
from craternav_fg.calibration.common_shift import common_shift
from craternav_fg.calibration.correlated_errors import correlated_errors, outline_brightness
from craternav_fg.calibration.crest_asymmetry import crest_asymmetry
from craternav_fg.calibration.crest_blur import crest_blur
from craternav_fg.calibration.crest_heights import crest_heights
from craternav_fg.calibration.pooling import pooling
from craternav_fg.calibration.posed_images import posed_images
from craternav_fg.calibration.pull_of_prediction import pull_of_prediction
from craternav_fg.calibration.reference_brightness import reference_brightness
from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.calibration.rim_floor import rim_floor
from craternav_fg.calibration.rim_tilts import rim_tilts
from craternav_fg.calibration.robust_moments import robust_moments
from craternav_fg.calibration.sun_tilt import sun_tilt
from craternav_fg.calibration.variance_inflation import variance_inflation

# Those that share what they render stand together.
FAMILIES: Mapping[str, Callable[[], list[Regenerated]]] = {
    "robust_moments": robust_moments,
    "crest_asymmetry": crest_asymmetry,
    "crest_blur": crest_blur,
    "blind_quality": blind_quality,
    "candidates": candidates,
    "reference_brightness": reference_brightness,
    "sun_tilt": sun_tilt,
    "rim_floor": rim_floor,
    "correlated_errors": correlated_errors,
    "outline_brightness": outline_brightness,
    "arcs": arcs,
    "pooling": pooling,
    "variance_inflation": variance_inflation,
}
# Those that need the folder of the public files; they print what they find.
ON_REAL_GROUND: Mapping[str, Callable[[Path], None]] = {
    "catalogue_errors": catalogue_errors,
    "common_shift": common_shift,
    "posed_images": posed_images,
    "pull_of_prediction": pull_of_prediction,
    "crest_heights": crest_heights,
    "rim_tilts": rim_tilts,
}
