"""What each command takes, and what its help ends with: read and checked before anything that takes long."""
