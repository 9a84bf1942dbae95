"""The statements of docs/equations.md on random views: pin-hole projection of rim points, numpy, no kernel.

A conic is the null vector of the points' design matrix, so nothing here rests on the formulas under test.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

VIEWS = 40


@dataclass(frozen=True)
class View:
    """A rim seen by a camera, lengths in km; frames as in docs/equations.md."""

    L: np.ndarray
    gRl: np.ndarray
    a: float
    b: float
    P: np.ndarray
    gRc: np.ndarray

    @property
    def R(self) -> np.ndarray:
        return self.gRc.T @ self.gRl

    @property
    def T(self) -> np.ndarray:
        return self.gRl.T @ (self.P - self.L)

    @property
    def n_c(self) -> np.ndarray:
        return self.gRc.T @ self.gRl[:, 2]

    def points(self, count: int = 24) -> np.ndarray:
        """Points (count, 3) of the rim in c."""
        angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
        local = np.column_stack([self.a * np.cos(angle), self.b * np.sin(angle), 0.0 * angle])
        return (self.L + local @ self.gRl.T - self.P) @ self.gRc

    @property
    def q(self) -> np.ndarray:
        """Conic (6,) of the image, of unit norm and any sign."""
        x, y = (self.points()[:, :2] / self.points()[:, 2:]).T
        return np.linalg.svd(np.column_stack([x * x, x * y, y * y, x, y, np.ones_like(x)]))[2][-1]


def matrix(q: np.ndarray) -> np.ndarray:
    A, B, C, D, E, F = q
    return np.array([[A, B / 2, D / 2], [B / 2, C, E / 2], [D / 2, E / 2, F]])


def k_matrix(q: np.ndarray) -> np.ndarray:
    """Eq. (12) with the coefficients below eq. (9)."""
    A, B, C, D, E, F = q
    k1, k2, k3 = 2 * C * D - B * E, 2 * A * E - B * D, B * B - 4 * A * C
    k4, k5, k6 = E * E - 4 * C * F, 2 * B * F - D * E, D * D - 4 * A * F
    return np.array([[k4, k5, k1], [k5, k6, k2], [k1, k2, k3]])


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def random_view(rng: np.random.Generator) -> View:
    """A rim within 20 degrees of the optical axis of a camera that is 10 to 100 km above it."""
    gRl = Rotation.random(random_state=rng).as_matrix()
    L = rng.normal(0.0, 1000.0, 3)
    a = rng.uniform(0.5, 2.5)
    # Half a turn about x points the camera down; then it is tilted and turned about its axis.
    tilt = Rotation.from_rotvec(np.radians(rng.uniform(-30.0, 30.0, 3)) * [1.0, 1.0, 6.0])
    lRc = np.diag([1.0, -1.0, -1.0]) @ tilt.as_matrix()
    sight = lRc @ [*rng.uniform(-0.3, 0.3, 2), 1.0]
    T = sight * rng.uniform(10.0, 100.0) / sight[2]
    return View(L, gRl, a, a * rng.uniform(0.7, 0.98), L + gRl @ T, gRl @ lRc)


@pytest.fixture(scope="module")
def views() -> list[View]:
    rng = np.random.default_rng(19)
    found = [random_view(rng) for _ in range(VIEWS)]
    assert all(view.T[2] > 0.0 and (view.points()[:, 2] > 0.0).all() for view in found)
    return found


def test_plane_and_centre(views: list[View]) -> None:
    for view in views:
        d = view.n_c @ view.points().T
        assert d.max() < 0.0
        assert_allclose(d, d[0], rtol=1e-9)
        q = view.q
        A, B, C, D, E, F = q
        # Eq. (7) on the rim's own points.
        x, y, _ = view.points().T
        nx, ny, nz = view.n_c
        plane = [
            nz**2 * A - nx * nz * D + nx**2 * F,
            nz**2 * B - ny * nz * D - nx * nz * E + 2 * nx * ny * F,
            nz**2 * C - ny * nz * E + ny**2 * F,
            d[0] * nz * D - 2 * d[0] * nx * F,
            d[0] * nz * E - 2 * d[0] * ny * F,
            d[0] ** 2 * F,
        ]
        terms = np.array(plane) * np.column_stack([x * x, x * y, y * y, x, y, np.ones_like(x)])
        assert_allclose(terms.sum(axis=1), 0.0, atol=1e-9 * np.abs(terms).max())
        # Eq. (4): the level function 2 Q [u v 1] has no slope there; it is not the image of the centre.
        centre = np.array([2 * C * D - B * E, 2 * A * E - B * D]) / (B * B - 4 * A * C)
        assert_allclose((matrix(q) @ [*centre, 1.0])[:2], 0.0, atol=1e-12)
        p = view.gRc.T @ (view.L - view.P)
        assert np.linalg.norm(centre - p[:2] / p[2]) > 1e-5


def test_line_of_sight_points_to_the_crater(views: list[View]) -> None:
    """Eqs. (9), (11): K n_c points from the camera to the centre, whatever the conic's sign and scale."""
    for view in views:
        to_centre = view.gRc.T @ unit(view.L - view.P)
        for scale in (1.0, -1.0, 3e4, -2e-3):
            assert_allclose(unit(k_matrix(scale * view.q) @ view.n_c), to_centre, atol=1e-7)


