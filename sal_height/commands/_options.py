"""Options that mean the same in every command, and the texts common to all commands."""

from __future__ import annotations

import gc
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from cyclopts import App, Group, Parameter, Token
from cyclopts.validators import Number

import sal_height
from sal_height.errors import UserError
from sal_height.renamed import with_new_names

if TYPE_CHECKING:
    from sal_height.graph.plan import Execution, Processes
    from sal_height.nodes.transport.domain import DomainChoice

DONE, FAILED, BAD_USE, INTERRUPTED, CUT_OFF = 0, 1, 2, 130, 141
"""Exit statuses. The meaning of FAILED is stated in the help of each command."""

SHIPPED_PRESETS = sorted(path.stem for path in Path(sal_height.__path__[0], "presets").glob("*.yaml"))
"""Names of the presets of the package, found without importing what reads them."""

PROCESSING = Group("Simulate and process", sort_key=1)
MEASURING = Group("Measure images", sort_key=2)
THEORY = Group("Compare with theory", sort_key=3)
KINDS = Group("Kinds of detectors", sort_key=3)
BAGS = Group("Make and repair bags", sort_key=4)


def command(name: str, group: Group, examples: str, failure: str | None = None) -> App:
    """An app without a function yet, whose help ends with examples and exit statuses.

    Args:
        name: name of the command.
        group: heading under which `sal-height --help` lists it.
        examples: lines of examples, each indented by two spaces.
        failure: condition for the exit status 1; None: it never occurs.
    """
    return App(
        name=name,
        group=group,
        help_format="plaintext",
        help_epilogue=epilogue(examples, failure),
        default_parameter=Parameter(negative=()),
    )


def epilogue(examples: str, failure: str | None = None) -> str:
    """Examples and exit statuses as they stand at the end of a command's help, 80 columns wide.

    Wider lines would be cut by a terminal of that width, and could then not be pasted.
    """
    meanings = {
        DONE: "done",
        FAILED: failure,
        BAD_USE: "wrong use, unusable input or failure; a sentence on stderr explains it",
        INTERRUPTED: "interrupted by SIGINT (Ctrl-C), SIGTERM or SIGHUP; files stay on disk",
        CUT_OFF: "the reader of the output closed it, as `head` does",
    }
    statuses = "\n".join(
        textwrap.fill(meaning, 80, initial_indent=f"  {status:<4} ", subsequent_indent=" " * 7)
        for status, meaning in meanings.items()
        if meaning
    )
    return f"examples:\n{examples.strip(chr(10))}\n\nexit status:\n{statuses}"


def one_word(metavar: str, convert: Callable[[Token], Any], **more: Any) -> Parameter:
    """A parameter whose value is one word of the command line, or of each repetition.

    Args:
        metavar: form of the word, as the help shows it.
        convert: function that reads the word.
        more: other arguments of the parameter.
    """
    return Parameter(
        metavar=metavar,
        n_tokens=1,
        accepts_keys=False,
        converter=lambda _type, tokens: convert(tokens[0]),
        **more,
    )


def repeated(metavar: str, **more: Any) -> Parameter:
    """A parameter that takes one value, and may be repeated; `more` are other arguments of it."""
    return Parameter(metavar=metavar, consume_multiple=False, show_default=False, **more)


def _pair_of(kind: type, separator: str, form: str, least: int = 0) -> Callable[[Token], tuple[Any, Any]]:
    """Converter of texts such as 2x2 to a pair of numbers, each of `least` or more."""

    def convert(token: Token) -> tuple[Any, Any]:
        first, found, second = token.value.partition(separator)
        try:
            if found and re.fullmatch(r"[\d.]+", first) and re.fullmatch(r"[\d.]+", second):
                pair = kind(first), kind(second)
                if min(pair) >= least:
                    return pair
        except ValueError:
            pass
        raise ValueError(f"{token.value!r} is not of the form {form}")

    return convert


def allowed(what: str, is_allowed: Callable[[float], bool]) -> Callable[[type, float | None], None]:
    """A validator of a number that says all that is allowed, also where the number is no number.

    Args:
        what: allowed range, after "must be a number".
        is_allowed: function that is true for allowed numbers, and false for NaN.
    """

    def check(_type: type, value: float | None) -> None:
        if value is not None and not is_allowed(value):
            raise ValueError(f"It must be a number {what}.")

    return check


