"""Attribution: which effects of the library are missing, by stepwise selection on held-out steps.

Other rooms take `selection`, `hypothesis`, `candidates`, `comparison`, `fit`, `priors` and `coarse_search`.
"""
