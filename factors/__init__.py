"""The measurement equations of crater-edge navigation, each with its GTSAM factor.

`factors.kernels.validity` says what a factor answers at poses from which a crater has no image.
"""
