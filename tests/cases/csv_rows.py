"""What a CSV file says that something wrote."""

import csv


def csv_rows(path):
    """Lines of a file as dictionaries, by its heading."""
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
