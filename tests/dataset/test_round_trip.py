import shutil
import time
from dataclasses import fields, is_dataclass, replace

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset, SunVectors, layout, write_dataset
from craternav_fg.errors import InputError
from craternav_fg.measurements import RimQuality
from craternav_fg.tables import read_table, write_table
from tests.dataset.samples import FRAMES_NS, START_NS, random_images, random_measurements, recording


def exact(found, expected):
    np.testing.assert_array_equal(found, expected, strict=True)


def test_everything_reads_back_as_it_was(tmp_path):
    rng = np.random.default_rng(7)
    given, images = recording(rng), random_images(rng)
    write_dataset(tmp_path / "data", given, images)
    data = Dataset.open(tmp_path / "data")
    assert data.body == given.body
    camera = given.camera
    assert (data.camera.width_px, data.camera.height_px) == (64, 48)
    exact(data.camera.matrix, camera.matrix)
    exact(data.camera.bTc, camera.bTc)
    assert data.imu_noise == given.imu_noise
    exact(data.imu.stamps_ns, given.imu.stamps_ns)
    exact(data.imu.gyro_rad_s, given.imu.gyro_rad_s)
    exact(data.imu.accelerometer_m_s2, given.imu.accelerometer_m_s2)
    exact(data.stamps_ns, FRAMES_NS)
    exact(data.sun.vectors, given.sun.vectors)
    exact(data.truth.gP, given.truth.gP)
    exact(data.truth.gV, given.truth.gV)
    exact(data.truth.bias, given.truth.bias)
    exact(data.initial.gV, given.initial.gV)
    # Matrices become quaternions, radians degrees: equal to rounding.
    np.testing.assert_allclose(data.truth.gRb, given.truth.gRb, rtol=0.0, atol=4e-16)
    np.testing.assert_allclose(data.initial.gTb, given.initial.gTb, rtol=1e-15, atol=4e-16)
    for name in ("position_sigma_m", "attitude_sigma_rad", "gyro_bias_sigma_rad_s", "stamp_ns"):
        assert getattr(data.initial, name) == getattr(given.initial, name)
    assert data.catalog.identifiers == given.catalog.identifiers
    for name in ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", "height_m"):
        np.testing.assert_allclose(
            getattr(data.catalog, name), getattr(given.catalog, name), rtol=4e-16, atol=0.0
        )
    assert data.measurements is None
    for k, image in enumerate(images):
        exact(data.image(k), image)


def test_a_camera_that_distorts_reads_back_as_it_was(tmp_path):
    """With grey levels of more than eight bits, and a third radial term or none."""
    for k, k3 in enumerate((0.0, 1.0 / 3.0)):
        rng = np.random.default_rng(8)
        given = recording(rng)
        lens = (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, k3)
        camera = replace(given.camera, distortion=lens, psf_sigma_px=0.1 + 0.7, bit_depth=12)
        images = [rng.integers(0, 4096, (48, 64), dtype=np.uint16) for _ in FRAMES_NS]
        write_dataset(tmp_path / f"{k}", replace(given, camera=camera), images)
        data = Dataset.open(tmp_path / f"{k}")
        assert data.camera.distortion == lens
        assert data.camera.psf_sigma_px == camera.psf_sigma_px
        assert data.camera.full_scale == 4095
        exact(data.camera.lens, camera.lens)
        for i, image in enumerate(images):
            exact(data.image(i), image)


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("rational", (0.1, -0.02, 1e-3, 0.0, 0.0, 0.2, 0.01, 1.0 / 3.0)),
        ("fisheye", (0.01, 0.0, 1.0 / 3.0, 0.0)),
    ],
)
def test_a_wide_lens_reads_back_as_it_was(tmp_path, model, distortion):
    rng = np.random.default_rng(8)
    given = recording(rng)
    camera = replace(given.camera, distortion=distortion, lens_model=model)
    write_dataset(tmp_path / "data", replace(given, camera=camera), list(np.zeros((3, 48, 64), np.uint8)))
    data = Dataset.open(tmp_path / "data")
    assert (data.camera.lens_model, data.camera.distortion) == (model, distortion)
    exact(data.camera.lens, camera.lens)


