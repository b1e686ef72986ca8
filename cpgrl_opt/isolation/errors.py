"""How a call in another process can end without an answer."""


class IsolationError(RuntimeError):
    """The call gave no answer; the message says what happened instead."""


class HangError(IsolationError, TimeoutError):
    """The time was up; the message says where the code was, if that is known."""


class CrashError(IsolationError):
    """The process ended; the message has its exit code or signal and what it last wrote."""


class MemoryLimitError(IsolationError, MemoryError):
    """The call asked for more memory than it was given."""


class AnswerError(IsolationError):
    """The answer could not be brought back, since it cannot be pickled or unpickled; the message says why."""
