"""The index of a catalogue: its tree, its densities, its file."""

import numpy as np
import pytest

from craternav_fg.errors import InputError
from craternav_fg.matching.identify import kd_tree
from craternav_fg.matching.identify.craters import density
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import SMALLEST, TripleIndex, load_or_build
from craternav_fg.simulation.catalog_views import ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.scenes import MOON


@pytest.fixture(scope="module")
def index() -> TripleIndex:
    return TripleIndex.build(synthetic_catalog(MOON, np.random.default_rng(2), count=3000))


def assert_same(one: TripleIndex, other: TripleIndex) -> None:
    np.testing.assert_array_equal(one.neighbours, other.neighbours)
    for a, b in zip(one.tree, other.tree, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_tree_finds_the_nearest_points(index) -> None:
    t = index.tree
    rng = np.random.default_rng(3)
    weights = np.array([1 / 600.0, 1 / 400.0, 1 / 900.0, 1 / 300.0, 1 / 500.0])
    d2, codes = np.empty(20), np.empty(20, dtype=np.uint32)
    for row in rng.integers(len(t.points), size=40):
        query = t.points[row] + rng.normal(size=5) / weights
        count = kd_tree.nearest(t, query, weights, 16.0, d2, codes)
        every = np.sum(((t.points - query) * weights) ** 2, axis=1)
        nearest = np.argsort(every)[:20]
        nearest = nearest[every[nearest] < 16.0]
        assert count == len(nearest)
        np.testing.assert_allclose(np.sort(d2[:count]), every[nearest])
        assert set(codes[:count]) == set(t.codes[nearest])


def test_neighbours_are_the_nearest_of_their_size(index) -> None:
    size = np.sqrt(index.catalog.semi_major_m * index.catalog.semi_minor_m)
    for crater in range(0, 3000, 97):
        others = np.flatnonzero(size >= SMALLEST * size[crater])
        others = others[others != crater]
        centres = index.catalog.centres
        far = np.linalg.norm(centres[others] - centres[crater], axis=1)
        found = index.neighbours[crater]
        found = found[found >= 0]
        # A few of the last may be missing: those beyond what one question to the tree of their size gives.
        assert len(found) >= min(7, len(others))
        np.testing.assert_array_equal(found, others[np.argsort(far)][: len(found)])


def test_density_is_the_catalogues_over_its_sphere(index) -> None:
    least, most = np.log(2500.0), np.log(9000.0)
    log_size = 0.5 * np.log(index.catalog.semi_major_m * index.catalog.semi_minor_m)
    inside = np.sum((log_size >= least) & (log_size <= most))
    assert density(index.craters, least, most) * 4.0 * np.pi == pytest.approx(inside, rel=0.02)


def test_the_index_comes_back_from_its_file(index, tmp_path) -> None:
    path = tmp_path / "index.npz"
    first, said = load_or_build(path, index.catalog)
    assert said == f"{path} is built, once for this catalogue"
    again, said = load_or_build(path, index.catalog)
    assert said == ""
    assert_same(again, first)
    assert path.stat().st_size < 1.1 * again.nbytes + 10_000


def test_the_index_of_another_catalogue_is_built_anew(index, tmp_path) -> None:
    path = tmp_path / "index.npz"
    index.save(path)
    other = index.catalog.take(np.arange(1000))
    with pytest.raises(InputError, match="is the index of another catalogue"):
        TripleIndex.load(path, other)
    fresh, said = load_or_build(path, other)
    assert said == f"{path}: is the index of another catalogue; built anew"
    assert len(fresh.neighbours) == 1000
    assert load_or_build(path, other)[1] == ""


def test_the_index_of_another_version_is_built_anew(index, tmp_path, monkeypatch) -> None:
    path = tmp_path / "index.npz"
    monkeypatch.setattr("craternav_fg.matching.identify.triple_index.VERSION", 77)
    index.save(path)
    monkeypatch.undo()
    assert "expected an index of version 1, found 77; built anew" in load_or_build(path, index.catalog)[1]


@pytest.mark.parametrize("content", [b"", b"no index", b"PK\x03\x04 cut off"])
def test_a_file_that_is_no_index(index, tmp_path, content) -> None:
    path = tmp_path / "index.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match="something else"):
        TripleIndex.load(path, index.catalog)


def test_a_damaged_index_is_refused_or_right(index, tmp_path) -> None:
    path = tmp_path / "index.npz"
    index.save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(4)
    refused = 0
    # At the end is the archive's table of contents, in which a wrong byte is an unknown way of packing.
    for place in [*rng.integers(0, len(whole), 60), *range(len(whole) - 700, len(whole), 5)]:
        damaged = bytearray(whole)
        damaged[place] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            found = TripleIndex.load(path, index.catalog)
        except InputError:
            refused += 1
            continue
        assert_same(found, index)
    assert refused > 100


def test_an_index_that_cannot_be_stored_is_used_all_the_same(index, tmp_path) -> None:
    folder = tmp_path / "index.npz"
    folder.mkdir()
    built, said = load_or_build(folder, index.catalog)
    assert "not stored" in said
    assert len(built.tree.codes) == len(index.tree.codes)


def test_catalogues_of_few_craters(index) -> None:
    for count in (1, 2, 3, 5):
        few = TripleIndex.build(index.catalog.take(np.arange(count)))
        assert few.craters.log_size.shape == (count,)


def stored(index: TripleIndex, path, **changed) -> None:
    """Write an index with some of its arrays replaced."""
    index.save(path)
    with np.load(path) as data:
        arrays = {name: data[name] for name in data.files}
    np.savez(path, **{**arrays, **changed})


FORGED = {
    "points of four numbers": (lambda i: {"points": i.tree.points[:, :4]}, "expected points of uint16"),
    "points of another type": (
        lambda i: {"points": i.tree.points.astype(float)},
        "expected points of uint16",
    ),
    "fewer points than codes": (lambda i: {"points": i.tree.points[:-1]}, "expected points of uint16"),
    "fewer nodes": (lambda i: {"dims": i.tree.dims[:2]}, "expected dims of uint8"),
    "too many levels": (lambda i: {"levels": i.tree.levels + 1}, "expected dims of uint8"),
    "no level at all": (lambda i: {"levels": -1}, "expected dims of uint8"),
    "a sixth dimension": (lambda i: {"dims": i.tree.dims + 5}, "a node is split in no dimension"),
    "a code beyond the craters": (lambda i: {"codes": i.tree.codes | 2**31}, "a triple is of no crater"),
    "a crater beyond the last": (lambda i: {"neighbours": i.neighbours + 2999}, "a neighbour is no crater"),
    "a crater before the first": (lambda i: {"neighbours": i.neighbours - 1}, "a neighbour is no crater"),
    "neighbours of others": (lambda i: {"neighbours": i.neighbours[:-1]}, "expected neighbours of int32"),
    "no neighbours": (lambda i: {"neighbours": i.neighbours[:, :0]}, "expected 2 to 9 neighbours"),
    "a number for an array": (lambda i: {"neighbours": np.int32(3)}, "expected neighbours of int32"),
    "text for an array": (lambda i: {"codes": np.array("x")}, "expected points of uint16"),
}


@pytest.mark.parametrize("case", FORGED)
def test_a_forged_index_is_refused_before_compiled_code_sees_it(index, tmp_path, case) -> None:
    change, problem = FORGED[case]
    path = tmp_path / "index.npz"
    stored(index, path, **change(index))
    with pytest.raises(InputError, match=f"is damaged: {problem}"):
        TripleIndex.load(path, index.catalog)


def test_an_index_that_would_fill_the_memory_is_refused(index, tmp_path) -> None:
    path = tmp_path / "index.npz"
    np.savez_compressed(path, points=np.zeros((1_000_000, 5), np.uint16))
    with pytest.raises(InputError, match="expected arrays that are not compressed"):
        TripleIndex.load(path, index.catalog)


def test_a_triple_without_its_neighbours_is_passed_over(index) -> None:
    """Compiled code would read the crater before the first."""
    forged = TripleIndex(index.catalog, np.full_like(index.neighbours, -1), index.tree)
    assert forged.fault() is None
    scene = random_view(index.catalog, ViewOptions(), np.random.default_rng(4), true_rims=(9, 60))
    assert identify(scene.ellipses_px, scene.camera, index).identified
    assert not identify(scene.ellipses_px, scene.camera, forged).identified
