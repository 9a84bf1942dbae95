"""Tables of a scenario file and their keys."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from craternav_fg.camera import Camera
from craternav_fg.config import Positive, Section, Vector, or_former
from craternav_fg.frames import pose, rotation_exp
from craternav_fg.imu import ImuNoise
from craternav_fg.motion.settings import FORMER as _OF_MOTION

# Standard acceleration of gravity (CGPM 1901): the unit of accelerometers' data sheets.
STANDARD_GRAVITY_M_S2 = 9.80665

NotNegative = Annotated[float, Field(ge=0.0)]
# Former names of keys, by table and present name: files with them are read.
FORMER = {
    "craters": {
        "place_sigma_share": "place_sigma",
        "size_sigma_share": "size_sigma",
        "size_frequency_km": "size_frequency",
        "reach_altitudes": "reach",
        "separation_ratio": "separation",
    },
    "terrain": {"depth_scatter_share": "depth_scatter", "irregularity_share": "irregularity"},
    "render": {"flat_level_share": "flat_level", "vignetting_share": "vignetting"},
    "motion": _OF_MOTION,
    "faults": {
        "wrong_match_share": "wrong_matches",
        "map_place_share": "map_place",
        "map_size_share": "map_size",
        "map_height_share": "map_height",
        "time_offset_s": "image_delay_s",
    },
}
# Relative to the scenario file, or a key of the scenario's table [data].
FilePath = Annotated[str, Field(min_length=1)]


def _or_former(table: str, key: str) -> Any:
    """Describe a field that may stand under its former name."""
    return or_former(key, FORMER[table][key])


class CameraSection(Section):
    """Camera with square pixels and its principal point in the image's centre."""

    width_px: Annotated[int, Field(ge=16, le=16384)]
    height_px: Annotated[int, Field(ge=16, le=16384)]
    field_of_view_deg: Annotated[float, Field(gt=0.0, lt=170.0)]
    """Across the image's width, before distortion."""
    rotation_vector_deg: Vector
    """Camera-IMU extrinsics: rotation from the camera to b."""
    lever_arm_m: Vector
    """Camera-IMU extrinsics: position of the camera in b."""
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Coefficients of the lens as in OpenCV: k1, k2, p1, p2, k3, unless `lens_model` says otherwise."""
    lens_model: Literal["radial-tangential", "rational", "fisheye"] = "radial-tangential"
    """A rational lens takes k4, k5, k6 as well, a fisheye (Kannala-Brandt) k1, k2, k3, k4."""

    @model_validator(mode="after")
    def _does_not_fold(self) -> "CameraSection":
        self.camera()
        return self

    def camera(self) -> Camera:
        """Return the camera described."""
        focal_px = 0.5 * self.width_px / math.tan(0.5 * math.radians(self.field_of_view_deg))
        bTc = pose(rotation_exp(np.radians(self.rotation_vector_deg)), np.array(self.lever_arm_m))
        return Camera(
            width_px=self.width_px,
            height_px=self.height_px,
            fx_px=focal_px,
            fy_px=focal_px,
            cx_px=0.5 * (self.width_px - 1),
            cy_px=0.5 * (self.height_px - 1),
            bTc=bTc,
            distortion=self.distortion,
            lens_model=self.lens_model,
        )


class ImuSection(Section):
    """IMU at the origin of b, in the units of data sheets."""

    rate_hz: Annotated[float, Field(ge=10.0, le=10000.0)]
    gyro_arw_deg_sqrt_h: Positive
    """Angular random walk."""
    gyro_bias_deg_h: Positive
    """Standard deviation of the turn-on bias, per axis."""
    gyro_bias_walk_deg_h_sqrt_h: Positive
    """Standard deviation of the bias random walk after an hour."""
    accelerometer_noise_ug_sqrt_hz: Positive
    """Spectral density of the white noise."""
    accelerometer_bias_ug: Positive
    """Standard deviation of the turn-on bias, per axis."""
    accelerometer_bias_walk_ug_sqrt_h: Positive
    """Standard deviation of the bias random walk after an hour."""

    def noise(self) -> ImuNoise:
        """Return the densities in SI units."""
        micro_g = 1e-6 * STANDARD_GRAVITY_M_S2
        return ImuNoise(
            gyro_density_rad_s_sqrt_hz=math.radians(self.gyro_arw_deg_sqrt_h) / 60.0,
            accelerometer_density_m_s2_sqrt_hz=self.accelerometer_noise_ug_sqrt_hz * micro_g,
            gyro_walk_rad_s2_sqrt_hz=math.radians(self.gyro_bias_walk_deg_h_sqrt_h) / 3600.0 / 60.0,
            accelerometer_walk_m_s3_sqrt_hz=self.accelerometer_bias_walk_ug_sqrt_h * micro_g / 60.0,
        )

    @property
    def gyro_bias_rad_s(self) -> float:
        """Turn-on bias, rad/s."""
        return math.radians(self.gyro_bias_deg_h) / 3600.0

    @property
    def accelerometer_bias_m_s2(self) -> float:
        """Turn-on bias, m/s^2."""
        return self.accelerometer_bias_ug * 1e-6 * STANDARD_GRAVITY_M_S2


class Boundary(Section):
    """State at one end of the descent."""

    altitude_m: Positive
    downrange_m: float
    """Along the ground from the landing site, positive beyond it."""
    vertical_speed_m_s: float
    """Positive upwards."""
    ground_speed_m_s: float
    """Of the sub-lander point, along the heading."""
    vertical_acceleration_m_s2: float
    """Second derivative of the altitude."""
    ground_acceleration_m_s2: float
    """Derivative of the ground speed."""


class AttitudeSection(Section):
    """Attitude relative to the local level frame (x forward, y right, z down)."""

    start_pitch_deg: Annotated[float, Field(gt=-60.0, lt=60.0)]
    """From nadir, positive when z points ahead."""
    end_pitch_deg: Annotated[float, Field(gt=-60.0, lt=60.0)]
    oscillation_deg: Vector
    """Amplitudes about x, y and z."""
    oscillation_period_s: tuple[Positive, Positive, Positive]


class TrajectorySection(Section):
    """A descent along a great circle to the landing site."""

    site_latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    site_longitude_deg: Annotated[float, Field(ge=-180.0, le=360.0)]
    heading_deg: Annotated[float, Field(ge=-180.0, le=360.0)]
    """At the site, from north towards east."""
    duration_s: Positive
    frame_interval_s: Positive
    start: Boundary
    end: Boundary | None = None
    """Omitted if there is a table [motion], which determines the motion from the start."""
    attitude: AttitudeSection

    @model_validator(mode="after")
    def _has_frames(self) -> "TrajectorySection":
        if not 1e-3 <= self.frame_interval_s <= self.duration_s:
            raise ValueError(
                f"frame_interval_s {self.frame_interval_s} must be at least 0.001 and at most duration_s"
            )
        return self


class SunSection(Section):
    """Direction towards the sun at the landing site at the start of the descent."""

    elevation_deg: Annotated[float, Field(gt=0.0, lt=90.0)]
    azimuth_deg: Annotated[float, Field(ge=-180.0, le=360.0)]
    """From north towards east."""


class InitialErrorSection(Section):
    """Standard deviations of the initial state's error, per axis."""

    attitude_deg: Positive
    position_m: Positive
    velocity_m_s: Positive
    angular_velocity_deg_s: Positive


