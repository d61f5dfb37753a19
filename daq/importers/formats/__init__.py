"""Foreign files as tables of columns, one format a file.

Other rooms take `open`, `columns`.
"""
