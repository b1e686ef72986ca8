"""Ctrl-C that waits for a compiled call to end."""

import signal
import threading
from typing import Any


class InterruptsHeld:
    """A context in which Ctrl-C is only noted; it takes effect at its end.

    numba unpacks a function that it is handed in C, and loses a KeyboardInterrupt raised there: what comes out is a
    TypeError about something else. Compiled code does not look for signals either way, so nothing waits longer.
    Signals are the main thread's business; elsewhere, and where Python did not install the handler, this does nothing.
    """

    def __enter__(self) -> None:
        self.noted = False
        self.handler: Any = None
        if threading.current_thread() is threading.main_thread():
            self.handler = signal.getsignal(signal.SIGINT)
        if self.handler is not None:
            signal.signal(signal.SIGINT, self.note)

    def note(self, *_: Any) -> None:
        """The handler meanwhile."""
        self.noted = True

    def __exit__(self, *exception: object) -> None:
        if self.handler is not None:
            signal.signal(signal.SIGINT, self.handler)
            if self.noted:
                signal.raise_signal(signal.SIGINT)  # to whatever it was: a function, default or ignored
