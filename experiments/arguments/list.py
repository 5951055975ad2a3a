"""What `list` takes: nothing."""

__all__ = ["add_arguments"]


def add_arguments(parser):
    """Add no options."""
