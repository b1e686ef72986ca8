"""Ctrl-C that waits for a compiled call to end."""

import signal
import threading
from typing import Any


class InterruptsHeld:
    """A context in which Ctrl-C is only noted; it takes effect at its end.

    numba unpacks a function that it is handed in C, and loses a KeyboardInterrupt raised there: what comes out is a
    TypeError about something else. Compiled code does not look for signals either way, so nothing waits longer.
    Signals are the main thread's business; elsewhere this does nothing. It costs 10 µs.
    """

    def __enter__(self) -> None:
        self.noted: tuple[Any, ...] = ()
        self.handler: Any = None
        if threading.current_thread() is threading.main_thread():
            self.handler = signal.signal(signal.SIGINT, self.note)

    def note(self, *event: Any) -> None:
        """The handler meanwhile."""
        self.noted = event

    def __exit__(self, *exception: object) -> None:
        if self.handler is not None:
            signal.signal(signal.SIGINT, self.handler)
            if self.noted and callable(self.handler):
                self.handler(*self.noted)