class RandomCraters(Section):
    """Craters drawn along the ground track."""

    source: Literal["random"]
    density: Positive
    """k of the size distribution: k r^-2 craters larger than r on a unit of area."""
    size_frequency_km: Annotated[
        tuple[tuple[Positive, Positive], ...], _or_former("craters", "size_frequency_km")
    ] = ()
    """In place of density: diameters, km, and numbers of larger craters per km^2. Interpolated and
    extrapolated by power laws."""
    min_apparent_px: Positive
    """Smallest semi-minor axis, seen from the lowest altitude at which the crater is in view."""
    max_apparent_px: Positive
    """Largest semi-major axis, seen from the highest altitude at which the crater is in view."""
    reach_altitudes: Annotated[Positive, _or_former("craters", "reach_altitudes")]
    """Half-width of the corridor along the ground track, in altitudes."""
    separation_ratio: Annotated[NotNegative, _or_former("craters", "separation_ratio")]
    """Smallest distance of centres over the sum of their semi-major axes; below 1 craters overlap."""
    min_axis_ratio: Annotated[float, Field(gt=0.2, le=1.0)]
    """Axis ratios b/a are uniform from here to 1."""
    clutter_px: tuple[Positive, Positive]
    """Smallest and largest apparent size of the craters that only the terrain has, not the catalogue."""

    @model_validator(mode="after")
    def _sizes_rise(self) -> "RandomCraters":
        for name, (small, large) in (
            ("apparent", (self.min_apparent_px, self.max_apparent_px)),
            ("clutter", self.clutter_px),
        ):
            if not small < large:
                raise ValueError(f"{name} sizes must rise, found {small} to {large}")
        table = np.array(self.size_frequency_km).reshape(-1, 2)
        if len(table) == 1 or np.any(np.diff(table[:, 0]) <= 0.0) or np.any(np.diff(table[:, 1]) >= 0.0):
            raise ValueError("size_frequency_km needs two rows or more, rising diameters and falling numbers")
        return self