def test_identities_of_the_coefficients(views: list[View]) -> None:
    """Eqs. (12), (14), (17), (18), (20), (21), (22)."""
    for view in views:
        q, R, T = view.q, view.R, view.T
        A, B, C, D, E, F = q
        Q, K = matrix(q), k_matrix(q)
        assert_allclose(K @ Q, -4.0 * np.linalg.det(Q) * np.eye(3), atol=1e-12 * np.abs(K).max())
        det4 = (B * B - 4 * A * C) * F + C * D * D - B * D * E + A * E * E
        assert_allclose(np.linalg.inv(K) * det4, Q, atol=1e-8)
        H = np.array([[1.0, 0.0, -T[0]], [0.0, 1.0, -T[1]], [0.0, 0.0, -T[2]]])
        angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        plane = np.column_stack([view.a * np.cos(angle), view.b * np.sin(angle), np.ones(24)])
        assert_allclose(plane @ H.T @ R.T, view.points(), atol=1e-9)
        N = R.T @ Q @ R
        alpha = view.a**2 * N[0, 0]
        assert np.sign(alpha) == -np.sign(np.linalg.det(Q))
        local = np.linalg.inv(H).T @ np.diag([view.a**-2, view.b**-2, -1.0]) @ np.linalg.inv(H)
        assert_allclose(alpha * local, N, atol=1e-9 * np.abs(N).max())
        assert N[1, 2] == pytest.approx(-alpha * T[1] / (view.b**2 * T[2]), abs=1e-9 * np.abs(N).max())
        assert_allclose(unit(N @ T), [0.0, 0.0, -np.sign(alpha)], atol=1e-6)


def shape(Q: np.ndarray, R: np.ndarray, T: np.ndarray, a: float, b: float) -> np.ndarray:
    """Eq. (19), its rows scaled to the size of their terms."""
    N = R.T @ Q @ R
    rows = [
        [a**2 * N[0, 0], -(b**2) * N[1, 1]],
        [N[0, 1], 0.0],
        [T[2] * N[0, 2], T[0] * N[0, 0]],
        [T[2] * N[1, 2], T[1] * N[1, 1]],
        [(a**2 - T[0] ** 2) * N[0, 0], -(T[1] ** 2) * N[1, 1], T[2] ** 2 * N[2, 2]],
    ]
    sizes = [max(np.abs(row).max(), np.abs(N).max()) for row in rows]
    return np.array([sum(row) for row in rows]) / sizes


def test_zeros_of_the_shape(views: list[View]) -> None:
    """Eq. (19) is zero at the pose, linear in q, and zero at four other poses."""
    turn_z, turn_x = np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, -1.0, -1.0])
    for view in views:
        Q, R, T = matrix(view.q), view.R, view.T
        zeros = [
            (R, T, True),
            (R @ turn_z, turn_z @ T, True),
            (R, -T, False),
            (R @ turn_x, T * [-1.0, 1.0, 1.0], False),
            (R @ turn_x, turn_x @ T, False),
        ]
        for R_k, T_k, passes in zeros:
            assert_allclose(shape(Q, R_k, T_k, view.a, view.b), 0.0, atol=1e-7)
            p = -R_k @ T_k
            assert (T_k[2] > 0.0 and p[2] > 0.0) == passes
        away = R @ Rotation.from_rotvec([0.01, 0.02, -0.01]).as_matrix()
        assert np.abs(shape(Q, away, T, view.a, view.b)).max() > 1e-4


