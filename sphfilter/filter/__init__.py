"""Bayes' rule and the loop: the update, the filter with state, its budget and its results."""
