"""The reproduced figures against figures measured with an independent prototype."""

import numpy as np
import pyarrow as pa
import pytest

from craternav_fg import frames
from craternav_fg.reproduce import fig02 as los
from craternav_fg.reproduce import fig03_04 as centres
from craternav_fg.reproduce.edge_points import matched
from craternav_fg.reproduce.fig11_14_trials import METHODS, Batch, run_batch
from craternav_fg.resection.paper.equations import PaperRims, edges
from craternav_fg.simulation.flat_scenes import SEMI_AXES_M, random_scene

# Deviation, deg: angles of incidence by altitudes of los.TILTS_DEG, los.ALTITUDES.
DEVIATION = np.array(
    [
        [0.0020, 0.0031, 0.0055, 0.0123, 0.0219, 0.0494, 0.101, 0.198],
        [0.0038, 0.0059, 0.0106, 0.0238, 0.0422, 0.0951, 0.194, 0.381],
        [0.0053, 0.0084, 0.0149, 0.0334, 0.0594, 0.134, 0.273, 0.536],
        [0.0065, 0.0102, 0.0181, 0.0407, 0.0723, 0.163, 0.333, 0.653],
        [0.0072, 0.0113, 0.0200, 0.0451, 0.0802, 0.181, 0.369, 0.725],
        [0.0074, 0.0116, 0.0207, 0.0465, 0.0828, 0.186, 0.381, 0.750],
    ]
)
# Median position error of (10) in radii, by angle of incidence, at 50, 15, 10 and 5 radii.
CENTRE_ERROR = {5: (0.00, 0.01, 0.01, 0.02), 15: (0.01, 0.04, 0.04, 0.15), 30: (0.02, 0.06, 0.08, 0.15)}
# Mean position error, m, and the bound's rms, by altitude, km, and craters, over 300 trials.
MONTE_CARLO = {
    (10, 2): {"two_craters": 125, "shapes": 114, "efficient": 53, "bound": 69},
    (10, 3): {"centres": 880, "edges": 136, "two_craters": 92, "shapes": 87, "efficient": 26, "bound": 32},
    (10, 5): {"centres": 75, "edges": 24, "two_craters": 76, "shapes": 124, "efficient": 17, "bound": 21},
    (50, 2): {"two_craters": 3026, "shapes": 2496, "efficient": 1238, "bound": 1687},
    (50, 3): {
        "centres": 1390, "edges": 1460, "two_craters": 2145, "shapes": 2058, "efficient": 440, "bound": 566,
    },
    (50, 5): {
        "centres": 235, "edges": 172, "two_craters": 1709, "shapes": 2542, "efficient": 133, "bound": 179,
    },
    (100, 2): {"two_craters": 11933, "shapes": 8394, "efficient": 4641, "bound": 5433},
    (100, 3): {
        "centres": 2771, "edges": 2799, "two_craters": 9471, "shapes": 8663, "efficient": 1358, "bound": 1850,
    },
    (100, 5): {
        "centres": 415, "edges": 364, "two_craters": 7142, "shapes": 9190, "efficient": 337, "bound": 432,
    },
}  # fmt: skip

# The bound comes from the scene alone. Of five craters from 10 km the reference's is 21 m, where rims of the
# 0.5 to 2.5 km that it states for all its scenes give 17 m: its craters there were smaller. With a largest
# semi-axis of 1.25 km the bounds agree, and with it so do all five methods.
CROWDED = (10, 5)
CROWDED_AXES_M = (500.0, 1250.0)


def test_fig02_is_the_table_of_the_reference() -> None:
    rows = los.fig02().rows
    values = np.array([row.corrected for row in rows], dtype=np.float64).reshape(DEVIATION.shape)
    # The table is rounded, by up to 2.5 % of its smallest values.
    rounding = np.where(DEVIATION < 0.1, 5e-5, 5e-4)
    assert (np.abs(values - DEVIATION) < 0.01 * DEVIATION + rounding).all()
    printed = np.array([row.as_printed for row in rows], dtype=np.float64).reshape(DEVIATION.shape)
    np.testing.assert_allclose(printed, values, rtol=1e-9)


def test_fig03_has_the_trends_and_magnitudes_of_the_reference() -> None:
    errors = {}
    for tilt, expected in CENTRE_ERROR.items():
        for altitude, value in zip((50, 15, 10, 5), expected, strict=True):
            records = centres.run_cell(centres.Cell(seed=2, tilt_deg=tilt, altitude=altitude, trials=60))
            error = np.median([record["centres_error_radii"] for record in records])
            # Rounded to a hundredth, and a median of few triples.
            assert 0.5 * value - 0.005 <= error <= 1.6 * value + 0.008, (tilt, altitude)
            errors[tilt, altitude] = error
            assert np.median([record["edges_error_radii"] for record in records]) < 1e-6
    for tilt in CENTRE_ERROR:
        assert errors[tilt, 5] > errors[tilt, 10] > errors[tilt, 50]
    for altitude in (50, 15, 10, 5):
        assert errors[30, altitude] > errors[15, altitude] > errors[5, altitude]


