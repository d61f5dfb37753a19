"""Sample losses and clocks: lost samples found by loop-back, two clocks joined, serial frames decoded.

Other rooms take `sample_loss`, `loss_search`, `clock_sync`, `serial_frames`.
"""
