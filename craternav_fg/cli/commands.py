"""The commands in the order of the help: module and one-sentence description."""

from typing import NamedTuple


class Command(NamedTuple):
    """A command that is not imported yet.

    Attributes
    ----------
    help : str
        Help text of the command.
    modules : tuple of str
        In `craternav_fg.cli`.
    """

    help: str
    modules: tuple[str, ...]


COMMANDS = {
    "demo": Command(
        "Simulate a descent, reconstruct it with the default estimators, and compare them.", ("descents",)
    ),
    "simulate": Command("Simulate a scenario and write its data set (EuRoC/ASL layout).", ("descents",)),
    "check": Command(
        "Check a data set as `reconstruct` does before it begins, and summarise it.", ("data_check",)
    ),
    "reconstruct": Command("Reconstruct the trajectory of a data set.", ("descents",)),
    "compare": Command("Compare the estimators of one or more runs.", ("comparison",)),
    "evaluate": Command(
        "Check a run against an elevation model, a-priori states, or held-out frames.",
        ("evaluation",),
    ),
    "report": Command("Write a report: one interactive HTML page that works offline.", ("report",)),
    "montecarlo": Command(
        "Run a campaign: many trials of a scenario with the default estimators. Continue it if it exists.",
        ("campaigns",),
    ),
    "catalog": Command(
        "Crater catalogues: import, merge, refine, summarise, list, draw.",
        ("catalogs", "catalog_import", "catalog_merge", "catalog_refine"),
    ),
    "import": Command(
        "Import data sets and calibrations: ROS bags, Kalibr, ISIS cubes, images with SPICE or times.",
        ("importing", "bag_import"),
    ),
    "export": Command(
        "Export data sets and trajectories: ROS bags, Kalibr, TUM, KITTI, GeoJSON, KML, COLMAP.", ("exports",)
    ),
    "detect": Command("Detect crater rims in images without any prior.", ("detection",)),
    "identify": Command(
        "Identify the craters of an image, and the lander's pose, without any prior.", ("identification",)
    ),
    "pose": Command(
        "Compute the lander's pose from the matched rims of one image, without an initial guess.", ("pose",)
    ),
    "estimators": Command("List the estimators, including those of other packages.", ("listing",)),
    "sensors": Command("List the sensors, including those of other packages.", ("listing",)),
    "scenarios": Command("List the built-in scenarios.", ("listing",)),
    "reproduce": Command(
        "Reproduce figures and tables of Tian et al. (2019), with a verdict on each number.",
        ("reproduction",),
    ),
    "warmup": Command(
        "Compile all kernels, so that the first run does not have to; compiled code stays on disk.",
        ("warm_up",),
    ),
    "bench": Command(
        "Measure speed against GTSAM's own C++ factors, detection, or identification on real ground.",
        ("benchmark",),
    ),
}
