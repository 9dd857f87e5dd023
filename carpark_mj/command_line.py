"""What all commands share: errors of the user's making become one line."""

USER_ERRORS = (ValueError, OSError, OverflowError)


def one_line(error: BaseException) -> str:
    """What went wrong, in a line that names the file or the value."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"cannot use {error.filename}: {error.strerror}"
    if isinstance(error, OverflowError):
        return f"a number is too large, the seed perhaps: {error}"
    return " ".join(str(error).split())
