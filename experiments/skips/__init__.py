"""What is left out where a scene does not need it, measured with and without."""
