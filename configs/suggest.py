"""The known name that somebody probably meant, for error messages."""

import re
from collections.abc import Iterable
from difflib import get_close_matches


def closest(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str | None:
    """Return the one of the ``known`` names that ``name`` was probably meant to be; None if none is likely.

    Capital letters, spaces, dots and underscores make no difference. It is the only name that ``name`` is the beginning
    or a part of, else the most similar one, if it is similar enough (``cutoff`` as of ``difflib``).

    >>> closest("weak", ["weak-integrability", "least-squares"]), closest("Least_Square", ["weak", "least-squares"])
    ('weak-integrability', 'least-squares')
    >>> closest("nosuch", ["sphere_quick", "mozart_5gels"]) is None
    True
    """
    by_plain = {_plain(one): one for one in known}
    word = _plain(str(name))
    if word in by_plain:
        return by_plain[word]
    for fits in (str.startswith, str.__contains__):
        found = [one for plain, one in by_plain.items() if len(word) >= 3 and fits(plain, word)]
        if len(found) == 1:
            return found[0]
    near = get_close_matches(word, by_plain, n=1, cutoff=cutoff)
    return by_plain[near[0]] if near else None


def suggested(name: str, known: Iterable[str], otherwise: str) -> str:
    """What an error says was expected: the one of the ``known`` names that was probably meant, else ``otherwise``."""
    near = closest(name, known)
    return f"{near!r} (did you mean it?)" if near else otherwise


def _plain(name: str) -> str:
    return re.sub(r"[\s._]+", "-", name.strip().lower())
