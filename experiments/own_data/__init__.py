"""The command `filter`: measurements and a model of one's own, from files."""
