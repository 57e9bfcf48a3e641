"""The one error that a user can mend: it says what is wrong, what was got, what was expected, and where."""


class InputError(ValueError):
    """Bad input. Its text is one line; the commands print it and end with exit code 2."""

    def __init__(self, what: str, *, got: object = None, expected: str | None = None, where: object = None) -> None:
        parts = [str(what)]
        if got is not None:
            parts.append(f"got {got if isinstance(got, str) else repr(got)}")
        if expected is not None:
            parts.append(f"expected {expected}")
        text = ", ".join(parts)
        if where is not None:
            text = f"{where}: {text}"
        super().__init__(" ".join(text.split()))
