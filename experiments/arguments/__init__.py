"""What each command takes: options and their checks, before anything is imported that takes long."""