class CraterFile(Section):
    """Craters of a catalogue file with Robbins' column names."""

    source: Literal["file"]
    path: Annotated[str, Field(min_length=1)]
    """Relative to the scenario file."""


class PublishedCraters(Section):
    """A published catalogue of the craters that the elevation model shows; it does not change the terrain."""

    source: Literal["published"]
    path: FilePath
    """Table that `catalog import` reads, or a catalogue that `craternav` wrote."""
    heights: FilePath | None = None
    """Elevation model for the heights of the rims, where the catalogue has none; in the unit `dem_unit_m` of
    [terrain]."""
    min_diameter_m: Positive
    """Smaller craters are excluded from the map."""
    reach_altitudes: Annotated[Positive, _or_former("craters", "reach_altitudes")]
    """Half-width of the corridor along the ground track whose craters are in the map, in altitudes."""
    place_sigma_m: NotNegative
    """Standard deviation of the positions per axis, where the catalogue states no errors."""
    place_sigma_share: Annotated[NotNegative, _or_former("craters", "place_sigma_share")]
    """The part of it that grows with the radius, as a share of the radius."""
    size_sigma_share: Annotated[NotNegative, _or_former("craters", "size_sigma_share")]
    """Standard deviation of the semi-axes, as a share of them, where the catalogue states no errors."""
    common_place_sigma_m: NotNegative = 0.0
    """Standard deviation per axis of a shift that all positions have in common, as above."""
    common_height_sigma_m: NotNegative = 0.0
    """The same of the heights of the rims."""
    density: Positive
    """k of the size distribution, k r^-2, of the craters that the elevation model does not resolve."""
    detail_px: tuple[Positive, Positive]
    """Smallest and largest apparent size of these."""


class Crater(Section):
    """One crater, positioned relative to the landing site."""

    east_m: float
    north_m: float
    semi_major_m: Positive
    semi_minor_m: Positive
    angle_deg: float
    """Of the major axis, from local east towards north."""
    height_m: float = 0.0
    """Of the rim above the reference sphere."""

    @model_validator(mode="after")
    def _axes_in_order(self) -> "Crater":
        if self.semi_minor_m > self.semi_major_m:
            raise ValueError(f"semi_minor_m {self.semi_minor_m} exceeds semi_major_m {self.semi_major_m}")
        return self


class CraterTrials(Section):
    """Variation of the listed craters from trial to trial of a Monte Carlo campaign."""

    place_sigma_m: NotNegative
    """Standard deviation of the positions, east and north."""
    semi_axes_m: tuple[Positive, Positive]
    """Both semi-axes are uniform between these, the orientation between 0 and 180 deg."""

    @model_validator(mode="after")
    def _axes_in_order(self) -> "CraterTrials":
        if not self.semi_axes_m[0] <= self.semi_axes_m[1]:
            raise ValueError(f"semi_axes_m must rise, found {self.semi_axes_m[0]} to {self.semi_axes_m[1]}")
        return self


class CraterList(Section):
    """Craters listed one by one."""

    source: Literal["list"]
    crater: Annotated[tuple[Crater, ...], Field(min_length=1)]
    trials: CraterTrials | None = None
    """If given, each trial draws its own craters; a simulation that is not a trial uses the listed ones."""


class TerrainSection(Section):
    """Terrain between and inside the craters."""

    slope: NotNegative
    """RMS slope that the octave of 100 m contributes along one axis."""
    hurst: Annotated[float, Field(gt=0.0, le=1.0)]
    """Hurst exponent: heights grow with the length to this power."""
    coarsest_m: Positive
    """Longest wavelength, rounded down to a power of two."""
    depth_scatter_share: Annotated[float, Field(ge=0.0, lt=1.0), _or_former("terrain", "depth_scatter_share")]
    """Largest share of the depth by which floors are raised at random."""
    irregularity_share: Annotated[
        float, Field(ge=0.0, le=0.1), _or_former("terrain", "irregularity_share")
    ] = 0.0
    """RMS deviation of the rims from their ellipses, as a share of the radius."""
    degradation: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Largest degradation, drawn at random: crests are rounded and floors filled; 1 leaves half of the
    depth."""
    dem: FilePath | tuple[FilePath, ...] | None = None
    """Elevation model, a GeoTIFF with heights above the reference sphere; or several, the finest first."""
    dem_unit_m: Positive = 1.0
    """Metres per unit of its values, and of those of [craters] `heights`."""
    peaks_from_m: Positive | None = None
    """Diameter from which craters have a central peak."""

    def models(self) -> tuple[str, ...]:
        """Return the paths of the elevation models, the finest first."""
        if self.dem is None:
            return ()
        return (self.dem,) if isinstance(self.dem, str) else self.dem


class HapkeSection(Section):
    """Hapke's law; see `craternav_fg.simulation.render.Hapke`."""

    single_scattering_albedo: Annotated[float, Field(gt=0.0, lt=1.0)]
    asymmetry: Annotated[float, Field(gt=-1.0, lt=1.0)]
    """Of the Henyey-Greenstein function: below 0 the grains scatter backwards."""
    opposition_amplitude: NotNegative
    opposition_width: Positive


