"""Relocalisation: the pose of an image that nothing predicts, from rims detected blindly and identified."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset, layout
from craternav_fg.ellipse import normalised_chart
from craternav_fg.frames import rotate_position_block
from craternav_fg.matching.gate import match_rims
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex, index_path, load_or_build
from craternav_fg.measurements import RimSet
from craternav_fg.resection.problem import MatchedRims, ResectionProblem, Status
from craternav_fg.resection.robust import solve_robustly
from craternav_fg.vision.detect import FoundRims, find_rims
from craternav_fg.vision.grey import GreyArray, on_8_bit_scale, undistorted
from craternav_fg.vision.network_detect import find_rims_network
from factors.arrays import FloatArray, IntArray

# Fewer matched rims may agree by chance.
_MIN_RIMS = 3
# Least semi-minor axis, px, of craters among which an image's rims are identified.
_LEAST_SEMI_MINOR_PX = 5.0


@dataclass(frozen=True)
class PoseFix:
    """A pose found without a prediction, or with a poor one.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    pose_covariance : ndarray, shape (6, 6)
        Attitude (rotation vector in b, rad), then position (in g, m).
    rims : int
        Number of matched rims that it rests on.
    """

    gTb: FloatArray
    pose_covariance: FloatArray
    rims: int


class Relocaliser:
    """Finds poses from the images of a data set; its catalogue is indexed when that is first needed.

    The index of a large catalogue, `craters.parquet`, takes long to build: it is stored in the
    user's cache.

    Parameters
    ----------
    dataset : Dataset

    Attributes
    ----------
    index_note : str
        Why an index was built although one could be stored, and whether it was stored; empty otherwise.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self.index_note = ""
        self._found: tuple[int, FoundRims] | None = None

    def prepare(self) -> None:
        """Index the catalogue now, if images are to be processed; it may take half a minute."""
        if self._dataset.measurements is None:
            _ = self._triples

    def sharing_index(self, dataset: Dataset) -> "Relocaliser":
        """Return one for a data set with the same craters, which need not be indexed again.

        Parameters
        ----------
        dataset : Dataset
            It may differ in the errors of its catalogue.

        Returns
        -------
        Relocaliser
        """
        other = Relocaliser(dataset)
        other.index_note = self.index_note
        if "_triples" in self.__dict__:
            other.__dict__["_triples"] = self._triples
        return other

    @property
    def _map(self) -> Catalog:
        # Poses that guide the front end are relative to the map: the error of the map as a whole is left out.
        return replace(self._dataset.catalog, common_shift=None, has_heights=True)

    @cached_property
    def _triples(self) -> TripleIndex:
        large = self._dataset.path / layout.LARGE_CRATERS
        if large.is_file():
            index, self.index_note = load_or_build(index_path(large), self._map)
            return index
        return TripleIndex.build(self._map)

    def locate(
        self, index: int, sun_angle_rad: float | None = None, among: IntArray | None = None
    ) -> PoseFix | None:
        """Find the pose of a frame without a prediction.

        Clear rims are enough where the image shows them. On worn ground only the crater network finds enough,
        and it finds several times as many where it knows the sun.

        Parameters
        ----------
        index : int
            Index of the frame. Its image is used, or its rims when the data set holds the measurements.
        sun_angle_rad : float, optional
            Direction towards the sun in the image, see `sun_in_image`; found in the image if not given.
        among : ndarray of int, shape (k,), optional
            Rows of the catalogue's craters that the image may show; all if not given.

        Returns
        -------
        PoseFix or None
            None when its craters are not identified.
        """
        if self._dataset.measurements is not None:
            return self._resected(self._dataset.measurements[index].rims)
        if among is not None and not len(among):
            return None
        return self._identified(self._rims(index), among) or self._identified(
            find_rims_network(self._image(index), sun_angle_rad), among
        )

    def rims_if_mirrored(self, index: int) -> int:
        """Identify the craters of an image that is mirrored left to right.

        A catalogue whose longitudes are positive west, or latitudes positive south, is mirrored, too.

        Parameters
        ----------
        index : int
            Index of the frame; the data set has images.

        Returns
        -------
        int
            Number of rims that are identified; 0 when they are not.
        """
        camera = self._dataset.camera.pinhole
        mirrored = replace(camera, cx_px=camera.width_px - 1 - camera.cx_px)
        found = find_rims(np.ascontiguousarray(self._image(index)[:, ::-1]))
        answer = identify(
            found.ellipses_px, mirrored, self._triples, options=IdentifyOptions.of(mirrored),
            traced=found.traced,
        )  # fmt: skip
        return int(np.count_nonzero(answer.rows >= 0)) if answer.identified else 0

    def _identified(self, found: FoundRims, among: IntArray | None = None) -> PoseFix | None:
        """Pose of the image whose rims were detected; None when their craters are not identified."""
        data = self._dataset
        triples = self._triples if among is None else TripleIndex.build(self._map.take(among))
        answer = identify(
            found.ellipses_px, data.camera.pinhole, triples, options=IdentifyOptions.of(data.camera),
            traced=found.traced,
        )  # fmt: skip
        if not answer.identified:
            return None
        charts, covariances = self._normalised(found)
        matched = np.flatnonzero(answer.rows >= 0)
        rows = answer.rows[matched] if among is None else among[answer.rows[matched]]
        fix = self._resected(RimSet(rows, charts[matched], covariances[matched]))
        if fix is not None:
            return fix
        return PoseFix(answer.gTb, rotate_position_block(answer.covariance, answer.gTb[:3, :3]), len(matched))

    @property
    def camera(self) -> Camera:
        """Camera of the rims: without distortion."""
        return self._dataset.camera.pinhole

    def identified_near(self, index: int, gTb: FloatArray) -> tuple[MatchedRims, FloatArray] | None:
        """Identify the rims that are traced in an image among the craters around those that a pose sees.

        Parameters
        ----------
        index : int
            Index of the frame.
        gTb : ndarray, shape (4, 4)
            Pose of the body in g, m: nothing else depends on it.

        Returns
        -------
        rims : MatchedRims
        gTb : ndarray, shape (4, 4)
            Pose by these rims.
        None
            When they are not identified.
        """
        around_px = 0.5 * max(self.camera.width_px, self.camera.height_px)
        among = self._map.visible(
            self.camera, gTb, min_semi_minor_px=_LEAST_SEMI_MINOR_PX, margin_px=-around_px
        )[0]
        found = find_rims_network(self._image(index))
        if len(among) < _MIN_RIMS or len(found) < _MIN_RIMS:
            return None
        part = self._map.take(among)
        answer = identify(
            found.ellipses_px, self.camera, TripleIndex.build(part), options=IdentifyOptions.of(self.camera),
            traced=found.traced,
        )  # fmt: skip
        if not answer.identified:
            return None
        charts, covariances = self._normalised(found)
        matched = np.flatnonzero((answer.rows >= 0) & found.traced)
        rims = RimSet(answer.rows[matched], charts[matched], covariances[matched])
        return MatchedRims.of(rims, part), answer.gTb

    def match(self, index: int, gTb: FloatArray, pose_covariance: FloatArray) -> PoseFix | None:
        """Find the pose of a frame from its image and a poor prediction.

        Parameters
        ----------
        index : int
            Index of the frame.
        gTb : ndarray, shape (4, 4)
            Predicted pose of the body in g, m.
        pose_covariance : ndarray, shape (6, 6)
            Its covariance: attitude (rotation vector in b, rad), then position (in g, m).

        Returns
        -------
        PoseFix or None
            None when too few rims agree.
        """
        data = self._dataset
        charts, covariances = self._normalised(self._rims(index))
        answer = match_rims(charts, covariances, data.camera.pinhole, data.catalog, gTb, pose_covariance)
        count = int(np.count_nonzero(answer.craters >= 0))
        return PoseFix(answer.gTb, answer.pose_covariance, count) if count >= _MIN_RIMS else None

    def _resected(self, rims: RimSet) -> PoseFix | None:
        """Pose by resection; None with too few rims or when it is not unique."""
        if len(rims) < _MIN_RIMS:
            return None
        data = self._dataset
        result = solve_robustly(ResectionProblem(MatchedRims.of(rims, data.catalog), data.camera.bTc))
        if result.status is not Status.SOLVED:
            return None
        pose = result.poses[0]
        return PoseFix(
            pose.gTb, rotate_position_block(pose.covariance, pose.gTb[:3, :3]), len(rims) - len(result.wrong)
        )

    def _rims(self, index: int) -> FoundRims:
        """Rims detected in an image; those of the last one are kept."""
        if self._found is None or self._found[0] != index:
            # Started from the crater network's rims, Apollo 15's arc drifts by 1.5 m/s instead of 0.9.
            self._found = index, find_rims(self._image(index))
        return self._found[1]

    def _image(self, index: int) -> GreyArray:
        """Image of a frame as a pinhole camera would take it.

        Its rims only guide the front end: an interpolated image is good enough, and all that follows assumes
        a pinhole.
        """
        camera = self._dataset.camera
        return undistorted(on_8_bit_scale(self._dataset.image(index), camera), camera)

    def _normalised(self, found: FoundRims) -> tuple[FloatArray, FloatArray]:
        charts, scale = normalised_chart(found.charts_px, self._dataset.camera.pinhole)
        return charts, found.covariance_px * np.outer(scale, scale)
