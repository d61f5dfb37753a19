"""Files of a recording, byte by byte: tables, frames while it runs, columns afterwards, checksums over all of it.

Other packages take `tables` (blocks and steps) and `disk` (files that a kill cannot tear).
"""
