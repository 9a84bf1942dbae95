"""From a data set to trajectories: front end, tracking, relocalisation, estimators."""
