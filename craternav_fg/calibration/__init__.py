"""Fitted constants: scripts that regenerate them from seeds.

`python -m craternav_fg.calibration [NAME...]` prints each constant of some families as shipped and as
regenerated; slow tests (`tests/calibration`) check that they agree. The truth of simulations reaches the fits
alone. A family is the function of that name, in the module of that name or, of the first two, in
`blind_detection`, and of `outline_brightness`, in `correlated_errors`.

The data that the values were once fitted to are not kept; those of the scripts were chosen later, from what
the sources and the history say of the first.

Standard errors follow from the scatter between independent images, descents or trials. A fitted value holds
within three of them. It is "confirmed" if three are at most the shipped value and the regenerated one. Else
the data hardly determine it, and zero might pass as well: the value is a choice, which is "not contradicted".
What follows from Gaussian errors alone is "exact" up to its rounding. "At least" is a bound, on the safe
side. "Kept" are values that the rendered data do not give: the module says what they give, and what gets
worse with that.

==================== ============================================= ======= ================================
family               constant                                      shipped regenerated
==================== ============================================= ======= ================================
blind_quality        detect.QUALITY_WEIGHTS: correlation           32      22 ± 3, kept
..                   agreeing share of the normals                 6.5     6.0 ± 2.7, not contradicted
..                   scatter, radii                                -50     -111 ± 26, not contradicted
..                   covered share of the rim                      6.9     8.7 ± 2.8, not contradicted
..                   detect.QUALITY_OFFSET                         -30.4   -23.0 ± 3.0, confirmed
candidates           candidates.TEMPLATE_SIZE_FACTOR               1.07    1.036 ± 0.004, kept
..                   detect.CONTRAST_FACTOR                        1.3     1.58 ± 0.07, kept
..                   detect.SUN_VOTE_CHANCE_SHARE                  0.22    at least 0.197 ± 0.001
reference_brightness GuidedOptions.brightness_sigma_share          0.02    at least 0.011 ± 0.001
..                   blind_fit.BRIGHTNESS_SIGMA                    0.05    0.061 ± 0.008, confirmed
rim_floor            GuidedOptions.level_scatter_share             0.09    0.099 ± 0.005, confirmed
..                   level_rim_share                               0.12    0.138 ± 0.023, confirmed
correlated_errors    CorrelatedErrorOptions.crater_share           0.7     0.64 ± 0.05, confirmed
..                   brightness_share                              0.6     0.49 ± 0.15, confirmed
..                   camera_shift_px, px                           0.03    0.0025 ± 0.0030, kept
..                   sun_shift_px, px                              0.03    0.041 ± 0.008, confirmed
..                   stretch_px, px                                0.04    0.056 ± 0.014, not contradicted
..                   stretch_share, radii                          0.00005 0.000053 ± 0.000012, confirmed
..                   size_px, px                                   0.04    0.042 ± 0.005, confirmed
..                   size_share, radii                             0.003   0.0006 ± 0.0003, kept
..                   RimErrorOptions.decay_shape_change            0.8     0.9 ± 0.2, confirmed
outline_brightness   ellipse_kernel.BRIGHTNESS_ERROR_PER_OUTLINE   0.5     0.54 ± 0.07, confirmed
arcs                 CorrelatedErrorOptions.arc_px, px             0.1     0.03 ± 0.05, not contradicted
..                   arc_share, radii                              0.006   0.0079 ± 0.0014, confirmed
pooling              pooling.MEMORY                                1.0     0.94 ± 0.23, confirmed
..                   pooling.PRIOR_FRAMES                          2       0.0001 ± 0.0001, kept
variance_inflation   correlated_errors.VARIANCE_INFLATION          4.4     3.30 ± 0.24, kept
sun_tilt             SunOptions.crater_floor_rad, squared, deg2    0.09    -0.02 ± 0.34, not contradicted
..                   crater_floor_oblique_rad, squared, deg2       56      65 ± 19, not contradicted
..                   floor_rad, squared, deg2                      4       5.7 ± 1.1, confirmed
..                   floor_oblique_rad, squared, deg2              64      118 ± 45, not contradicted
crest_asymmetry      crest_asymmetry.DISPLACEMENT                  table   exact
..                   crest_asymmetry.FLANK_LIFT                    0.031   exact
crest_blur           crest_blur.LOG_FOUND, CREST_SPREAD            tables  exact
robust_moments       ellipse_bias.PSI_VARIANCE                     1.0526  exact
..                   ellipse_bias.PSI_CURVATURE                    0.4428  exact
..                   ellipse_bias.PSI_MIXED                        0.5720  exact
..                   ellipse_kernel.PSI_SLOPE_VARIANCE             0.1597  exact
..                   ellipse_kernel.SCALE_VARIANCE                 2.33    2.31 ± 0.02, confirmed
..                   ellipse_kernel.OUTLINE_VARIANCE_FACTOR        1.4     1.43 ± 0.03, confirmed
crest_heights        heights.CREST_SHARE                           0.021   0.0233 ± 0.0023, confirmed
..                   heights.CREST_SIGMA_SHARE                     0.014   0.0175 ± 0.0016, confirmed
..                   heights.CREST_STEPS                           5       2.3 ± 1.0, not contradicted
rim_tilts            CorrelatedErrorOptions.map_tilt_rad, rad      0.04    0.042 ± 0.010, confirmed
==================== ============================================= ======= ================================

`crest_heights` and `rim_tilts` are measured on real ground: `python -m craternav_fg.calibration rim_tilts
FOLDER` with the folder of the public files. So are `common_shift`, which gives
`catalogs.map_errors.CRATER_FREEDOM` (4) and the scenarios' `common_place_sigma_m`, and `posed_images`,
which gives `mapping.posed_images.IMAGES_PER_VIEW` (3), both without standard errors, `catalogue_errors`,
which gives the errors of a published map as an elevation model shows them, and `pull_of_prediction`, which
shows what `GuidedOptions.recentrings` and `searches` are for.

`GuidedOptions.brightness_slope_per_px` is not regenerated: it was set by the chi-square of single rims above
100 px, whose median is right with it (0.99 over 25 rims) and hardly changes with three times of it (1.00).

Not fitted but chosen, each with its reason where it stands:

- Gates: what is too uncertain, small or dark to use, in `GuidedOptions`, `BlindOptions`, `ArcOptions`,
  `EdgeOptions`, `FitOptions` and in the modules of `vision`; among them the minimum correlation of a
  candidate and the largest shift of its rim. A wrong rim costs more than a missed one.
- `CorrelatedErrorOptions.excess_white_share`, a guard. On ground of another renderer (25 descents) the
  position RMS of the smoother is 12 % larger with 2 than with 0, and its ANEES 4 and 7 (sun 22 to 50 deg, and
  58 to 82 deg) in place of 5.4 and 9; on rendered descents to the Moon and to Bennu and over real ground it
  has no effect. It counts up to a variance factor of 3, see `error_model.correlated`.
- `RimErrorOptions.constant_place_share`: over real ground (eleven rendered descents of `gld100_*`) the
  smoother's position RMS and ANEES are 214 m and 5.6 with 0, 217 m and 5.7 with 0.5, 280 m and 9.7 with 1;
  where places of a simulated map are off by 20 m, 15.7 m and 9.0, 13.9 m and 7.3, 8.2 m and 4.6.
- `RimErrorOptions.region_overlap` and `region_correlation`: with 0.8 and 0.7 the smoother's position RMS and
  ANEES are 1.24 m and 4.6 in six rendered descents to the Moon, 4.09 m and 8.9 in four to Dione; 0.5 and 0.7
  give 1.26 m and 4.7, 4.15 m and 9.2, 0.8 and 0.85 1.25 m and 4.6, 4.10 m and 9.1, constant errors 1.24 m and
  5.1, 4.19 m and 10.4.
- Expected deviations of outlines before they are seen (`FitOptions.outline_share`,
  `error_model.outline.IRREGULARITY_FACTOR`, `pooling.MIN_OUTLINE_SHARE`), `ArcOptions.shared_px`, weak
  priors of `edge_kernel`, `ground_level` and `wall_shading`, floors of blind and coarse fits.
- The canonical crater (`vision.crater_profile`): Pike (1977); its rounding is estimated with each rim. It is
  extrapolated from two smoothings as if crests were narrow against the blur. Of wider ones, sizes come out
  0.02 to 0.07 px too small.
- What is usual of the photometric law (`vision.reflectance`), before the rims of an image show it.
- `intrinsics_error._ACROSS`, from the deviations of two scenarios with a wrong focal length.
- Matching, acquisition and identification (`matching`): priors on noise, missing and false craters, gates and
  limits of chance. They are as wide as images and catalogues of all kinds are, not as one set of data.
- Relocalisation, tracking, GNC and all numerical limits of the estimators.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
