"""Names of files and columns of a data set, with an example of each file.

Stamps are integer nanoseconds, of any epoch, the same in all files. Frames: g is the body-fixed frame,
b the lander's, which is the IMU's; in EuRoC's names R = g and S = b. Tables are CSV with a header, their
columns in any order; the unit in brackets may be left out. Files below `mav0` are as EuRoC has them.

`dataset.toml`: format, body, and the initial state with its standard deviations per axis (attitude: a
rotation vector in b). The stamp is that of the first image. The table [initial] may be left out when nothing
is known: the images must then show craters that can be identified::

    format_version = 1

    [body]
    name = "Moon"
    radius_m = 1737400.0                     # of the sphere above which heights count
    mu_m3_s2 = 4902800118000.0
    spin_rad_s = [0.0, 0.0, 2.6616995e-06]   # in g

    [initial]
    stamp_ns = 0
    position_m = [1612345.6, 752345.6, 23456.7]   # in g
    attitude_wxyz = [0.5, 0.5, -0.5, 0.5]         # gRb, Hamilton
    velocity_m_s = [321.0, -876.5, 1.25]          # relative to g, in g
    attitude_sigma_rad = 0.436
    position_sigma_m = 4000.0
    velocity_sigma_m_s = 5.0
    angular_velocity_sigma_rad_s = 0.0873
    gyro_bias_sigma_rad_s = 4.8e-06
    accelerometer_bias_sigma_m_s2 = 0.00294

The table [motion] says how the lander moves where there is no IMU, or no use of its accelerometer: `coast`,
`white_acceleration` or `white_jerk`, see `craternav_fg.motion.settings`. The angular velocity is that of the
gyro, or without an IMU random-walks from a prior. [initial] may then have angular_velocity_rad_s, its mean::

    [motion]
    model = "coast"
    acceleration_density_m_s2_sqrt_hz = 1e-05  # of what the gravity field lacks
    j2 = 0.0                                 # unnormalised; or gravity_field = "gravity.tab" (SHADR)
    c22 = 0.0
    rate_rad_s = [0.0, 0.0, 0.0]             # in b, inertial
    rate_sigma_rad_s = 0.01
    rate_walk_rad_s2_sqrt_hz = 1e-05

`craters.csv`: the catalogue, with the names of Robbins (2018), deg (longitude to the east, angle of the
major axis from local east towards north) and km (diameters). RIM_HEIGHT_M, of the rim's plane above
the sphere at its centre, may be left out; rims are then taken to lie on the sphere. BODY and BODY_RADIUS_M,
the same in all rows, may be there and must agree with dataset.toml then. Other
columns of the published file may be there and are not read::

    CRATER_ID,LAT_ELLI_IMG,LON_ELLI_IMG,DIAM_ELLI_MAJOR_IMG,DIAM_ELLI_MINOR_IMG,DIAM_ELLI_ANGLE_IMG,RIM_HEIGHT_M
    01-1-000002,60.81,183.047,27.32,26.98,81.36,12.5

PLACE_SIGMA_M, SIZE_SIGMA_SHARE and RIM_HEIGHT_SIGMA_M, all or none, say how far each rim may be off. A large
catalogue may be given as `craters.parquet` in its place, as `craternav catalog import` writes it.

`sun.csv`: unit vectors towards the sun in g; one row, or rows over all frames, interpolated between::

    #timestamp [ns],s_x,s_y,s_z
    0,0.8,0.6,0.0

`mav0/cam0/sensor.yaml`: the camera. T_BS is bTc, from camera axes (x right, y down, z along the optical
axis) to b; pixel (0, 0) is the centre of the top-left pixel. The distortion is OpenCV's: radial-tangential
with k1, k2, p1, p2 and, if there is one, k3; rational_polynomial with k1, k2, p1, p2, k3, k4, k5, k6; or
equidistant (a fisheye) with k1, k2, k3, k4. It must not fold inside the image. The width of the point-spread
function and the bits of the grey levels may be left out, and are then as here::

    sensor_type: camera
    T_BS:
      cols: 4
      rows: 4
      data: [0.0, -1.0, 0.0, 1.2, 1.0, 0.0, 0.0, -0.3, 0.0, 0.0, 1.0, 0.8, 0.0, 0.0, 0.0, 1.0]
    rate_hz: 0.25
    resolution: [1024, 1024]
    camera_model: pinhole
    intrinsics: [1267.24, 1267.24, 511.5, 511.5]   # fu, fv, cu, cv in px
    distortion_model: radial-tangential
    distortion_coefficients: [-0.12, 0.03, 0.0004, -0.0002]
    psf_sigma_px: 0.7
    bit_depth: 8

`mav0/cam0/data.csv`: the frames; the images, grey PNG, are in the folder data beside it: of 8 bits, or
of 16 when bit_depth is more than 8, the lowest bits used::

    #timestamp [ns],filename
    0,0.png
    4000000000,4000000000.png

`mav0/imu0/sensor.yaml`: the IMU at the origin of b, continuous-time densities in SI units. The folder may be
missing when dataset.toml has a table [motion]::

    sensor_type: imu
    T_BS:
      cols: 4
      rows: 4
      data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    rate_hz: 100.0
    gyroscope_noise_density: 2.04e-05
    gyroscope_random_walk: 8.08e-09
    accelerometer_noise_density: 0.000343
    accelerometer_random_walk: 4.9e-06

`mav0/imu0/data.csv`: mean angular velocity and specific force over the interval that ends at the stamp,
over all frames, in steps of at most 0.1 s::

    #timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],...
    10000000,0.00021,-0.0013,0.0004,-2.91,0.02,-1.13

`mav0/state_groundtruth_estimate0/data.csv` (optional): the truth, for comparison only::

    #timestamp,p_RS_R_x [m],...,q_RS_w [],...,v_RS_R_x [m s^-1],...,b_w_RS_S_x [rad s^-1],...

`mav0/state_apriori0/data.csv` (optional): a-priori states, such as an ephemeris, with the
columns of the truth; for comparison only. `sensor.yaml` beside it has their standard deviations per axis::

    sensor_type: apriori
    position_sigma_m: 1000.0
    attitude_sigma_rad: 0.002

`rims.parquet` (optional): measured rims, one row per rim; when it is there, no image is read. Columns:
`timestamp` (int64, a frame's), `crater_id` (string, in the catalogue), `chart` (5 doubles) and `covariance`
(25 doubles, row by row), see `craternav_fg.measurements.RimSet`. Optional are the roots of the correlated
parts of the covariance, row by row: `correlated` (5 x 5 doubles), `map_errors` (5 x 6 doubles),
`map_tilt` (5 x 2 doubles) and `shared` (5 x 8 doubles); the covariance of the white part in
estimators that fuse frames, where it is larger, `fused_white` (5 x 5 doubles); and how well the rim was seen
(doubles, all or none of them): `slope_contrast`, `found_share`, `arc_share`, `rms_px`, `outline_share`, see
`RimQuality`. An optional value may be null for all rims of a frame.

`arcs.parquet` (optional, beside it): edge points of rims that are seen in part, one row per rim. Columns:
`timestamp`, `crater_id`, `points_normalised` (a list of pairs of doubles, image coordinates),
`sigmas_normalised` (a list of doubles, one for each point) and, optionally, `correlated_sigma_normalised`
(double) and `shared` (5 x 8 doubles, as of rims), see `ArcSet`.

`sun_tilts.csv` (optional, beside it), at most one row for a frame: the tilt of the sun's direction along the
ground, its standard deviation, the image point, normalised, at which it holds, and the direction in g whose
image it is. Without the last three columns the direction is the sun's along the locally flat terrain amid
the frame's craters::

    #timestamp [ns],tilt_rad,sigma_rad,x_normalised,y_normalised,direction_x,direction_y,direction_z
    0,0.945,0.1745,0.0123,-0.0456,0.36,0.48,0.0
"""