def test_dual_conic_and_chart(views: list[View]) -> None:
    """The image ellipse of the forward model, with centre m and matrix S, holds the projected points."""
    for view in views:
        p = view.gRc.T @ (view.L - view.P)
        c1, c2 = view.a * view.R[:, 0], view.b * view.R[:, 1]
        dual = np.outer(c1, c1) + np.outer(c2, c2) - np.outer(p, p)
        assert dual[2, 2] < 0.0
        m = dual[:2, 2] / dual[2, 2]
        S = np.outer(m, m) - dual[:2, :2] / dual[2, 2]
        u = view.points()[:, :2] / view.points()[:, 2:] - m
        assert_allclose(np.einsum("ki,ij,kj->k", u, np.linalg.inv(S), u), 1.0, rtol=1e-6)
        # Its tangents are the planes through the camera that touch the rim.
        A = view.n_c @ p
        assert_allclose(dual @ view.n_c, -A * p, atol=1e-9 * np.abs(dual).max())


def linear_form(R: np.ndarray, T: np.ndarray, a: float, b: float) -> np.ndarray:
    """D (5, 6) of eq. (19), h = D q, column by column."""
    columns = []
    for q in np.eye(6):
        N = R.T @ matrix(q) @ R
        columns.append(
            [
                a**2 * N[0, 0] - b**2 * N[1, 1],
                N[0, 1],
                T[2] * N[0, 2] + T[0] * N[0, 0],
                T[2] * N[1, 2] + T[1] * N[1, 1],
                (a**2 - T[0] ** 2) * N[0, 0] - T[1] ** 2 * N[1, 1] + T[2] ** 2 * N[2, 2],
            ]
        )
    return np.transpose(columns)


def test_whitened_shape_is_a_distance_between_conics(views: list[View]) -> None:
    """Eq. (19) whitened by its own covariance is the distance of q from the line of the predicted conic."""
    rng = np.random.default_rng(20)
    for view in views[:10]:
        A = rng.normal(size=(6, 6))
        S = A @ A.T + np.eye(6)
        q = view.q + 0.1 * rng.normal(size=6)
        D = linear_form(view.R, view.T, view.a, view.b)
        D /= np.linalg.norm(D, axis=1)[:, None]
        h = D @ q
        best = np.linalg.solve(S, view.q) @ q / (np.linalg.solve(S, view.q) @ view.q)
        off = q - best * view.q
        assert h @ np.linalg.solve(D @ S @ D.T, h) == pytest.approx(off @ np.linalg.solve(S, off), rel=1e-5)


def chart(gRc: np.ndarray, P: np.ndarray, a: float, b: float) -> np.ndarray:
    """Chart of the image of a level rim at the origin of g, from the forward model's dual conic."""
    p, c1, c2 = -gRc.T @ P, a * gRc[0], b * gRc[1]
    dual = np.outer(c1, c1) + np.outer(c2, c2) - np.outer(p, p)
    m = dual[:2, 2] / dual[2, 2]
    S = np.outer(m, m) - dual[:2, :2] / dual[2, 2]
    s = S[1, 1] - S[0, 1] ** 2 / S[0, 0]
    return np.array([*m, 0.5 * np.log(S[0, 0]), S[0, 1] / S[0, 0], 0.5 * np.log(s)])


@pytest.mark.parametrize(
    ("b", "head_on", "rank"), [(0.8, False, 5), (1.0, False, 5), (0.8, True, 4), (1.0, True, 3)]
)
def test_what_one_rim_determines(b: float, head_on: bool, rank: int) -> None:
    """Rank of the chart's Jacobian for the pose; lengths in radii."""
    gRc, P = np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 8.0])
    if not head_on:
        gRc, P = gRc @ Rotation.from_rotvec([0.2, -0.3, 0.5]).as_matrix(), np.array([1.5, 3.0, 8.0])
    step = 1e-5
    columns = []
    for k in range(6):
        w, rho = (step * np.eye(6)[k]).reshape(2, 3)
        turn = Rotation.from_rotvec(w).as_matrix()
        ahead = chart(gRc @ turn, P + gRc @ rho, 1.0, b)
        behind = chart(gRc @ turn.T, P - gRc @ rho, 1.0, b)
        columns.append((ahead - behind) / (2.0 * step))
    J = np.transpose(columns)
    assert np.linalg.matrix_rank(J, tol=1e-6) == rank
    if b == 1.0:
        # A turn of the camera about the rim's axis leaves the image of a circle as it is.
        about = np.concatenate([gRc.T @ [0.0, 0.0, 1.0], gRc.T @ np.cross([0.0, 0.0, 1.0], P)])
        assert_allclose(J @ about, 0.0, atol=1e-8)


def small_step(view: View, X: np.ndarray, direction: np.ndarray) -> float:
    """Tilt of the image of a short step from a point X in c along a direction in g."""
    step = X + 1e-6 * view.gRc.T @ direction
    image = step[:2] / step[2] - X[:2] / X[2]
    return float(np.arctan2(image[1], image[0]))


