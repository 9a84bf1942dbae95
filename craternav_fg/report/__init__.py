"""What a run or a campaign comes to, as one page that needs nothing but a browser."""