from craternav_fg.tables import Column

FORMAT_VERSION = 1

DESCRIPTION = "dataset.toml"
CRATERS = "craters.csv"
LARGE_CRATERS = "craters.parquet"
SUN = "sun.csv"
GRAVITY = "gravity.tab"
RIMS = "rims.parquet"
ARCS = "arcs.parquet"
TILTS = "sun_tilts.csv"
CAMERA_SENSOR = "mav0/cam0/sensor.yaml"
CAMERA_DATA = "mav0/cam0/data.csv"
IMAGES = "mav0/cam0/data"
IMU_SENSOR = "mav0/imu0/sensor.yaml"
IMU_DATA = "mav0/imu0/data.csv"
APRIORI_SENSOR = "mav0/state_apriori0/sensor.yaml"
APRIORI = "mav0/state_apriori0/data.csv"
TRUTH = "mav0/state_groundtruth_estimate0/data.csv"

# Folder of the sensors, and those in it that every data set may have.
SENSORS = "mav0"
OWN_SENSORS = ("cam0", "imu0", "features0", "state_apriori0", "state_groundtruth_estimate0")
CONTENTS = (DESCRIPTION, CRATERS, LARGE_CRATERS, SUN, GRAVITY, RIMS, ARCS, TILTS, SENSORS)

STAMP = "timestamp"
_STAMP_NS = Column(STAMP, "integer", "ns")

CAMERA_COLUMNS = (_STAMP_NS, Column("filename", "text"))

GYRO = ("w_RS_S_x", "w_RS_S_y", "w_RS_S_z")
ACCELEROMETER = ("a_RS_S_x", "a_RS_S_y", "a_RS_S_z")
IMU_COLUMNS = (
    _STAMP_NS,
    *(Column(name, unit="rad s^-1") for name in GYRO),
    *(Column(name, unit="m s^-2") for name in ACCELEROMETER),
)

POSITION = ("p_RS_R_x", "p_RS_R_y", "p_RS_R_z")
ATTITUDE = ("q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z")
VELOCITY = ("v_RS_R_x", "v_RS_R_y", "v_RS_R_z")
BIAS = ("b_w_RS_S_x", "b_w_RS_S_y", "b_w_RS_S_z", "b_a_RS_S_x", "b_a_RS_S_y", "b_a_RS_S_z")
TRUTH_COLUMNS = (
    # EuRoC gives this stamp no unit; it is in nanoseconds all the same.
    Column(STAMP, "integer"),
    *(Column(name, unit="m") for name in POSITION),
    *(Column(name, unit="") for name in ATTITUDE),
    *(Column(name, unit="m s^-1") for name in VELOCITY),
    *(Column(name, unit="rad s^-1") for name in BIAS[:3]),
    *(Column(name, unit="m s^-2") for name in BIAS[3:]),
)

SUN_VECTOR = ("s_x", "s_y", "s_z")
SUN_COLUMNS = (_STAMP_NS, *(Column(name) for name in SUN_VECTOR))

TILT = ("tilt_rad", "sigma_rad")
# In normalised coordinates.
TILT_POINT = ("x_normalised", "y_normalised")
TILT_DIRECTION = ("direction_x", "direction_y", "direction_z")
TILT_COLUMNS = (
    _STAMP_NS,
    *(Column(name, unit="rad", former=former) for name, former in zip(TILT, ("tilt", "sigma"), strict=True)),
    *(Column(name, former=former) for name, former in zip(TILT_POINT, ("u", "v"), strict=True)),
    *(Column(name, optional=True) for name in TILT_DIRECTION),
)
