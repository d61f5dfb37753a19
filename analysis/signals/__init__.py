"""Recordings as pieces of volts in bounded memory.

Other rooms take `stream`.
"""
