"""Ctrl-C, and other signals that end a program, wait for a compiled call to end."""

import signal
import threading
from typing import Any

_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


class InterruptsHeld:
    """A context in which Ctrl-C is only noted; it takes effect at its end. So are SIGTERM and SIGHUP if they raise.

    numba unpacks a function that it is handed in C, and loses a KeyboardInterrupt raised there: what comes out is a
    TypeError about something else. Compiled code does not look for signals either way, so nothing waits longer.
    Signals are the main thread's business; elsewhere, and where Python did not install the handler, this does nothing.
    """

    def __enter__(self) -> None:
        self.noted: list[int] = []
        self.handlers: dict[int, Any] = {}
        if threading.current_thread() is threading.main_thread():
            found = {number: signal.getsignal(number) for number in _ENDING}
            # What ends the process by default, SIGINT apart, cannot raise anything that numba would lose.
            self.handlers = {
                number: handler
                for number, handler in found.items()
                if callable(handler) or (number == signal.SIGINT and handler is not None)
            }
        for number in self.handlers:
            signal.signal(number, self.note)

    def note(self, number: int, _: Any) -> None:
        """The handler meanwhile."""
        self.noted.append(number)

    def __exit__(self, *exception: object) -> None:
        for number, handler in self.handlers.items():
            signal.signal(number, handler)
        for number in self.noted[:1]:
            signal.raise_signal(number)  # to whatever it was: a function, default or ignored
