"""Foreign recordings: streamed in, checked, given a time base and steps; small tables of text and spreadsheets.

Other rooms take `import_recording`, `tables`.
"""
