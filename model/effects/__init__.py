"""Every effect that may be added to the ideal ball: one file an effect; adding one edits nothing else.

Other rooms take `registry` (find an effect by its name, rows of parameters), `routing` (where declared effects act) and
`base` (what an effect is made of).
"""
