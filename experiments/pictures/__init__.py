"""The pictures of 002 that a campaign's results do not give; `python -m experiments run` draws them too."""
