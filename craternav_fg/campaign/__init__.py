"""Monte Carlo campaigns: many trials of one scenario, on processes here or on a Dask cluster."""
