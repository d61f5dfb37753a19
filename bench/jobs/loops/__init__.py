"""Jobs around a closed loop: runs judged together or chosen one after another, what a loop found stored or compared.

`runs_and_files` has the file of a loop, which catalogue and reports read; `drawing` is the process that draws one.
"""
