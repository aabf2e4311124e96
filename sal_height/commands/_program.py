"""The program `sal-height`: finds its commands and turns errors and signals into a message and an exit status."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from pkgutil import iter_modules

from cyclopts import App, CycloptsError, UnusedCliTokensError

from sal_height import __version__
from sal_height.commands._options import BAD_USE, CUT_OFF, DONE, INTERRUPTED, SHIPPED_PRESETS, epilogue
from sal_height.errors import UserError
from sal_height.extras import how_to_install_ros, is_of_ros

EXAMPLES = """
  sal-height run                            simulate the lidar over a street
  sal-height run --preset xband_relief      simulate the radar over terrain
  sal-height replay out/sal_spotlight/bag   compute the heights again
  sal-height figures                        the papers' figures and theory
  sal-height COMMAND --help                 options and examples of a command
"""

HELP_FLAGS = ("--help", "-h", "--version", "--install-completion")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    Args:
        arguments: words after `sal-height`; None: those of the process.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    _interrupt_on_termination()
    logging.basicConfig(format="sal-height: %(message)s")  # warnings look like other messages of the program
    try:
        status = _status(words)
        sys.stdout.flush()  # the reader may have closed the output
    except BrokenPipeError:
        return _cut_off()
    except SystemExit as ended:  # the printer of help ends the program itself
        if isinstance(ended.__context__, BrokenPipeError):
            return _cut_off()
        raise
    return status


def _status(words: list[str]) -> int:
    """Run a command and return its exit status; errors of the user become a message on stderr."""
    try:
        status = program()(words, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        return _complain(f"{_sentence_of(error)} See {_help_command(error)}.")
    except UserError as error:
        return _complain(str(error))
    except ModuleNotFoundError as error:
        if not is_of_ros(error.name or ""):
            raise
        return _complain(how_to_install_ros(error.name or "", words[0]))
    except KeyboardInterrupt:
        return INTERRUPTED
    if status is None:  # help or the version was printed
        return DONE if any(flag in words for flag in HELP_FLAGS) else BAD_USE
    return int(status)


def program() -> App:
    """The command line with all its commands."""
    app = App(
        name="sal-height",
        help="Height images from synthetic-aperture lidar and multi-beam radar, as a ROS 2 graph.",
        help_format="plaintext",
        help_epilogue=epilogue(EXAMPLES, "a check failed or a result is incomplete; the command's help says which"),
        version=f"sal_height {__version__}",
    )
    app.register_install_completion_command(help="Complete words with Tab in bash, zsh or fish.")
    for command in _commands():
        app.command(command)
    return app


def _commands() -> Iterator[App]:
    """The `app` of every module of this package whose name does not begin with an underscore."""
    package = import_module(__package__ or "")
    for module in iter_modules(package.__path__):
        if not module.name.startswith("_"):
            yield import_module(f"{package.__name__}.{module.name}").app


def _interrupt_on_termination() -> None:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does; a SIGHUP that `nohup` ignores stays ignored."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN:
        signal.signal(hangup, signal.default_int_handler)


def _cut_off() -> int:
    """Status after the reader of the output has closed it, as `head` does; nothing more is written to it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(nowhere, stream.fileno())
    return CUT_OFF


def _complain(sentence: str) -> int:
    sys.stderr.write(f"sal-height: {sentence}\n")
    return BAD_USE


def _sentence_of(error: CycloptsError) -> str:
    if isinstance(error, UnusedCliTokensError):
        tokens = error.unused_tokens or ()
        return f"There are more arguments than the command takes: {', '.join(map(repr, tokens))}{_preset_hint(error)}."
    return " ".join(str(error).split()).removesuffix(".") + "."


def _preset_hint(error: UnusedCliTokensError) -> str:
    """A hint for those who name the preset of a run as budget takes it, without the option."""
    (token, *_), (command, *_) = error.unused_tokens or ("",), error.command_chain or ("",)
    return f" (did you mean --preset {token}?)" if command in {"run", "live"} and token in SHIPPED_PRESETS else ""


def _help_command(error: CycloptsError) -> str:
    return " ".join(["sal-height", *(error.command_chain or ()), "--help"])