def test_images_in_colour_are_read_as_their_luma(tmp_path):
    rng = np.random.default_rng(10)
    images = [rng.integers(0, 256, (48, 64), dtype=np.uint8) for _ in range(3)]
    data = Dataset.open(write_dataset(tmp_path / "data", recording(rng), images))
    assert data.in_colour == 0
    colour = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    cv2.imwrite(str(data.image_paths[1]), colour[:, :, ::-1])
    opaque = np.dstack([images[2]] * 3 + [np.full((48, 64), 255, np.uint8)])
    cv2.imwrite(str(data.image_paths[2]), opaque)
    data = Dataset.open(data.path)
    assert data.in_colour == 2
    exact(data.image(0), images[0])
    np.testing.assert_allclose(data.image(1), colour @ np.array([0.299, 0.587, 0.114]), atol=0.55)
    exact(data.image(2), images[2])


def test_a_crater_that_the_catalogue_has_twice_is_read_once(tmp_path):
    rng = np.random.default_rng(11)
    given = recording(rng)
    twice = replace(given.catalog.take(np.array([1])), identifiers=("again",))
    given = replace(given, catalog=Catalog.joined([given.catalog, twice]))
    images = list(np.zeros((3, 48, 64), np.uint8))
    data = Dataset.open(write_dataset(tmp_path / "data", given, images))
    assert data.repeated_craters == ("again",)
    assert "again" not in data.catalog.identifiers
    assert len(data.catalog) == len(given.catalog) - 1


def test_grey_levels_beyond_the_cameras_bits_are_refused(tmp_path):
    rng = np.random.default_rng(9)
    given = recording(rng)
    images = [np.full((48, 64), level, np.uint16) for level in (1023, 1023, 1024)]
    given = replace(given, camera=replace(given.camera, bit_depth=10))
    data = Dataset.open(write_dataset(tmp_path / "data", given, images))
    data.image(0)
    with pytest.raises(InputError, match=r"grey levels of 10 bits, found 1024"):
        data.image(2)


def test_a_copy_of_what_was_read_reads_the_same(with_images, tmp_path):
    """What a second process reads is what the first one read: no digit is lost on the way."""
    first = Dataset.open(with_images)
    second = Dataset.open(shutil.copytree(with_images, tmp_path / "copy"))
    exact(second.initial.gTb, first.initial.gTb)
    exact(second.catalog.axes, first.catalog.axes)
    exact(second.truth.gTb, first.truth.gTb)


def exact_all(found, expected):
    """Compare all that a dataclass holds, whatever fields it may get."""
    if is_dataclass(expected):
        assert type(found) is type(expected)
        for field in fields(expected):
            exact_all(getattr(found, field.name), getattr(expected, field.name))
    elif isinstance(expected, tuple):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            exact_all(one, other)
    elif isinstance(expected, np.ndarray):
        exact(found, expected)
    else:
        assert found == expected


def test_measurements_read_back_as_they_were(tmp_path):
    rng = np.random.default_rng(8)
    given, measured = recording(rng), random_measurements(rng)
    write_dataset(tmp_path / "data", replace(given, measurements=measured))
    data = Dataset.open(tmp_path / "data")
    assert len(data) == 3
    exact_all(data.measurements, measured)
    again = write_dataset(tmp_path / "again", data)
    exact_all(Dataset.open(again).measurements, measured)


@pytest.mark.parametrize("count", [2, 6, 8])
def test_errors_of_the_map_and_tilts_survive(tmp_path, count):
    rng = np.random.default_rng(9)
    given, measured = recording(rng), random_measurements(rng)
    root = 1e-4 * rng.standard_normal((2, 5, count))
    rims = measured[2].rims
    wider = replace(rims, of_map=root, covariance=rims.covariance + root @ np.swapaxes(root, 1, 2))
    measured = (*measured[:2], replace(measured[2], rims=wider))
    write_dataset(tmp_path / "data", replace(given, measurements=measured))
    exact_all(Dataset.open(tmp_path / "data").measurements, measured)


