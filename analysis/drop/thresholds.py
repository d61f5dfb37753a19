"""Thresholds of a drop test's verdict: when a model is chosen or tied, and when none accounts for the data.

Limits of single detectors (an onset, a spot in a picture) stand with them.
"""

LEVEL_SIGMAS = 1.96  # half a 95 % interval of a normal distribution
CONTRADICTION_SIGMAS = 3.0  # of a height or a gravity that is known from elsewhere

# The choice, in nats of held-out log likelihood (decision 121).
LEAST_GAIN_NATS = 3.0  # by which a model beats another
CHANCE_LOSS_NATS = 0.5  # that a unit may lose where all units are said to agree on a gain
HINT_NATS = 1.0  # by which an effect seems to help without being beyond doubt
TIE_NATS = 6.0  # a model of other parameters is out of the tie set only this far behind

# Lack of fit. Each probability is that of noise; it is smaller where many such tests are made, or where few bounces
# have errors that are themselves only estimated.
STRUCTURE_CHANCE = 1e-4  # of a trend of what is left with the length of the flight
STRAY_CHANCE = 1e-4  # of a first or last event that is still an impact
UNEVEN_CHANCE = 1e-6  # of restitutions that differ only by their errors, or of floors at two heights: five sigma
FOLLOWED_CHANCE = 1e-3  # of restitutions above which a law follows them
CHANCE_CHAINS = 0.02  # chains as steady that are expected among as many events at random
LARGEST_SCATTER = 0.04  # of the restitution, relative: flat plates and round balls scatter by 0.02 at most
LARGEST_JITTER_S = 8e-3  # of an impact time: a phone's is a tenth of this
LARGEST_RISE = 0.08  # of the restitution over the speeds seen, relative: balls bounce less when faster
LARGEST_STEP = 0.005  # of the floor from impact to impact, of the fall: no lens is better along it
LARGEST_MISFIT = 0.03  # rms over the height of the flights: a fall and its bounces leave a hundredth
LEAST_REBOUND = 0.02
MOST_REBOUND = 0.985  # steel on steel; no ball keeps more of its speed
FAR_FROM_GRAVITY = (0.7, 1.4)  # of itself, beyond which a scale or a frame rate is refused
SAME_GRAVITY = 5e-3  # relative; no scale and no frame rate is better
TALLEST_FALL_M = 2.5  # beyond which a film was played slower than it was taken
LARGEST_BALL_M = 0.3  # likewise
