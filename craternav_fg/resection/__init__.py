"""Static navigation: the pose from the matched rims of one image, without a motion model."""
