"""Missing terms as smooth curves of one covariate, found where no named effect suffices.

Other rooms take `discover`, `terms` and `symbolic`.
"""
