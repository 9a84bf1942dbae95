"""Crater identification without a prior pose: which catalogue crater each rim is, and where the camera was.

Input are the ellipses of one image and a catalogue. The position is unknown; the attitude may be known.
The algorithm, in order, with the module of each step:

1. `triple_index`: once per catalogue, each crater is grouped with pairs of its nearest neighbours of at least
   its size. Two side lengths and three sizes, over the perimeter, describe such a triple; they depend neither
   on scale nor on rotation. A k-d tree (`kd_tree`) holds all triples.
2. `view`: the ellipses are undistorted and described by directions, sizes and ellipse charts.
3. `nadir`: most craters are nearly circular, so the common foreshortening of the rims shows the vertical.
4. `triple_search`: with the vertical, rims are projected to the sphere up to scale. Triples of neighbouring
   rims are looked up in the index; each hit gives the altitude and a rotation, thus a pose (`hypothesis`).
   The pose is scored by how many further rims it puts on craters of their size, and how many craters there
   are around; the best poses are kept. Likely rims come first, and count more. A wide search examines
   many times as many hits, whose scores count only rims that are very near to their craters; a deep one
   begins with triples of a few rims that are likely and large, wherever they are.
   `pair_search`: then a deep search tries all pairs of craters for pairs of rims that are large over their
   distance: where an image shows few of a map's craters, it shows hardly any triple of neighbours.
5. `single_rim_search`: with a known attitude, a single rim taken for a crater gives the position. Used when
   triples gave no answer.
6. `expand`: the best poses are refined by Gauss-Newton (`pose_fit`) on all rims that they explain, and rims
   and craters are re-associated, until the pairs no longer change. The noise of the rims is estimated
   from their residuals (`noise`). Promising poses are found again from other starts, as without the pairs
   that pull most (`expansion`): one wrong pair may distort a pose so that it stays.
7. `evidence`: the pose is believed when so many agreeing rims are improbable by chance over all poses that
   were searched. With the image at hand, further craters that the pose predicts count as well: whether the
   image's shading shows them (`shading`). Two poses of similar evidence are ambiguous.
8. `refine`: the pose that is returned and its covariance are averaged over the unknown noise. `answer` adds
   the errors of the map, of unknown intrinsics, and of a pair that pulls unusually: it may be wrong.

`search` runs these steps (`search.identify`); `detected` does so for rims some of which are coarse. `options`
and `result` say what it takes and returns; `craters` holds the catalogue as compiled code takes it.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
