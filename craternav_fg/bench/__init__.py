"""What this library's factors and optimisers cost, against graphs of GTSAM's own C++ factors."""
