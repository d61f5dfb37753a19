"""One file per back end, behind the protocol of `rig.backends.base`."""
