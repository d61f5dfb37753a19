"""Foreign recordings: streamed in, checked, given a time base and steps.

Other rooms take `import_recording`.
"""
