"""Targets that switch between modes, as a command."""