def test_fig04_gives_the_power_of_the_deviation() -> None:
    deviation = np.array([[tilt * 10.0 / h**2 for h in los.ALTITUDES] for tilt in los.TILTS_DEG]).ravel()
    for power, words in (
        (2.0, "faster than the deviation at 6 of the 6"),
        (0.5, "faster than the deviation at 0 of the 6"),
    ):
        columns = {"centres_error_radii": deviation**power, "edges_error_radii": 0.0 * deviation}
        data = pa.table({"deviation_deg": deviation, **columns})
        note = centres.fig04(data).note
        assert f"{power:.2f} at 30 r" in note
        assert f"{power:.2f} at 5 r" in note
        assert words in note


def columns(
    km: int, craters: int, trials: int, *, seed: int = 7, semi_axes_m: tuple[float, float] = SEMI_AXES_M
) -> dict[str, np.ndarray]:
    """Errors of every method in the set-up that the reference states."""
    batch = Batch(craters, 1e3 * km, 1.0, 1.0, (10, 100), semi_axes_m, seed, 0, trials)
    records = run_batch(batch)
    return {name: np.array([record[name] for record in records]) for name in records[0]}


def compare(km: int, craters: int, trials: int) -> None:
    crowded = (km, craters) == CROWDED
    found = columns(km, craters, trials, semi_axes_m=CROWDED_AXES_M if crowded else SEMI_AXES_M)
    for method, expected in MONTE_CARLO[km, craters].items():
        if method == "bound":
            # Of a root mean square whose squares have a long tail.
            square = found["bound_rms_m"] ** 2
            error = np.hypot(1.0, np.sqrt(trials / 300)) * square.std() / np.sqrt(trials) / 2 / expected
            assert abs(np.sqrt(square.mean()) - expected) < 3.5 * error, method
            continue
        values = found[f"{method}_m"]
        assert np.isfinite(values).mean() > 0.99, method
        values = values[np.isfinite(values)]
        error = values.std() * np.hypot(1.0 / np.sqrt(len(values)), 1.0 / np.sqrt(300))
        assert abs(values.mean() - expected) < 3.5 * error, (method, values.mean(), expected, error)


@pytest.mark.parametrize(("km", "craters"), [(10, 2), (10, 3), CROWDED, (50, 3)])
def test_errors_are_those_of_the_reference(km: int, craters: int) -> None:
    compare(km, craters, 120)


@pytest.mark.slow
@pytest.mark.parametrize(("km", "craters"), sorted(MONTE_CARLO))
def test_errors_are_those_of_the_reference_in_full(km: int, craters: int) -> None:
    compare(km, craters, 300)


@pytest.mark.slow
def test_crowded_craters_of_the_stated_sizes_have_a_bound_below_the_references() -> None:
    square = columns(*CROWDED, 300)["bound_rms_m"] ** 2
    error = np.sqrt(2.0) * square.std() / np.sqrt(300) / 2 / np.sqrt(square.mean())
    assert np.sqrt(square.mean()) + 3.5 * error < MONTE_CARLO[CROWDED]["bound"]


def test_the_printed_sign_diverges_and_fine_noise_gives_the_papers_error() -> None:
    found = columns(10, 3, 5)
    assert np.median(found["edges_printed_m"]) > 5e3
    fine = run_batch(Batch(2, 1e5, 0.01, 1.0, (10, 100), SEMI_AXES_M, 7, 0, 40))
    errors = np.array([record["two_craters_m"] for record in fine])
    assert 65.0 < errors.mean() < 260.0


def test_printed_sign_holds_of_two_craters_from_beneath() -> None:
    scene = random_scene(np.random.default_rng(3), 2, 3e4)
    seen = PaperRims(matched(scene, scene.charts, np.repeat(np.eye(5)[None], 2, axis=0)).rims)
    line = scene.centres[1] - scene.centres[0]
    turn = frames.rotation_exp(np.pi * line / np.linalg.norm(line))
    beneath = frames.pose(
        turn @ scene.gTc[:3, :3], scene.centres[0] + turn @ (scene.gTc[:3, 3] - scene.centres[0])
    )
    assert beneath[2, 3] < 0.0
    for gTc, printed_sign, fulfilled in (
        (beneath, True, True), (beneath, False, False), (scene.gTc, True, False), (scene.gTc, False, True),
    ):  # fmt: skip
        e, _ = edges(seen, gTc, printed_sign=printed_sign)
        assert (np.abs(e).max() < 1e-9) == fulfilled


def test_two_craters_have_no_columns_of_three() -> None:
    record = run_batch(Batch(2, 5e4, 1.0, 1.0, (10, 100), SEMI_AXES_M, 7, 0, 1))[0]
    absent = {name for name in METHODS if np.isnan(record[f"{name}_m"])}
    assert absent == {"centres", "edges", "edges_printed"}
