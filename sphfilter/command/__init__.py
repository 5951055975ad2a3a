"""The commands of ``sphfilter``: a model file and a CSV file in, tables, files and pictures out."""
