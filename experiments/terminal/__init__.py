"""The terminal: progress, long work, Ctrl-C."""
