"""Figures of a report, one function a figure, and the tables that list them (`recording.FIGURES`, `loop.FIGURES`)."""
