"""Other toolkits' interfaces to the filter."""
