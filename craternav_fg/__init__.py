"""Factor-graph smoothing for crater-edge navigation of planetary landers.

>>> import craternav_fg as cn
>>> data = cn.Dataset.open("runs/data")
>>> result = cn.reconstruct(data, estimators=["smoother", "ekf"])
>>> cn.plot(result, data, "bounds").savefig("errors.png")

The names below are the public interface. Other modules are attributes as well, such as
`cn.evaluation.consistency`; the measurement equations are `cn.factors`. A module is imported when one of its
names is first used, so `import craternav_fg` is fast.
"""

import importlib
from typing import TYPE_CHECKING, Any

from factors import numba_cache as _numba_cache  # noqa: F401
from factors.lazy import submodules

if TYPE_CHECKING:
    from craternav_fg.body import Body as Body
    from craternav_fg.camera import Camera as Camera
    from craternav_fg.campaign.read import read_campaign as read_campaign
    from craternav_fg.campaign.run import CampaignOptions as CampaignOptions
    from craternav_fg.campaign.run import montecarlo as montecarlo
    from craternav_fg.catalogs.model import Catalog as Catalog
    from craternav_fg.dataset import Dataset as Dataset
    from craternav_fg.errors import CraternavError as CraternavError
    from craternav_fg.errors import EstimationError as EstimationError
    from craternav_fg.errors import InputError as InputError
    from craternav_fg.estimators.base import Estimator as Estimator
    from craternav_fg.estimators.batch import BatchSmoother as BatchSmoother
    from craternav_fg.estimators.batch_options import BatchOptions as BatchOptions
    from craternav_fg.estimators.ekf.filter import DistributedEkf as DistributedEkf
    from craternav_fg.estimators.ekf.filter import EkfOptions as EkfOptions
    from craternav_fg.estimators.graph import GraphOptions as GraphOptions
    from craternav_fg.estimators.online import FixedLagSmoother as FixedLagSmoother
    from craternav_fg.estimators.online import OnlineSmoother as OnlineSmoother
    from craternav_fg.estimators.registry import ESTIMATORS as ESTIMATORS
    from craternav_fg.evaluation.metrics import metrics as metrics
    from craternav_fg.matching.identify.search import identify as identify
    from craternav_fg.matching.identify.triple_index import TripleIndex as TripleIndex
    from craternav_fg.measurements import FrameMeasurement as FrameMeasurement
    from craternav_fg.measurements import KnownAttitude as KnownAttitude
    from craternav_fg.measurements import RimSet as RimSet
    from craternav_fg.pipeline.reconstruct import reconstruct as reconstruct
    from craternav_fg.pipeline.result import Reconstruction as Reconstruction
    from craternav_fg.plots.summary import plot as plot
    from craternav_fg.reports.write import report as report
    from craternav_fg.resection.efficient import solve as solve_pose  # noqa: F401
    from craternav_fg.runs.compare import compare as compare
    from craternav_fg.runs.read import read_run as read_run
    from craternav_fg.sensors.protocol import Sensor as Sensor
    from craternav_fg.simulation.scenario import simulate as simulate
    from craternav_fg.simulation.scenario_file import Scenario as Scenario
    from craternav_fg.simulation.scenario_file import load_scenario as load_scenario
    from craternav_fg.trajectory import Trajectory as Trajectory
    from craternav_fg.vision.guided_options import GuidedOptions as FrontEndOptions  # noqa: F401
    from craternav_fg.vision.network_detect import find_rims_network as detect  # noqa: F401

__version__ = "0.1.0"

# Public name: module, and its name there where that is another.
_PUBLIC = {
    "BatchOptions": "estimators.batch_options",
    "BatchSmoother": "estimators.batch",
    "Body": "body",
    "Camera": "camera",
    "CampaignOptions": "campaign.run",
    "Catalog": "catalogs.model",
    "CraternavError": "errors",
    "Dataset": "dataset",
    "DistributedEkf": "estimators.ekf.filter",
    "ESTIMATORS": "estimators.registry",
    "EkfOptions": "estimators.ekf.filter",
    "EstimationError": "errors",
    "Estimator": "estimators.base",
    "FixedLagSmoother": "estimators.online",
    "FrameMeasurement": "measurements",
    "FrontEndOptions": "vision.guided_options:GuidedOptions",
    "GraphOptions": "estimators.graph",
    "InputError": "errors",
    "KnownAttitude": "measurements",
    "OnlineSmoother": "estimators.online",
    "Reconstruction": "pipeline.result",
    "RimSet": "measurements",
    "Scenario": "simulation.scenario_file",
    "Sensor": "sensors.protocol",
    "TripleIndex": "matching.identify.triple_index",
    "Trajectory": "trajectory",
    "compare": "runs.compare",
    "detect": "vision.network_detect:find_rims_network",
    "identify": "matching.identify.search",
    "load_scenario": "simulation.scenario_file",
    "metrics": "evaluation.metrics",
    "montecarlo": "campaign.run",
    "plot": "plots.summary",
    "read_campaign": "campaign.read",
    "read_run": "runs.read",
    "reconstruct": "pipeline.reconstruct",
    "report": "reports.write",
    "simulate": "simulation.scenario",
    "solve_pose": "resection.efficient:solve",
}
__all__ = ["__version__", *_PUBLIC]
_module = submodules(__name__)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name == "factors":
        return importlib.import_module("factors")
    if name not in _PUBLIC:
        return _module(name)
    module, _, there = _PUBLIC[name].partition(":")
    value = getattr(importlib.import_module(f"{__name__}.{module}"), there or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
