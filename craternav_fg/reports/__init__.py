"""The report of a run or a campaign: one HTML page that needs nothing but a browser."""