def test_the_height_of_earlier_files_is_an_error_of_the_map(tmp_path):
    rng = np.random.default_rng(9)
    given, measured = recording(rng), random_measurements(rng)
    root = np.zeros((2, 5, 6))
    root[:, :, 2] = 1e-4 * rng.standard_normal((2, 5))
    rims = measured[2].rims
    wider = replace(rims, of_map=root, covariance=rims.covariance + root @ np.swapaxes(root, 1, 2))
    measured = (*measured[:2], replace(measured[2], rims=wider))
    path = write_dataset(tmp_path / "data", replace(given, measurements=measured)) / "rims.parquet"
    table = pq.read_table(path)
    heights = [None if row is None else row[2::6] for row in table["map_errors"].to_pylist()]
    table = table.drop_columns(["map_errors"]).append_column("correlated_height", pa.array(heights))
    pq.write_table(table, path)
    exact_all(Dataset.open(path.parent).measurements, measured)


def test_rims_are_read_in_the_catalogues_order(tmp_path):
    rng = np.random.default_rng(8)
    given, measured = recording(rng), random_measurements(rng)
    turned = tuple(replace(f, rims=f.rims.take(np.arange(len(f.rims))[::-1])) for f in measured)
    write_dataset(tmp_path / "data", replace(given, measurements=turned))
    exact_all(Dataset.open(tmp_path / "data").measurements, measured)


def without_columns(path, *names):
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(list(names)), path)


def test_files_of_version_0_1_are_read(rims_folder):
    """They have no arcs, no quality, no direction of the tilt, and call the correlated part persistent."""
    expected = Dataset.open(rims_folder.path).measurements
    rims, tilts = rims_folder.path / layout.RIMS, rims_folder.path / layout.TILTS
    without_columns(rims, *(field.name for field in fields(RimQuality)))
    table = pq.read_table(rims)
    names = ["persistent" if name == "correlated" else name for name in table.column_names]
    pq.write_table(table.rename_columns(names), rims)
    (rims_folder.path / layout.ARCS).unlink()
    rows = [line.split(",")[:5] for line in tilts.read_text().splitlines()]
    tilts.write_text("".join(",".join(row) + "\n" for row in rows))
    data = Dataset.open(rims_folder.path)
    for found, whole in zip(data.measurements, expected, strict=True):
        exact_all(found.rims, replace(whole.rims, quality=None))
        assert len(found.arcs) == 0
        assert (found.sun is None) == (whole.sun is None)
        if found.sun is not None:
            assert (found.sun.tilt_rad, found.sun.sigma_rad) == (-3.0, 0.17)
            exact(found.sun.point, whole.sun.point)
            # Along the ground below the craters seen, or below the initial position.
            craters = found.rims.craters
            up = data.catalog.normals[craters].sum(axis=0) if len(craters) else data.initial.gTb[:3, 3]
            assert abs(found.sun.direction @ up) < 1e-6 * np.linalg.norm(up)
            # Still towards the sun.
            assert found.sun.direction @ data.sun.at(found.stamp_ns) > 0.0


def test_charts_and_covariances_alone_are_enough(rims_folder):
    expected = Dataset.open(rims_folder.path).measurements
    path = rims_folder.path / layout.RIMS
    pq.write_table(pq.read_table(path, columns=["timestamp", "crater_id", "chart", "covariance"]), path)
    for found, whole in zip(Dataset.open(rims_folder.path).measurements, expected, strict=True):
        exact_all(
            found.rims, replace(whole.rims, quality=None, correlated=None, shared=None, fused_white=None)
        )
        exact_all(found.arcs, whole.arcs)


