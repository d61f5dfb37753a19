"""One module a kind of channel, and `registry`, which lists them in the order of a frame."""
