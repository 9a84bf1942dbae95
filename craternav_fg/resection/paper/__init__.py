"""The methods of Tian et al. (2019) for one image, as published."""
