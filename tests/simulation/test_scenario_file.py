import re
from importlib.resources import files

import numpy as np
import pytest

from craternav_fg.errors import InputError
from craternav_fg.simulation.scenario_file import Scenario, built_in_scenarios, load_scenario
from craternav_fg.simulation.scenario_tables import FORMER

DEMO = files("scenarios").joinpath("lunar_descent.toml").read_text()
CASE3 = files("scenarios").joinpath("paper_case3.toml").read_text()
MEASUREMENTS = re.findall(r"(?s)\[measurements\].*?(?=\n\[)", CASE3)[0]

# What to change in a scenario, and what the error must say.
CASES = {
    "distortion that folds": (
        DEMO,
        r"lever_arm_m = \[1.2.*",
        "lever_arm_m = [0.0, 0.0, 0.0]\ndistortion = [-1.0, 0.0, 0.0, 0.0, 0.0]",
        ["camera", "folds inside the image"],
    ),
    "sizes that do not fall": (
        DEMO,
        r"density = ",
        "size_frequency_km = [[1.0, 0.1], [2.0, 0.2]]\ndensity = ",
        ["craters", "size_frequency_km", "falling numbers"],
    ),
    "grains that swallow nothing": (
        DEMO,
        r"\Z",
        "[render.hapke]\nsingle_scattering_albedo = 1.0\nasymmetry = 0.0\n"
        "opposition_amplitude = 0.0\nopposition_width = 0.1\n",
        ["render.hapke.single_scattering_albedo", "less than 1"],
    ),
    "unknown key": (DEMO, r"width_px = ", "width = ", ["camera.width", "unknown key"]),
    "unknown table": (DEMO, r"\[sun\]", "[moon]", ["moon", "unknown key"]),
    "key missing": (DEMO, r"duration_s = 300.0", "", ["trajectory.duration_s", "missing"]),
    "text for a number": (DEMO, r"rate_hz = 100.0", 'rate_hz = "100"', ["imu.rate_hz", "number", '"100"']),
    "number with a point for a count": (DEMO, r"1024 ", "1024.5 ", ["camera.width_px", "integer", "1024.5"]),
    "number for a table": (DEMO, r"\[sun\]", "[sky]\n[[sun]]", ["sky", "unknown key"]),
    "out of range": (DEMO, r"elevation_deg = 30.0", "elevation_deg = -3.0", ["sun.elevation_deg", "-3.0"]),
    "infinite": (DEMO, r"duration_s = 300.0", "duration_s = inf", ["trajectory.duration_s", "finite"]),
    "nested": (
        DEMO,
        r"ground_speed_m_s = 1000.0",
        "ground_speed_m_s = []",
        ["trajectory.start.ground_speed"],
    ),
    "two numbers for three": (DEMO, r"\[2.0, 1.5, 3.0\]", "[2.0, 1.5]", ["attitude.oscillation_deg"]),
    "craters from nowhere": (DEMO, r'source = "random"', 'source = "sky"', ["craters", "sky"]),
    "craters without source": (DEMO, r'source = "random"', "", ["craters"]),
    "key of another source": (DEMO, r"separation_ratio = ", "path = ", ["craters.path", "unknown key"]),
    "axes of a crater": (
        CASE3,
        r"semi_minor_m = 1800.0",
        "semi_minor_m = 2300.0",
        ["craters.crater.1", "2300"],
    ),
    "neither images nor rims": (CASE3, re.escape(MEASUREMENTS), "", ["either"]),
    "images without terrain": (DEMO, r"(?s)\[terrain\].*(?=\[render\])", "", ["[terrain]"]),
    "images and rims": (
        DEMO,
        r"\Z",
        "[measurements]\n" + CASE3.split("[measurements]")[1].split("[craters]")[0],
        ["either"],
    ),
    "no TOML": (DEMO, r"seed = ", "seed ", ["TOML", "line 3"]),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_scenario_is_named(case, tmp_path):
    text, old, new, expected = CASES[case]
    path = tmp_path / "case.toml"
    spoilt, count = re.subn(old, lambda _: new, text, count=1)
    assert count == 1
    path.write_text(spoilt)
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    for part in expected:
        assert part in message


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("width_px = 1024", "width = 1024", "camera.width"),
        ("vertical_speed_m_s = -40.0", "vertical_speed_m_s = true", "trajectory.end.vertical_speed_m_s"),
        ("density = 0.0", "density = -0.0", "craters.density"),
    ],
)
def test_the_line_is_told(old, new, key, tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(DEMO.replace(old, new))
    line = path.read_text().splitlines().index(next(x for x in path.read_text().splitlines() if new in x)) + 1
    with pytest.raises(InputError, match=re.escape(f"case.toml:{line}: {key}: ")):
        load_scenario(path)


@pytest.mark.parametrize("name", sorted(built_in_scenarios()))
def test_built_in_scenarios_load_and_name_every_source(name):
    assert isinstance(load_scenario(name), Scenario)
    for line in built_in_scenarios()[name].read_text().splitlines():
        assert line.startswith(("[", "#")) or not line or re.search(r"  # \w", line), f"{line}: no source"


def test_the_scenarios_of_the_contract_are_there():
    assert {"lunar_descent", "paper_case3"} <= set(built_in_scenarios())


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match=r"mars_descent: .*lunar_descent, .*paper_case3"):
        load_scenario("mars_descent")


