"""One-step-ahead residuals: observations, forward model, noise model and goodness of fit.

Other rooms take `observations`, `forward_model`, `whitening`, `noise_model`, `covariates`, `plate_observables`,
`lack_of_fit` and `prediction_errors`.
"""
