"""Report of a closed loop, or pictures of runs judged together, drawn by a process of its own.

``python -m bench.jobs.drawing`` reads from standard input what `bench.jobs.loops.drawn` pickled,
and prints the path of what it wrote, or, with exit status 2, why it could not be written. Decision 446.
"""

from __future__ import annotations

import pickle
import sys

from analysis.loop.result import ClosedLoop
from analysis.report.figures.several import write_pictures
from analysis.report.page import write_report
from bench.terminal.console import DEFECTS, EXIT_FAILED, EXIT_USAGE, end_with_defect, progress_bar
from daq.setup.errors import InputError


def main() -> int:
    """Draw what standard input holds; returns the exit status."""
    found, folder, quiet, more = pickle.load(sys.stdin.buffer)
    try:
        with progress_bar(quiet) as bar:
            if isinstance(found, ClosedLoop):
                written = write_report(found, folder, progress=bar, **more)
            else:
                written = write_pictures(found, folder, **more)
    except (InputError, OSError) as error:  # as of a full disk
        sys.stdout.buffer.write(str(error).encode("utf-8"))
        return EXIT_USAGE
    except DEFECTS as error:
        end_with_defect(error)
    except KeyboardInterrupt:  # the process that asked has had it too, and says so
        return EXIT_FAILED
    sys.stdout.buffer.write(str(written).encode("utf-8"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
