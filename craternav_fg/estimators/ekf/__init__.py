"""The distributed extended Kalman filter of the paper, and its exact counterpart."""
