"""The catalogue of runs: a table of recordings, their tags, notes and verdicts, and the pages that show them.

All of it is made from the files and can be made again at any time; what a person wrote lies next to the recordings.
"""