def test_a_missing_file():
    with pytest.raises(InputError, match=r"mars\.toml: file is missing"):
        load_scenario("mars.toml")


def test_a_crater_file_is_relative_to_the_scenario(tmp_path):
    text = re.sub(
        r"(?s)\[craters\].*?(?=\n\[terrain\])", '[craters]\nsource = "file"\npath = "a/b.csv"\n', DEMO
    )
    (tmp_path / "case.toml").write_text(text)
    craters = load_scenario(tmp_path / "case.toml").craters
    assert craters.path == str(tmp_path / "a" / "b.csv")


def test_data_sheet_units():
    """LN-200S class figures in SI units, worked by hand."""
    imu = load_scenario("lunar_descent").imu
    noise = imu.noise()
    assert noise.gyro_density_rad_s_sqrt_hz == pytest.approx(2.036e-5, rel=1e-3)
    assert noise.accelerometer_density_m_s2_sqrt_hz == pytest.approx(3.432e-4, rel=1e-3)
    assert imu.gyro_bias_rad_s == pytest.approx(4.848e-6, rel=1e-3)
    assert imu.accelerometer_bias_m_s2 == pytest.approx(2.942e-3, rel=1e-3)
    # In an hour the walk gains what its name says.
    assert np.degrees(noise.gyro_walk_rad_s2_sqrt_hz * 60.0) * 3600.0 == pytest.approx(
        imu.gyro_bias_walk_deg_h_sqrt_h
    )


def test_the_camera_sees_its_field_of_view():
    camera = load_scenario("paper_case3").camera.camera()
    edges = np.array([[-0.5, 511.5], [1023.5, 511.5]])
    angles = np.degrees(np.arctan(camera.normalised(edges)[:, 0]))
    assert angles == pytest.approx([-22.0, 22.0])
    # Optical axis along b's z; the top of the image (-y) looks along b's x.
    assert camera.bTc[:3, 2] == pytest.approx([0.0, 0.0, 1.0])
    assert -camera.bTc[:3, 1] == pytest.approx([1.0, 0.0, 0.0])


