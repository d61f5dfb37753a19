"""The command line `bench`: with `shakerbench` the only package that imports all the others.

Other packages take `jobs`, `predict`, `profiles`, `terminal`.
"""
