"""One flight, exactly: proofs and closed forms.

Other rooms take `first_landing`, `branches`, `numerics`, `precision`.
"""