def test_how_well_the_camera_is_known_survives(tmp_path):
    rng = np.random.default_rng(7)
    given = recording(rng)
    names = ("focal_sigma_percent", "principal_sigma_px", "lever_arm_sigma_m", "mounting_sigma_deg")
    for values in ((0.3, None, 0.0, None), (None, 0.0, None, 0.1), (0.0, 2.5, 0.02, 0.0)):
        sigmas = dict(zip(names, values, strict=True))
        camera = replace(given.camera, **sigmas)
        write_dataset(tmp_path / "data", replace(given, camera=camera), random_images(rng))
        found = Dataset.open(tmp_path / "data").camera
        assert tuple(getattr(found, name) for name in names) == values


def test_truth_at_other_times_is_interpolated(folder):
    stamps = START_NS + np.arange(-1, 6) * 90_000_000
    t = (stamps - START_NS) * 1e-9
    angle = 0.3 * t
    columns = [stamps, 2e6 + 10.0 * t**2, 5.0 * t, np.zeros_like(t)]
    columns += [np.cos(angle / 2), np.sin(angle / 2), 0 * t, 0 * t]
    columns += [20.0 * t, np.full_like(t, 5.0), 0 * t, *([0.01 * t] * 6)]
    write_table(folder.path / layout.TRUTH, layout.TRUTH_COLUMNS, columns)
    truth = Dataset.open(folder.path).truth
    at = (FRAMES_NS - START_NS) * 1e-9
    np.testing.assert_array_equal(truth.stamps_ns, FRAMES_NS)
    np.testing.assert_allclose(truth.gP[:, 0] - 2e6, 10.0 * at**2, atol=1e-8)
    np.testing.assert_allclose(truth.gV[:, 0], 20.0 * at, atol=1e-6)
    np.testing.assert_allclose(truth.gRb[:, 2, 1], np.sin(0.3 * at), atol=1e-12)
    np.testing.assert_allclose(truth.bias[:, 5], 0.01 * at, atol=1e-12)


@pytest.mark.parametrize(("last_s", "accepted"), [(30.1, True), (30.2, False)])
def test_states_are_not_interpolated_over_long_gaps(folder, last_s, accepted):
    """The second frame, 0.2 s after the first, lies in a gap from 0.1 s after it."""
    seconds = np.array([0.0, 0.1, last_s])
    zero = 0 * seconds
    columns = [START_NS + np.round(1e9 * seconds).astype(np.int64), 2e6 + zero, zero, zero, 1 + zero]
    write_table(folder.path / layout.TRUTH, layout.TRUTH_COLUMNS, columns + 12 * [zero])
    if accepted:
        assert Dataset.open(folder.path).truth is not None
        return
    with pytest.raises(InputError) as caught:
        Dataset.open(folder.path)
    begin, end = columns[0][1:]
    assert f"{layout.TRUTH}:4: timestamp: " in str(caught.value)
    assert f"around frame {FRAMES_NS[1]}, found a gap of 30.100 s from {begin} to {end}" in str(caught.value)


def test_truth_is_optional(folder):
    (folder.path / layout.TRUTH).unlink()
    assert Dataset.open(folder.path).truth is None


def test_files_as_euroc_writes_them_are_read(folder):
    """CRLF, OpenCV's YAML directive, exponents without a point, spaces in the header."""
    folder.edit(layout.IMU_SENSOR, "sensor_type", "%YAML:1.0\nsensor_type")
    folder.edit(layout.IMU_SENSOR, "1.0e-09", "1e-09")
    path = folder.path / layout.TRUTH
    header, *rows = path.read_text().splitlines()
    path.write_bytes("\r\n".join([header.replace(",", ", "), *rows, ""]).encode())
    data = Dataset.open(folder.path)
    assert data.imu_noise.gyro_walk_rad_s2_sqrt_hz == 1e-9
    assert len(data.truth) == 3


