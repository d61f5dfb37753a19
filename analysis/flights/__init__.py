"""Single pass over a recording, the table of flights, their classification, and their comparison with the model.

Other rooms take `assemble`, `table`, `scan`, `classify`, `compare` and `events_corrected`.
"""
