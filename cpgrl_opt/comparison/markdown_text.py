"""Text of others in Markdown: names of solvers and of files, and what recordings say, stay text.

A character that could mean something to Markdown becomes a numeric reference, which never does (CommonMark, 6.2).
"""

import re

# Line breaks and other controls, and what turns the direction of writing. Surrogates stay: bytes of a file's name.
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]+")
# Underscores between letters, as in x86_64, and < before a figure mean nothing.
_MEANING = re.compile(r"[\\`*\[\]|&~$]|<(?=[A-Za-z/!?])|(?<![^\W_])_|_(?![^\W_])")
_PLAIN = re.compile(r"[\w.:,/+@=-]+")


def text(words: str) -> str:
    """The words, as they stand, in a line of Markdown or in a cell of a table."""
    return _MEANING.sub(lambda found: f"&#{ord(found[0])};", _UNSEEN.sub(" ", words))


def code(name: str) -> str:
    """A name, set as code."""
    return f"`{name}`" if _PLAIN.fullmatch(name) else f"<code>{text(name)}</code>"


def block(command: str) -> str:
    """A command, set as a block of code of one line."""
    return "    " + _UNSEEN.sub(lambda found: found[0].encode("unicode_escape").decode(), command)
