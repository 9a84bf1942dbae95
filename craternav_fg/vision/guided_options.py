"""Options of the guided front end: how rims are searched, and which are accepted."""

from dataclasses import dataclass, field

from craternav_fg.vision.arcs import ArcOptions
from craternav_fg.vision.edges import EdgeOptions
from craternav_fg.vision.ellipse_fit import FitOptions
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions
from craternav_fg.vision.point_tracks import PointTrackOptions
from craternav_fg.vision.sun import SunOptions


@dataclass(frozen=True)
class GuidedOptions:
    """How rims are searched, and which are accepted.

    Attributes
    ----------
    min_semi_minor_px : float
        Semi-minor axis of the smallest rims that are searched.
    margin_px : float
        Minimum distance of a predicted rim from the image's border.
    brightness_sigma_share : float
        Relative standard deviation of the reference brightness at a single rim: regional slope, albedo. It is
        estimated beside the ellipse. Its lower bound: `craternav_fg.calibration.reference_brightness`.
    brightness_slope_per_px : float
        Relative standard deviation of its change per pixel: terrain that bends under a crater, large craters
        that distort the map of the reference brightness.
    level_scatter_share, level_rim_share : float
        Standard deviation of the level of the ground that an edge is searched at, beside these two: shares of
        the scatter of the image's brightness (`ReferenceBrightness.scatter`) and of that of the levels found
        around the rim. It is a systematic error of place, axes and rotation, as large as the edges move with
        the level: small where the sun is low, and many times that where it is high. Fitted by
        `craternav_fg.calibration.rim_floor`.
    max_shift_px : float
        Largest common shift that is searched. Also searched when several rims are missing, whatever the
        prediction's covariance claims.
    shift_sigmas : float
        Searched radius in standard deviations of the predicted rims.
    min_found_share : float
        Minimum share of the searched normals with an edge.
    max_rms_px, max_rms_share : float
        Largest scatter of a rim's edge points: max_rms_px + max_rms_share b, b the semi-minor axis.
    first_reach_px, first_reach_share : float
        Half length of the normals that are searched before the pose is corrected with the rims:
        first_reach_px + first_reach_share b, b the semi-minor axis.
    second_reach_px, second_reach_share : float
        The same after it.
    map_error_sigmas : float
        Rims that are not found are searched again on normals that are longer by this many standard deviations
        of the catalogue's stated errors.
    recentrings : int
        Where the catalogue states errors, rims are searched again around the ellipses just fitted, at most so
        many times. How far the prediction pulls a rim: `craternav_fg.calibration.pull_of_prediction`.
    recentred_found_share : float
        Minimum share of the normals with an edge in these searches. With that of the first search, a third of
        the rims would drop out, hardly worse than the others.
    searches : int
        Where the catalogue states errors and `recentrings` is not 0, from how many places each rim is
        searched: where it was found first, and others around it.
    search_sigmas : float
        Distance of these from it, in standard deviations of the rim's place on the map.
    least_searches : int
        Number of the searches that must find a rim; at most all of them.
    gate_probability : float
        Probability with which a correct rim passes the chi-square gate.
    full_arc_share : float
        Share of a rim that its edge points must cover to be measured as an ellipse, if at least three rims of
        the frame reach it. The others are measured as arcs.
    edges : EdgeOptions
        Options of the edge points.
    fit : FitOptions
        Options of the ellipse fit, with the systematic floor and the expected deviation of outlines from
        ellipses.
    correlated_errors : CorrelatedErrorOptions
        Errors that are correlated over frames or over rims.
    arcs : ArcOptions
        Options of rims that are seen in part.
    sun : SunOptions
        Options of the sun's tilt.
    points : PointTrackOptions
        Options of points tracked from image to image; none by default.

    Raises
    ------
    ValueError
        When `searches` or `least_searches` is not positive.
    """

    min_semi_minor_px: float = 12.0
    margin_px: float = 3.0
    brightness_sigma_share: float = 0.02
    brightness_slope_per_px: float = 1e-4
    level_scatter_share: float = 0.09
    level_rim_share: float = 0.12
    max_shift_px: float = 48.0
    shift_sigmas: float = 3.5
    min_found_share: float = 0.55
    max_rms_px: float = 0.6
    max_rms_share: float = 0.05
    first_reach_px: float = 2.5
    first_reach_share: float = 0.12
    second_reach_px: float = 1.5
    second_reach_share: float = 0.08
    map_error_sigmas: float = 2.0
    recentrings: int = 3
    recentred_found_share: float = 0.4
    searches: int = 5
    search_sigmas: float = 1.0
    least_searches: int = 3
    gate_probability: float = 0.9999
    full_arc_share: float = 0.5
    edges: EdgeOptions = field(default_factory=EdgeOptions)
    fit: FitOptions = field(
        default_factory=lambda: FitOptions(floor_px=0.01, floor_share=0.0, outline_share=0.0003)
    )
    correlated_errors: CorrelatedErrorOptions = field(default_factory=CorrelatedErrorOptions)
    arcs: ArcOptions = field(default_factory=ArcOptions)
    sun: SunOptions = field(default_factory=SunOptions)
    points: PointTrackOptions = field(default_factory=PointTrackOptions)

    def __post_init__(self) -> None:
        for name in ("searches", "least_searches"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected 1 or more, found {getattr(self, name)}")


# For single images: shared errors matter where they do not average out over frames. In one image the
# covariance of the fit is consistent without them.
SINGLE_IMAGE = GuidedOptions(
    correlated_errors=CorrelatedErrorOptions(
        camera_shift_px=0.0,
        sun_shift_px=0.0,
        stretch_px=0.0,
        stretch_share=0.0,
        size_px=0.0,
        size_share=0.0,
        brightness_share=0.0,
    )
)
