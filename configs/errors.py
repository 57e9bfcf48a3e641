"""Errors that the commands report in one line: bad input, which a user can correct, and unfinished work."""

from huesphere.configs.visible import visible


class InputError(ValueError):
    """Bad input: what is wrong, what was got, what was expected, and where. The commands end with exit code 2."""

    def __init__(self, what: str, *, got: object = None, expected: str | None = None, where: object = None) -> None:
        parts = [str(what)]
        if got is not None:
            parts.append(f"got {got if isinstance(got, str) else repr(got)}")
        if expected is not None:
            parts.append(f"expected {expected}")
        text = ", ".join(parts)
        if where is not None:
            text = f"{where}: {text}"
        super().__init__(visible(" ".join(text.split())))

    def __reduce__(self) -> tuple[type["InputError"], tuple[str]]:
        return InputError, (str(self),)


class Unfinished(RuntimeError):
    """Work that ended with some of it not done, each part of which is recorded. The commands end with exit code 1."""

    def __init__(self, text: str) -> None:
        super().__init__(visible(text))