def _place(token: Token) -> dict[str, float]:
    """Converter of a text such as 48.1,11.3,560 to the keys of a preset's origin."""
    try:
        numbers = [float(number) for number in token.value.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in {2, 3}:
        raise ValueError(
            f"{token.value!r} is not of the form LAT,LON or LAT,LON,H in degrees and m, such as 48.1,11.3,560"
        )
    return dict(zip(("latitude_deg", "longitude_deg", "height_m"), numbers, strict=False))


Bag: TypeAlias = Annotated[Path, Parameter(name="BAG", help="Folder of the bag, or its .mcap file.")]

Tolerance: TypeAlias = Annotated[
    Path | None,
    Parameter(
        metavar="FILE",
        show_default=False,
        help="YAML file of tolerances by field, as docs/replay.md says. Default: that of other processors' rounding.",
    ),
]

OutputFolder: TypeAlias = Annotated[Path | None, Parameter(name="--out", metavar="DIR")]

Seed: TypeAlias = Annotated[
    int, Parameter(metavar="S", validator=Number(gte=0, lt=2**31), help="Seed of the random numbers.")
]

Trials: TypeAlias = Annotated[int, Parameter(metavar="N", help="Number of Monte Carlo trials at each point.")]

RangeByAzimuth: TypeAlias = Annotated[
    tuple[int, int] | None,
    one_word("RxA", _pair_of(int, "x", "RxA with whole numbers of 1 or more, for example 2x2", least=1)),
]

Place: TypeAlias = Annotated[
    dict[str, float] | None, one_word("LAT,LON[,H]", _place, negative=(), allow_leading_hyphen=True)
]


def metres(token: Token, form: str, example: str) -> tuple[float, ...]:
    """The numbers of a text such as 12.5,-3,1.2, in m, as near to the origin of map as those in files of targets.

    Args:
        token: text of an option.
        form: names of the numbers, such as EAST,NORTH,HEIGHT.
        example: text of that form.

    Raises:
        UserError: the text has another form, or a number is too great.
    """
    from sal_height.adjustment.targets import FARTHEST_M

    try:
        numbers = tuple(map(float, token.value.split(",")))
    except ValueError:
        numbers = ()
    if len(numbers) != len(form.split(",")):
        raise UserError(f"Option {token.keyword} is {token.value!r}; it must be {form} in m, for example {example}.")
    if not all(abs(number) <= FARTHEST_M for number in numbers):  # NaN is refused, too
        raise UserError(f"Option {token.keyword} is {token.value!r}; numbers must be at most {FARTHEST_M:g} m.")
    return numbers


def _places(_type: type, tokens: Sequence[Token]) -> tuple[tuple[float, ...], ...]:
    return tuple(metres(token, "EAST,NORTH,HEIGHT", "12.5,-3,1.2") for token in tokens)


Places: TypeAlias = Annotated[
    tuple[tuple[float, float, float], ...],
    repeated(
        "EAST,NORTH,HEIGHT",
        n_tokens=1,
        accepts_keys=False,
        allow_leading_hyphen=True,
        converter=_places,
        negative=(),
    ),
]
"""Positions in map, of an option that may be repeated."""

PixelPosition: TypeAlias = Annotated[
    tuple[int, int] | None, one_word("ROW,COL", _pair_of(int, ",", "ROW,COL with whole numbers, for example 120,45"))
]


def _range(token: Token) -> tuple[int, int]:
    """The two numbers of FIRST:LAST."""
    match = re.fullmatch(r"(\d{1,10}):(\d{1,10})", token.value)
    if not match or not int(match[1]) <= int(match[2]) < 2**32:
        raise ValueError(f"{token.value!r} is not of the form FIRST:LAST, for example 10:19")
    return int(match[1]), int(match[2])


DwellRange: TypeAlias = Annotated[tuple[int, int] | None, one_word("FIRST:LAST", _range, show_default=False)]

ElevationByAzimuth: TypeAlias = Annotated[
    tuple[float, float], one_word("ExA", _pair_of(float, "x", "ExA with two numbers, for example 0.6x1.2"))
]

NodeParameters: TypeAlias = Annotated[
    tuple[str, ...],
    repeated("NODE.NAME=VALUE", name="--param", help="Set a parameter of a node; may be repeated."),
]

Settings: TypeAlias = Annotated[
    tuple[str, ...],
    repeated("NAME=VALUE", name="--set", help="Change a setting of the measurement; may be repeated."),
]

Estimators: TypeAlias = Annotated[
    tuple[str, ...],
    one_word(
        "NAME,NAME",
        lambda token: tuple(name.strip() for name in token.value.split(",")),
        name="--estimators",
        show_default=False,
        help="Height estimators, for example ml,capon,music; adjusted is those of ml, or of the first, moved to where "
        "earlier dwells saw the same ground; movers adds what moves. Default: the standard ones that suit the sensor.",
    ),
]


@Parameter(name="*")
@dataclass(frozen=True)
class GraphOptions:
    """Options of the commands that run a graph of nodes."""

    record: Annotated[
        tuple[str, ...],
        repeated(
            "TOPIC",
            help="Record this topic, too, such as slc (the complex images); may be repeated.",
        ),
    ] = ()
    domain: Annotated[
        int | None,
        Parameter(
            metavar="N",
            validator=Number(gte=0, lte=232),
            help="Use this ROS domain on this machine. Default: a domain that nobody uses.",
        ),
    ] = None
    join: Annotated[
        bool,
        Parameter(
            show_default=False,
            help="Use the domain and range of discovery that the environment variables of ROS say.",
        ),
    ] = False
    timeout: Annotated[
        float,
        Parameter(
            metavar="S",
            validator=Number(gt=0),
            help="Give up after this time, in seconds, in which no node works and no message moves.",
        ),
    ] = 120.0

    def execution(self, processes: Processes = "one") -> Execution:
        """The options as `perform` takes them.

        Raises:
            UserError: they contradict each other.
        """
        from sal_height.graph.plan import Execution

        if self.join and self.domain is not None:
            raise UserError("Options --join and --domain exclude each other; give one of them.")
        default: DomainChoice = "environment" if self.join else "free"
        return Execution(processes, default if self.domain is None else self.domain, self.record, self.timeout)


GRAPH = GraphOptions()

Jobs: TypeAlias = Annotated[
    int,
    Parameter(
        metavar="N",
        validator=Number(gte=1, lte=256),
        help="Process N dwells in parallel, each in a process of its own.",
    ),
]


@contextmanager
def importing() -> Iterator[None]:
    """Import many modules without collecting garbage: they leave none, and a tenth of the time is saved."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()  # objects of modules are permanent
        gc.enable()


def complain(messages: Sequence[str]) -> None:
    """Print warnings and errors on stderr."""
    for message in messages:
        print(f"sal-height: {message}", file=sys.stderr)


Images: TypeAlias = Annotated[tuple[Path, ...], Parameter(name="IMAGE", show_default=False)]

Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]

Dwell: TypeAlias = Annotated[int | None, Parameter(metavar="N", help="Measure only the images of this dwell.")]

Channel: TypeAlias = Annotated[int | None, Parameter(metavar="N", help="Measure only the images of this channel.")]

AzimuthAxis: TypeAlias = Annotated[
    int,
    Parameter(
        metavar="0|1",
        validator=Number(gte=0, lte=1),
        help="Along-track axis of .npy and .npz arrays: 1 for columns, 0 for rows.",
    ),
]


def output_folder(given: Path | None, default: str) -> Path:
    """The output folder of a command: `given`, which must be new or empty, or the first free one of `default`, ….

    Nothing is written yet, so that a command that is refused leaves nothing behind.

    Raises:
        UserError: it is not empty, or cannot be made.
    """
    from sal_height.io import check_new_folder, free_folder

    folder = given or free_folder(Path("out") / default)
    check_new_folder(folder)
    return folder


def node_parameters(assignments: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Values of NODE.NAME=VALUE by node and new name; values are read as YAML.

    Raises:
        UserError: an assignment has another form.
    """
    values: dict[str, dict[str, Any]] = {}
    for text in assignments:
        match = re.fullmatch(r"(\w+)\.(\w+)=(.*)", text)
        if not match:
            raise UserError(f"Option --param is {text!r}; it must be of the form NODE.NAME=VALUE.")
        node, name, value = match.groups()
        values.setdefault(node, {})[name] = _value(value)
    return {node: with_new_names(of_node) for node, of_node in values.items()}


def settings_values(assignments: Sequence[str]) -> dict[str, Any]:
    """Values of NAME=VALUE by name; values are read as YAML.

    Raises:
        UserError: an assignment has another form.
    """
    for text in assignments:
        if not re.fullmatch(r"\w+=.*", text):
            raise UserError(f"Option --set is {text!r}; it must be of the form NAME=VALUE.")
    return {name: _value(value) for name, value in (text.split("=", 1) for text in assignments)}


def _value(text: str) -> Any:
    """Value of a text as YAML; the text itself if it is invalid, which is refused where no text is allowed."""
    import yaml

    if re.fullmatch(r"[-+]?\d+[eE][-+]?\d+", text):  # 3e-5 is no number in YAML 1.1
        return float(text)
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError):
        return text
