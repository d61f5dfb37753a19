"""The frames file: a recording while its run lasts, written block by block, and read whatever became of it.

Other rooms take `frame_file`, `frame_writer`, `marked_frames`.
"""
