"""The command line `craternav`: a module for each group of commands."""

from craternav_fg.cli import (
    benchmark,
    campaigns,
    catalog_import,
    catalogs,
    descents,
    detection,
    identification,
    pose,
    report,
    reproduction,
)
from craternav_fg.cli.app import app, main

__all__ = [
    "app",
    "benchmark",
    "campaigns",
    "catalog_import",
    "catalogs",
    "descents",
    "detection",
    "identification",
    "main",
    "pose",
    "report",
    "reproduction",
]
