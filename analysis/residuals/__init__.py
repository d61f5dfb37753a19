"""One-step-ahead residuals: observations, forward model, noise model and goodness of fit.

Other rooms take `observations`, `forward_model`, `covariates`, `lack_of_fit`, `prediction_errors`, and what `noise/`
and `plate_data/` offer.
"""
