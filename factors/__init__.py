"""The measurement equations of crater-edge navigation, each with its GTSAM factor."""
