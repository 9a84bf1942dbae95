"""Benchmark: cost of factors, estimators, front end and renderer; ratios against GTSAM's own C++ factors."""
