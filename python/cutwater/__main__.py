"""The command line: ``cutwater``, or ``python -m cutwater``."""

from __future__ import annotations

import signal
import sys

from . import _core
from ._tools import _program


def main() -> int:
    """Runs the command of ``sys.argv`` and returns its exit code."""
    # The commands catch signals themselves. Those that were ignored at the start stay ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _core.command_line(["cutwater", *sys.argv[1:]], _program())


if __name__ == "__main__":
    sys.exit(main())
