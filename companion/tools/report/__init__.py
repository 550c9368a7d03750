"""The report of a flight: a folder with one page, its plots and an annotated video."""
