"""Choice of the next steps of a run: where the leading explanations differ most for the rig's time.

Other rooms take `explanations`, `choice` and `stake`.
"""
