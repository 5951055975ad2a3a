"""What `list` takes: nothing."""

__all__ = ["add_arguments"]


def add_arguments(add):
    """Add no options."""
