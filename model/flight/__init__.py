"""One flight, exactly: proofs and closed forms.

Other rooms take `windows`, `branches`, `numerics`.
"""
