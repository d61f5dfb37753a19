"""Joint verdicts over many runs of one rig: what they share, what belongs to a run, and what drifts between them.

`join_runs` reduces one recording at a time to a small summary, and combines the summaries.
"""