class RenderSection(Section):
    """Illumination, optics and image sensor."""

    samples: Annotated[int, Field(ge=1, le=8)]
    """Rays along each side of a pixel."""
    lunar_lambert: Annotated[float, Field(ge=0.0, le=1.0)]
    """Share of the Lommel-Seeliger law; the rest is Lambert's."""
    sun_radius_deg: Positive
    """Angular radius of the sun."""
    flat_level_share: Annotated[float, Field(gt=0.0, lt=1.0), _or_former("render", "flat_level_share")]
    """Brightness of locally flat terrain at the site, as a share of full scale."""
    psf_sigma_px: NotNegative
    """Gaussian blur of the optics."""
    full_well_e: NotNegative
    """Electrons at full scale: fewer give more shot noise; 0 for no noise."""
    read_noise_e: NotNegative
    """Standard deviation of the read-out noise, electrons."""
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 8
    """Bits of the grey levels; more than 8 are stored in 16-bit images."""
    vignetting_share: Annotated[float, Field(ge=0.0, lt=1.0), _or_former("render", "vignetting_share")] = 0.0
    """Share of the light lost in the image's corners."""
    exposure_s: NotNegative = 0.0
    """Exposure time, for motion blur; the stamp of an image is the middle of the exposure."""
    hapke: HapkeSection | None = None
    """If given, the reflectance law instead of lunar_lambert."""


class MeasurementSection(Section):
    """Simulated measurements of rims and sun tilts in place of images."""

    edge_sigma_px: Positive
    """Of each edge point, across the edge."""
    points_per_rim: Annotated[int, Field(ge=6)]
    min_semi_minor_px: Positive
    """Smaller rims are not measured."""
    sun_tilt_sigma_deg: Positive


class FaultsSection(Section):
    """Faults that the data set does not state."""

    wrong_match_share: Annotated[float, Field(ge=0.0, lt=1.0), _or_former("faults", "wrong_match_share")] = (
        0.0
    )
    """Share of the measured rims that are matched to a wrong crater; not with images."""
    map_place_share: Annotated[NotNegative, _or_former("faults", "map_place_share")] = 0.0
    """Standard deviation of the catalogue's positions, east and north, as a share of the semi-major axis."""
    map_size_share: Annotated[NotNegative, _or_former("faults", "map_size_share")] = 0.0
    """Standard deviation of the catalogue's semi-axes, as a share of them."""
    map_height_share: Annotated[NotNegative, _or_former("faults", "map_height_share")] = 0.0
    """Standard deviation of the catalogue's rim heights, as a share of the semi-major axis."""
    mounting_deg: NotNegative = 0.0
    """Angle by which the camera is rotated from its mounting in the data set, about a random axis."""
    time_offset_s: Annotated[float, _or_former("faults", "time_offset_s")] = 0.0
    """Camera-IMU time offset: an image is exposed this much after its stamp."""
    outages_s: tuple[tuple[NotNegative, Positive], ...] = ()
    """Start and end times of intervals without images; the first image always exists."""
    craterless_s: tuple[tuple[NotNegative, Positive], ...] = ()
    """Start and end times of intervals without catalogued craters; not with images."""
    without_sun: bool = False
    """No sun tilt is measured; not with images."""

    @model_validator(mode="after")
    def _outages_last(self) -> "FaultsSection":
        for name in ("outages_s", "craterless_s"):
            for begin, end in getattr(self, name):
                if not begin < end:
                    raise ValueError(f"{name}: expected ends after beginnings, found {begin} to {end}")
        return self


class Spread(Section):
    """Mean and standard deviation of a figure over trials."""

    mean: NotNegative
    sd: Positive


class ExpectedSection(Section):
    """Results of an estimator over many trials, measured when the scenario was written."""

    position_rms_m: Spread | None = None
    anees: Spread | None = None
