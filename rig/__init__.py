"""The rig: everything that moves the plate; never imports `model` or `analysis`.

Other rooms take `profile`.
"""
