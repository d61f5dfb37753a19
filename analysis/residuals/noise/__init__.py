"""Noise of residuals: its distribution, the uncertainty of each, and residuals made independent by it.

Other rooms take `noise_model`, `uncertainty`, `whitening`.
"""