def test_one_sun_vector_holds_throughout(folder):
    folder.edit_line(layout.SUN, 3, lambda cells: [])
    sun = Dataset.open(folder.path).sun
    exact(sun.at(FRAMES_NS[0] - 10**12), sun.at(FRAMES_NS[2] + 10**12))


def test_the_sun_between_two_rows_is_between_them():
    sun = SunVectors(np.array([0, 100]), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(sun.at(50), [np.sqrt(0.5), np.sqrt(0.5), 0.0])
    exact(sun.at(0), sun.vectors[0])
    exact(sun.at(100), sun.vectors[1])


def test_an_interrupted_write_leaves_nothing(tmp_path):
    rng = np.random.default_rng(9)

    def images():
        yield from random_images(rng)[:2]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_dataset(tmp_path / "data", recording(rng), images())
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_write_leaves_the_old_data_set(folder):
    before = sorted(p.name for p in folder.path.rglob("*"))
    rng = np.random.default_rng(9)

    def images():
        yield from random_images(rng)[:1]
        raise RuntimeError("disk full")

    with pytest.raises(RuntimeError, match="disk full"):
        write_dataset(folder.path, recording(rng), images())
    assert sorted(p.name for p in folder.path.rglob("*")) == before
    assert [p.name for p in folder.path.parent.iterdir()] == [folder.path.name]
    Dataset.open(folder.path)


def test_a_folder_of_somebody_else_is_not_overwritten(tmp_path):
    rng = np.random.default_rng(9)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"holds no dataset\.toml"):
        write_dataset(tmp_path, recording(rng), random_images(rng))
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_images_and_rims_exclude_each_other(tmp_path):
    rng = np.random.default_rng(9)
    with pytest.raises(ValueError, match="either"):
        write_dataset(tmp_path / "data", recording(rng))


def processor_time_s(read):
    """Least of three."""
    times = []
    for _ in range(3):
        begin = time.process_time()
        read()
        times.append(time.process_time() - begin)
    return min(times)


def test_a_long_imu_log_is_not_read_row_by_row(tmp_path):
    """Not slower than numpy's compiled reader; a loop over the rows takes many times as long."""
    n = 60_000
    rng = np.random.default_rng(10)
    path = tmp_path / "data.csv"
    columns = [10_000_000 * np.arange(n), *rng.standard_normal((6, n))]
    write_table(path, layout.IMU_COLUMNS, columns, comment=True)
    assert len(read_table(path, layout.IMU_COLUMNS)) == n
    ours_s = processor_time_s(lambda: read_table(path, layout.IMU_COLUMNS))
    assert ours_s < 2.0 * processor_time_s(lambda: np.loadtxt(path, delimiter=","))


@pytest.mark.parametrize(
    ("text", "list_of"),
    [
        (pa.large_string(), pa.large_list),
        (pa.string_view(), pa.list_),
        (pa.dictionary(pa.int32(), pa.string()), pa.list_),
    ],
)
def test_rims_of_other_writers_are_read(rims_folder, text, list_of):
    """Pandas and polars write texts in other forms, and lists of free length."""

    def free(kind):
        return list_of(free(kind.value_type)) if pa.types.is_nested(kind) else kind

    expected = Dataset.open(rims_folder.path).measurements
    for name in (layout.RIMS, layout.ARCS):
        table = pq.read_table(rims_folder.path / name)
        kinds = [text if pa.types.is_string(one.type) else free(one.type) for one in table.schema]
        columns = [
            pa.array(column.to_pylist(), kind) for column, kind in zip(table.columns, kinds, strict=True)
        ]
        pq.write_table(pa.table(columns, names=table.column_names), rims_folder.path / name)
    for found, frame in zip(Dataset.open(rims_folder.path).measurements, expected, strict=True):
        exact(found.rims.chart, frame.rims.chart)
        exact(found.rims.craters, frame.rims.craters)
        exact(found.rims.uncorrelated_covariance, frame.rims.uncorrelated_covariance)
        assert [points.tolist() for points in found.arcs.points] == [p.tolist() for p in frame.arcs.points]
