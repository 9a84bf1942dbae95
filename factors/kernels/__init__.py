"""Compiled residuals and Jacobians: numba and numpy only."""