def wrapped(angle: float) -> float:
    return float(np.angle(np.exp(1j * angle)))


def test_sun_tilt(views: list[View]) -> None:
    """Eq. (24) in perspective, its Jacobian, and the half of all views for which atan is wrong by pi."""
    rng = np.random.default_rng(24)
    off_by_pi = 0
    for view in views:
        X = view.gRc.T @ (view.L - view.P)
        u, v = X[:2] / X[2]
        direction = unit(rng.normal(size=3))
        s = view.gRc.T @ direction
        x, y = s[0] - u * s[2], s[1] - v * s[2]
        assert wrapped(small_step(view, X, direction) - np.arctan2(y, x)) == pytest.approx(0.0, abs=1e-5)
        off_by_pi += abs(wrapped(np.arctan2(y, x) - np.arctan(y / x))) > 3.0
        cross = np.array([[0.0, -s[2], s[1]], [s[2], 0.0, -s[0]], [-s[1], s[0], 0.0]])
        slope = np.array([-y, x]) @ [[1.0, 0.0, -u], [0.0, 1.0, -v]] @ cross / (x * x + y * y)
        for k, w in enumerate(1e-6 * np.eye(3)):
            ends = []
            for sign in (-1.0, 1.0):
                s_k = (view.gRc @ Rotation.from_rotvec(sign * w).as_matrix()).T @ direction
                ends.append(np.arctan2(s_k[1] - v * s_k[2], s_k[0] - u * s_k[2]))
            assert wrapped(ends[1] - ends[0]) / 2e-6 == pytest.approx(slope[k], abs=1e-4)
    assert 0.3 * VIEWS < off_by_pi < 0.7 * VIEWS


def test_brightness_shows_the_ground_azimuth() -> None:
    """The brightness of gently sloping Lambertian ground changes along the sun's part in the ground only."""
    rng = np.random.default_rng(25)
    for _ in range(10):
        sun = unit([*rng.normal(size=2), rng.uniform(0.3, 2.0)])
        slopes = 1e-4 * rng.normal(size=(200, 2))
        normals = np.column_stack([-slopes, np.ones(200)])
        brightness = (normals / np.linalg.norm(normals, axis=1)[:, None]) @ sun
        gradient = np.linalg.lstsq(np.column_stack([slopes, np.ones(200)]), brightness, rcond=None)[0][:2]
        assert_allclose(unit(-gradient), unit(sun[:2]), atol=1e-3)


@pytest.mark.parametrize(("elevation_deg", "rms_deg"), [(15, 4), (30, 8), (45, 13), (60, 24)])
def test_tilt_of_the_sun_is_not_that_of_the_ground_azimuth(elevation_deg: float, rms_deg: float) -> None:
    """Eq. (24) with atan2 against the tilt of the sun's part in the ground, on level ground."""
    rng = np.random.default_rng(26)
    squared = []
    for _ in range(4000):
        azimuth, heading = rng.uniform(-np.pi, np.pi, 2)
        off_nadir = np.radians(rng.uniform(0.0, 30.0))
        turn, tilt = Rotation.from_rotvec([0.0, 0.0, heading]), Rotation.from_rotvec([off_nadir, 0.0, 0.0])
        gRc = np.diag([1.0, -1.0, -1.0]) @ (tilt * turn).as_matrix()
        elevation = np.radians(elevation_deg)
        ground = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        sun_c, ground_c = gRc.T @ np.append(ground[:2], np.sin(elevation)), gRc.T @ ground
        # Within 20 degrees of the axis.
        u, v = np.tan(np.radians(20.0)) * rng.uniform(-1.0, 1.0, 2)
        shown = np.arctan2(ground_c[1] - v * ground_c[2], ground_c[0] - u * ground_c[2])
        squared.append(wrapped(np.arctan2(sun_c[1], sun_c[0]) - shown) ** 2)
    assert np.degrees(np.sqrt(np.mean(squared))) == pytest.approx(rms_deg, rel=0.1)


MU, SPIN = 4.9e12, np.array([0.0, 3e-4, 4e-4])


def rotating(t: float) -> np.ndarray:
    """iRg: from the spinning frame g to the inertial one."""
    return Rotation.from_rotvec(SPIN * t).as_matrix()


