"""Devices behind the protocol of `rig.backends.base`, one file each.

Other rooms take `registry`, `base`, `portaudio`, `simulated`.
"""
