"""Consistency campaigns: many runs of all filters, and a page that says which of them can be believed."""
