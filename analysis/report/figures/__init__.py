"""Figures of a report, one function a figure, and the table that lists them (`table`)."""
