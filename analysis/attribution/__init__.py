"""Attribution: which effects of the library are missing, by stepwise selection on held-out steps.

Other rooms take `selection`, `hypothesis`, `candidates`, `choice`, `chance`, `fit` and `coarse_search`.
"""
