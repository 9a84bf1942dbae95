"""Factor-graph smoothing for crater-edge navigation of planetary landers."""

__version__ = "0.1.0"