def test_motion_in_the_spinning_frame() -> None:
    """Eqs. (26)-(28) against Newton's law and the gyro's definition in inertial axes."""
    rate = np.array([0.011, -0.02, 0.007])
    force = np.array([0.4, -0.3, 1.2])
    gRb0 = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    P0, V0 = np.array([1.7e6, 2e5, -1e5]), np.array([-400.0, 900.0, 300.0])

    def iRb(t: float) -> np.ndarray:
        """The gyro's rate is the body's against inertial axes, in b."""
        return gRb0 @ Rotation.from_rotvec(rate * t).as_matrix()

    def newton(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], iRb(t) @ force - MU * y[:3] / np.linalg.norm(y[:3]) ** 3])

    def hamilton(q: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Eq. (28) applied to q."""
        x, y, z = r
        return np.array([[0, -x, -y, -z], [x, 0, z, -y], [y, -z, 0, x], [z, y, -x, 0]]) @ q

    def spinning(t: float, y: np.ndarray) -> np.ndarray:
        P, V, q = y[:3], y[3:6], y[6:]
        gRb = Rotation.from_quat(np.roll(q, -1)).as_matrix()
        a = gRb @ force - MU * P / np.linalg.norm(P) ** 3
        a = a - 2.0 * np.cross(SPIN, V) - np.cross(SPIN, np.cross(SPIN, P))
        return np.concatenate([V, a, 0.5 * hamilton(q, rate - gRb.T @ SPIN)])

    options = {"rtol": 1e-11, "atol": 1e-9}
    end_s = 100.0
    inertial = solve_ivp(newton, (0.0, end_s), [*P0, *(V0 + np.cross(SPIN, P0))], **options).y[:, -1]
    q0 = np.roll(Rotation.from_matrix(gRb0).as_quat(), 1)
    found = solve_ivp(spinning, (0.0, end_s), [*P0, *V0, *q0], **options).y[:, -1]
    iRg = rotating(end_s)
    assert_allclose(iRg @ found[:3], inertial[:3], atol=1e-4)
    gRb = Rotation.from_quat(np.roll(found[6:], -1)).as_matrix()
    assert_allclose(iRg @ gRb, iRb(end_s), atol=1e-8)


def test_gravity_at_the_midpoint_halves_the_error() -> None:
    """Over 10 s of coasting: half the position's error, with the other sign, and hardly any of velocity."""
    P0, V0 = np.array([1.75e6, 0.0, 0.0]), np.array([-800.0, 900.0, 0.0])
    step_s = 10.0

    def free(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], -MU * y[:3] / np.linalg.norm(y[:3]) ** 3])

    true = solve_ivp(free, (0.0, step_s), [*P0, *V0], rtol=1e-13, atol=1e-9).y[:, -1]
    position, velocity = [], []
    for at in (P0, P0 + 0.5 * step_s * V0):
        g = -MU * at / np.linalg.norm(at) ** 3
        position.append(P0 + step_s * V0 + 0.5 * step_s**2 * g - true[:3])
        velocity.append(V0 + step_s * g - true[3:])
    assert_allclose(position[1], -0.5 * position[0], atol=0.02 * np.linalg.norm(position[0]))
    assert np.linalg.norm(velocity[1]) < 0.01 * np.linalg.norm(velocity[0])


def test_fusion_counts_the_prior_once_or_every_time() -> None:
    """Eq. (29) has the prior's information n times; less n - 1 of it equals one central update."""
    rng = np.random.default_rng(29)
    n = 3
    prior = np.cov(rng.normal(size=(6, 30)))
    mean = rng.normal(size=6)
    slopes, z = rng.normal(size=(n, 2, 6)), rng.normal(size=(n, 2))
    stacked = slopes.reshape(-1, 6)
    gain = prior @ stacked.T @ np.linalg.inv(stacked @ prior @ stacked.T + np.eye(2 * n))
    central = mean + gain @ (z.ravel() - stacked @ mean), (np.eye(6) - gain @ stacked) @ prior
    information, vector = np.zeros((6, 6)), np.zeros(6)
    for A, z_k in zip(slopes, z, strict=True):
        own = prior @ A.T @ np.linalg.inv(A @ prior @ A.T + np.eye(2))
        x_k, P_k = mean + own @ (z_k - A @ mean), (np.eye(6) - own @ A) @ prior
        information += np.linalg.inv(P_k)
        vector += np.linalg.solve(P_k, x_k)
    printed = np.linalg.inv(information)
    assert (np.linalg.eigvalsh(central[1] - printed) > 0.0).all()
    once = information - (n - 1) * np.linalg.inv(prior)
    assert_allclose(np.linalg.inv(once), central[1], atol=1e-9)
    assert_allclose(
        np.linalg.solve(once, vector - (n - 1) * np.linalg.solve(prior, mean)), central[0], atol=1e-9
    )
