"""Input and output at a terminal: messages, tables, progress, displays, signals.

Other packages take `console`, `comparison`.
"""
