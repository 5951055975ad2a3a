"""`run sunspots`: forecasts of measured data, and their scores."""
