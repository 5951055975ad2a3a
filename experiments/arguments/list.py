"""What `list` takes: nothing."""


def add_arguments(add):
    """Add no options."""
