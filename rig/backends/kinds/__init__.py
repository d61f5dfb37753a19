"""One module a kind of back end: the options of its ``[backend]`` table and the function that opens it.

Other rooms take `base`, `soundcard`, `soundcard_serial`. Modules here import no device code, so that a profile
is checked without it.
"""
