"""The command `sweep`: campaigns over a range of intervals and noises."""