def write(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


def test_a_scenario_with_a_base_is_the_base_but_for_what_it_says(tmp_path):
    path = write(tmp_path, "a.toml", 'base = "lunar_descent"\n[trajectory.start]\naltitude_m = 60000.0\n')
    base, case = load_scenario("lunar_descent"), load_scenario(path)
    assert case.trajectory.start.altitude_m == 60000.0
    start = base.trajectory.start.model_copy(update={"altitude_m": 60000.0})
    trajectory = base.trajectory.model_copy(update={"start": start})
    assert case == base.model_copy(update={"trajectory": trajectory})


def test_a_base_may_stand_beside_and_have_a_base_and_rims_take_the_place_of_images(tmp_path):
    write(tmp_path, "b.toml", f'base = "lunar_descent"\n{MEASUREMENTS}\n')
    case = load_scenario(write(tmp_path, "a.toml", 'base = "b.toml"\nseed = 9\n'))
    assert case.seed == 9
    assert case.render is None
    assert case.measurements == load_scenario("paper_case3").measurements


@pytest.mark.parametrize(
    ("base", "table", "present", "former"),
    [
        (base, table, present, former)
        for table, base in (
            ("craters", "gld100_mare"),
            ("craters", "lunar_descent"),
            ("faults", "measured_descent"),
            ("terrain", "lunar_descent"),
            ("render", "lunar_descent"),
            ("motion", "orbit_coast"),
        )
        for present, former in FORMER[table].items()
        if present in type(getattr(load_scenario(base), table)).model_fields
    ],
)
def test_keys_have_former_names(base, table, present, former, tmp_path):
    """A file with either name is read, and so is one whose base has the other name; none has both."""
    table_of_sizes = "size_frequency" in former
    values = (
        ("[[1.0, 0.2], [2.0, 0.1]]", "[[1.0, 0.3], [2.0, 0.1]]") if table_of_sizes else ("0.015", "0.025")
    )

    def read(name, text):
        found = getattr(getattr(load_scenario(write(tmp_path, name, text)), table), present)
        return found[0][1] if table_of_sizes else found

    for key in (present, former):
        text = f'base = "{base}"\n[{table}]\n{key} = {values[0]}\n'
        assert read(f"{key}.toml", text) == (0.2 if table_of_sizes else 0.015)
    for key, other in ((present, former), (former, present)):
        text = f'base = "{other}.toml"\n[{table}]\n{key} = {values[1]}\n'
        assert read("a.toml", text) == (0.3 if table_of_sizes else 0.025)
    both = f'base = "{base}"\n[{table}]\n{former} = {values[0]}\n{present} = {values[0]}\n'
    problem = rf"a\.toml:3: {table}\..*{former}: is the former name of {present}, which is given, too"
    with pytest.raises(InputError, match=problem):
        read("a.toml", both)


def test_a_former_name_where_there_is_no_such_key_is_unknown(tmp_path):
    """It is not said to be given twice."""
    text = 'base = "lunar_descent"\n[sun]\nreach = 1.0\n'
    with pytest.raises(InputError, match=r"a\.toml:3: sun\.reach: unknown key"):
        load_scenario(write(tmp_path, "a.toml", text))


def test_an_error_names_the_key_of_the_file(tmp_path):
    text = 'base = "measured_descent"\n[faults]\nimage_delay_s = "0.01"\n'
    with pytest.raises(InputError, match=r"a\.toml:3: faults\.(time_offset_s|image_delay_s): .*number"):
        load_scenario(write(tmp_path, "a.toml", text))
    both = 'base = "measured_descent"\n[faults]\nimage_delay_s = 0.01\ntime_offset_s = 0.01\n'
    with pytest.raises(
        InputError,
        match=r"b\.toml:3: faults\.image_delay_s: is the former name of time_offset_s, which is given",
    ):
        load_scenario(write(tmp_path, "b.toml", both))


def test_paths_are_relative_to_the_file_that_has_them(tmp_path):
    (tmp_path / "below").mkdir()
    craters = '[craters]\nsource = "file"\npath = "map.csv"\n'
    base = f'base = "lunar_descent"\n{craters}[terrain]\ndem = ["a.tif", "public.tif"]\n'
    write(tmp_path, "base.toml", base)
    # The derived file's table [data] holds for a path of its base, too.
    text = 'base = "../base.toml"\nseed = 9\n[data]\n"public.tif" = "a product"\n'
    case = load_scenario(write(tmp_path / "below", "a.toml", text))
    assert case.craters.path == str(tmp_path / "map.csv")
    assert case.terrain.models() == (str(tmp_path / "a.tif"), "public.tif")
    text = 'base = "../base.toml"\n[terrain]\ndem = "b.tif"\n'
    case = load_scenario(write(tmp_path / "below", "b.toml", text))
    assert case.craters.path == str(tmp_path / "map.csv")
    assert case.terrain.models() == (str(tmp_path / "below" / "b.tif"),)


def test_a_scenario_that_is_its_own_base_by_another_path_is_refused(tmp_path):
    path = write(tmp_path, "a.toml", f'base = "../{tmp_path.name}/a.toml"\n')
    with pytest.raises(InputError, match="is its own base"):
        load_scenario(path)


def test_craters_of_another_source_replace_the_base_s(tmp_path):
    text = 'base = "lunar_descent"\n[craters]\nsource = "file"\npath = "map.csv"\n'
    craters = load_scenario(write(tmp_path, "a.toml", text)).craters
    assert craters.path == str(tmp_path / "map.csv")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('base = "a.toml"\n', ["a.toml", "its own base"]),
        ('base = "nowhere"\n', ["nowhere", "lunar_descent"]),
        ("base = 3\n", ["a.toml", "base", "3"]),
        ('base = "lunar_descent"\n[sun]\nelevation_deg = -3.0\n', ["a.toml:3", "sun.elevation_deg", "-3.0"]),
        ('base = "lunar_descent"\n[faults]\nwrong_matches = 0.1\n', ["a.toml", "measurements"]),
        (
            'base = "lunar_descent"\n[faults]\noutages_s = [[5.0, 2.0]]\n',
            ["a.toml:2", "outages_s", "5.0 to 2.0"],
        ),
    ],
)
def test_what_is_wrong_with_a_base_or_on_top_of_it_is_told(tmp_path, text, told):
    with pytest.raises(InputError) as error:
        load_scenario(write(tmp_path, "a.toml", text))
    for part in told:
        assert part in str(error.value)
