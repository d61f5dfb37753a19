"""From a recording to a verdict; never imports `rig`."""
