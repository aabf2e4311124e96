"""The one exception whose text is written for the user."""


class UserError(ValueError):
    """Something from outside (file, parameter, message) cannot be used.

    The text is one sentence: what is wrong, where, and what is allowed. The command line prints it and exits with
    status 2; nodes count it and carry on.
    """
