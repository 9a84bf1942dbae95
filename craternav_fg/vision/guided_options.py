"""How catalogue rims are searched in an image, and which are believed."""

from dataclasses import dataclass, field

from craternav_fg.vision.arcs import ArcOptions
from craternav_fg.vision.ellipse_fit import FitOptions
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions
from craternav_fg.vision.sun import SunOptions


@dataclass(frozen=True)
class GuidedOptions:
    """How rims are searched and which are believed.

    Attributes
    ----------
    min_semi_minor_px : float
        Smaller rims are left out.
    margin_px : float
        Distance the predicted rim must keep from the image's border.
    smooth_px, smooth_share : float
        Smoothing along the rim's normals: smooth_px, at least smooth_share radii. Less texture and
        noise, but more of the crest's asymmetry to remove.
    brightness_sigma : float
        Relative standard deviation of the level ground's brightness at a single rim: regional slope,
        albedo. It is estimated beside the ellipse.
    brightness_slope_per_px : float
        The same of its change, per pixel: ground that bends under a crater, large craters that spoil the map
        of level ground.
    max_shift_px : float
        Farthest common shift that is searched; also where several rims are missing, whatever the
        prediction's covariance says.
    shift_sigmas : float
        Searched radius in standard deviations of the predicted rims.
    min_slope_contrast : float
        Least shading gain across a rim part that is searched.
    min_step : float
        Least relative step of brightness across an edge, for a gain of 1.
    step_sigmas : float
        Least step of brightness across an edge in standard deviations that the pixels' noise gives it.
    min_found_share : float
        Least share of the searched normals with an edge.
    max_rms_px, max_rms_share : float
        Largest scatter of a rim's edge points: max_rms_px + max_rms_share b.
    first_reach, second_reach : tuple of float
        Half length of the searched normals, before and after the pose is corrected by the rims:
        pixels, and share of the semi-minor axis.
    gate_probability : float
        A true rim passes the chi-square gate with this probability.
    correlated_errors : CorrelatedErrorOptions
        What of the rims' errors outlasts a frame.
    fit : FitOptions
        Of the ellipse fit, with the systematic floor and the deviation of outlines that is expected before
        they are seen.
    arcs : ArcOptions
        Of rims that are seen in part.
    sun : SunOptions
        Of the sun's tilt.
    """

    min_semi_minor_px: float = 12.0
    margin_px: float = 3.0
    smooth_px: float = 0.4
    smooth_share: float = 0.02
    brightness_sigma: float = 0.02
    brightness_slope_per_px: float = 1e-4
    max_shift_px: float = 48.0
    shift_sigmas: float = 3.5
    min_slope_contrast: float = 0.12
    min_step: float = 0.02
    step_sigmas: float = 3.0
    min_found_share: float = 0.55
    max_rms_px: float = 0.6
    max_rms_share: float = 0.05
    first_reach: tuple[float, float] = (2.5, 0.12)
    second_reach: tuple[float, float] = (1.5, 0.08)
    gate_probability: float = 0.9999
    correlated_errors: CorrelatedErrorOptions = field(default_factory=CorrelatedErrorOptions)
    fit: FitOptions = field(default_factory=lambda: FitOptions(outline_share=0.0003))
    arcs: ArcOptions = field(default_factory=ArcOptions)
    sun: SunOptions = field(default_factory=SunOptions)


# For images that nobody fuses: what all rims share matters where it does not average out over frames; of one
# image a fit's own covariance is honest.
SINGLE_IMAGE = GuidedOptions(
    correlated_errors=CorrelatedErrorOptions(
        excess_white_share=0.0,
        camera_shift_px=0.0,
        sun_shift_px=0.0,
        stretch_px=0.0,
        stretch_share=0.0,
        size_px=0.0,
        size_share=0.0,
        brightness_share=0.0,
    )
)
