"""The folder of a run: which files it holds, and what is in them.

metrics.json        errors of every estimator, share of outliers among its rims, calibration; wall times
truth.tum, NAME.tum trajectories in evo's TUM format (s, m, quaternion x y z w, in g)
states.parquet      states and covariances of every estimator, one row per estimator and frame
residuals.parquet   residuals of every rim, one row per rim and estimator, see `craternav_fg.runs.residuals`
figures/            PNG; for a data set with images contact_sheet.png shows frames with their rims
overlays/           PNG per frame, on request
run.toml            the data set, the estimators, their options, and software versions
"""

MARKER = "run.toml"
METRICS = "metrics.json"
STATES = "states.parquet"
RESIDUALS = "residuals.parquet"
FIGURES = "figures"
OVERLAYS = "overlays"
# The demo keeps its data set in the folder of the run.
DATASET = "dataset"
# Name of the ground truth among the trajectories.
TRUTH = "truth"
# All that a run's folder may hold; one that holds anything else is not replaced.
CONTENTS = ("*.toml", "*.tum", "*.json", "*.parquet", "*.html", FIGURES, OVERLAYS, DATASET)
