"""The recorder: a process of its own behind a shared ring, so that nothing that a run does can delay a sample.

Other packages take `recorder_process`.
"""
