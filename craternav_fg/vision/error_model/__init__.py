"""Error model of measured rims: what happens to a rim's covariance, from the ellipse fit to the factor.

A measured rim is an ellipse chart (`craternav_fg.ellipse`), and its covariance is 5 x 5. Its error has four
independent parts: white (new in each frame), time-correlated per crater, of the map, and shared by all rims.
The steps in their order, with who applies each, and why:

In one image, for one rim:

1. Scatter of the edge points. `ellipse_kernel.fit` gives the covariance of the robust fit, with the reference
   brightness of the crater's surroundings as a further unknown. Errors that neighbouring points share enlarge
   it: they do not average out.
2. Irregular outline. `ellipse_kernel.fit` estimates harmonics of the outline beside the ellipse: where points
   are missing, an ellipse through the others is as uncertain as the outline deviates from it.
   `error_model.outline.unseen_deviation`, applied by `rim_fitting.RimFitter.fit`, repeats the fit
   with the deviation that the other rims of the frame show: one rim's points determine it poorly.
3. Wrong reference brightness. An irregular outline biases the estimate of the unknown brightness by more than
   step 1 claims: `ellipse_kernel.BRIGHTNESS_ERROR_PER_OUTLINE`.
4. Systematic floor. `error_model.systematic.floor_covariance`, applied by `ellipse_fit.refine_rim`, adds what
   no number of points averages out: the fit's residuals do not show a rim crest that is displaced as a whole.
   `rim_fitting.RimFitter` has it from how much the brightness of the ground varies, and how far edges move
   with it: twice as far with the sun 55 deg high as with 40.
   From here on a rim carries `error_model.systematic.RimErrors`: the whole covariance, the systematic part of
   it (steps 2 to 4), and the root of what step 3 contributes to that.

In one image, for all its rims:

5. Scatter of the frame. `error_model.frame_scatter.variance_factor`, applied by `GuidedFrontEnd`, scales the
   covariances if the rims scatter more about one common pose than they claim: on rough terrain all rims are
   worse than their own edge points show.
6. Correlation. `error_model.correlated.split`, applied by `GuidedFrontEnd`, separates the part of the
   systematic error that a crater keeps (`RimSet.correlated`), adds the errors that the catalogue states
   (`RimSet.of_map`, see `catalogs.map_errors`) and the errors that all rims share (`RimSet.shared`), and
   leaves the rest white: the ground under a crater is the same in the next frame, so
   its error does not average out. `RimSet.fused_white` is for the estimators alone: the covariance of a
   rim says what it errs, but rims that scatter more than they claim err alike with their neighbours.

7. Shape. Where the map states errors, `error_model.shape_scatter.shape_variance_factors`, applied by
   `GuidedFrontEnd`, enlarges the variances of rims whose shape contradicts the map: their places are as
   wrong.

Over the frames of a descent:

8. Pooling. `error_model.pooling.PooledErrors`, applied by `pipeline.tracking.Tracker`, replaces the
   covariances of irregular rims by means over the frames that show the same crater: a weighted mean over
   frames would follow those that happen to claim the smallest covariance.

9. Errors of the map. `error_model.steady_roots.with_steady_roots`, applied by the same, gives those of each
   crater one size in all frames, after 7 has enlarged them in single ones.

In an estimator:

10. Evaluation at the prediction. `RimSet.expected_at`, applied through
   `estimators.measurement_weighting.with_predicted_covariances`, evaluates the covariance at the rim that the
   pose predicts: taken at the measured one, it gives rims that were measured too large too much weight.
11. Craters that contradict the others. `estimators.crater_scatter`, applied by the batch smoother, enlarges
   the variances of craters whose rims err by more than they state, as in a distribution with heavy tails.
12. Variables or inflation. `estimators.correlated_errors.RimErrorStates` makes the time-correlated part a
   Gauss-Markov process per crater, the error of the map a constant vector per crater, and the shared part one
   constant vector. Half of the variance of a place on the map changes like the rim's own errors
   (`RimSet.with_changing_place`). Estimators without such variables call `RimSet.inflate_correlated`: these
   parts count as white, with a larger variance.
13. Factor. `estimators.graph.add_frame` whitens with what is left, `RimSet.fused_white_covariance` or the
   inflated covariance, in `factors.conic_shape`; its robust loss bounds the influence of wrong matches.

Arcs of rims, of which too little is seen for an ellipse, take the same way with one standard deviation per
point: `error_model.common_growth` takes from them the growth that the whole rims of the frame show, then
`vision.arcs.judge` (steps 1 to 5), `error_model.correlated.arc_sigma_px` and `shared_of_arcs` (step 6),
`ArcSet.inflate_correlated` and `RimErrorStates.enter_arcs` (step 11).
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
