"""One figure that sums up a reconstruction or a run."""

from matplotlib.figure import Figure

from craternav_fg.dataset import Dataset
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.plots.trajectories import draw_errors, draw_sigmas
from craternav_fg.runs.read import Run


def plot(result: Reconstruction | Run, dataset: Dataset | None = None) -> Figure:
    """Draw every estimator's errors with 3 sigma against the truth; without a truth what each claims.

    Parameters
    ----------
    result : Reconstruction or Run
        What `reconstruct` gave, or a run's folder read by `read_run`.
    dataset : Dataset, optional
        Whose truth the errors are against; a run brings its own.

    Returns
    -------
    matplotlib.figure.Figure
    """
    if isinstance(result, Run):
        truth, rims = result.truth, result.metrics["craters_per_frame"]
    else:
        truth = None if dataset is None else dataset.truth
        rims = [len(frame.rims) for frame in result.frames]
    if truth is None:
        return draw_sigmas(result.trajectories, rims)
    return draw_errors(result.trajectories, truth, rims)
