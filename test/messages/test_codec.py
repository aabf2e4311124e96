"""Messages without ROS: the shipped types are those of ROS, and their bytes are read and written as rclpy does."""

from __future__ import annotations

import copy
import pickle
import struct
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import few
from ros_messages import assert_same_as_rclpy, in_other_byte_order, of_rclpy, random_message, read_by_rclpy, spoiled
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sal_height.errors import UserError
from sal_height.messages import BrokenMessage, deserialize, programs, serialize, types
from sal_height.messages.codec import SHIPPED, TypeStore, recorded_types
from sal_height.messages.definition import (
    Definition,
    installed_definition,
    read_layout,
    share_folders,
    shipped_definition,
    shipped_layout,
    shipped_texts,
)
from sal_height.messages.parameters import parameter_of, shared_parameter
from sal_height.messages.programs import SHARED
from sal_height.nodes.transport import message_types
from sal_height.nodes.transport.message_types import class_of, message_class
from tools.definitions import FILE, content

PROVENANCE, PARAMETER = "sal_height_msgs/msg/Provenance", "rcl_interfaces/msg/Parameter"

ROOT = Path(__file__).parents[2]
INSTALLED = sorted(shipped_texts())

WITH_FIELDS = [name for name in INSTALLED if not name.endswith("/ParameterType")]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_the_definitions_are_those_that_their_tool_writes() -> None:
    assert FILE.read_text(encoding="utf-8") == content()


@pytest.mark.parametrize("type_name", INSTALLED)
def test_text_and_hash_are_those_installed(type_name: str) -> None:
    assert shipped_definition(type_name) == installed_definition(type_name, share_folders())


def test_every_message_of_ours_is_shipped_with_its_text() -> None:
    texts = {file.stem: file.read_text(encoding="utf-8") for file in (ROOT / "msg_defs" / "msg").glob("*.msg")}
    assert {
        name.rpartition("/")[2]: text for name, text in shipped_texts().items() if name.startswith("sal_height_msgs")
    } == texts


@pytest.mark.parametrize("count", few(1, [2, 8]))
@pytest.mark.parametrize("type_name", WITH_FIELDS)
def test_what_one_writes_the_other_reads(type_name: str, count: int, rng: np.random.Generator) -> None:
    store, definition = get_typestore(Stores.EMPTY), shipped_definition(type_name)
    assert definition
    store.register(get_types_from_msg(definition.text, type_name))
    for _ in range(count):
        message = random_message(type_name, rng)
        cdr = serialize(message)
        assert_same_as_rclpy(message, read_by_rclpy(cdr, type_name))
        assert deserialize(of_rclpy(message), type_name) == message
        assert deserialize(in_other_byte_order(message), type_name) == message
        assert bytes(store.serialize_cdr(message, type_name)) == cdr  # padding is zero, and nothing follows
        assert SHIPPED.reader(type_name, shared=True)(cdr) == message
        assert SHIPPED.reader(type_name, shared=True)(in_other_byte_order(message)) == message
        assert SHIPPED.serialize(message, shared=True) == cdr


@pytest.mark.parametrize("type_name", WITH_FIELDS)
def test_an_empty_message_is_that_of_rclpy(type_name: str) -> None:
    message = SHIPPED.message_class(type_name)()
    assert_same_as_rclpy(message, message_class(type_name)())
    assert deserialize(serialize(message), type_name) == message


@pytest.mark.parametrize("type_name", INSTALLED)
def test_constants_are_those_of_rclpy(type_name: str) -> None:
    plain, known = SHIPPED.message_class(type_name), message_class(type_name)
    for name in SHIPPED.layout(type_name).constants:
        theirs = getattr(known, name)
        assert getattr(plain, name) == (theirs[0] if isinstance(theirs, bytes) else theirs)


@pytest.mark.parametrize("count", few(1, [100, 400]))
@pytest.mark.parametrize("type_name", WITH_FIELDS)
def test_spoiled_bytes_are_refused_where_rclpy_does_and_else_read_alike_or_refused(
    type_name: str, count: int, rng: np.random.Generator
) -> None:
    """rclpy leaves lists that are too long empty, and all that follows them; these are refused."""
    read, refused = 0, 0
    for number in range(count):
        cdr = spoiled(np.frombuffer(serialize(random_message(type_name, rng)), np.uint8), number, rng)
        try:
            message = deserialize(cdr, type_name)
        except BrokenMessage:
            refused += 1
        else:
            read += 1
            assert_same_as_rclpy(message, read_by_rclpy(cdr, type_name))
    assert min(read, refused) > count // 10


def text_message(length: int, text: bytes) -> bytes:
    """A KeyValue whose key has these bytes and says that it has another length."""
    return b"\0\1\0\0" + struct.pack("<I", length) + text


@pytest.mark.parametrize(
    ("length", "text", "read"),
    [
        (0, b"", ""),
        (1, b"\0", ""),
        (3, b"ab\0", "ab"),
        (2, b"ab", "ab"),  # without its end
        (4, b"a\0b\0", "a"),
        (4, b"a\xffb\0", "a\N{REPLACEMENT CHARACTER}b"),
    ],
)
def test_texts_are_read_as_by_rclpy(length: int, text: bytes, read: str) -> None:
    cdr = text_message(length, text)
    cdr += bytes(-len(cdr) % 4) + struct.pack("<I", 0)
    assert deserialize(cdr, types.KeyValue).key == read_by_rclpy(cdr, types.KeyValue.__msgtype__).key == read


@pytest.mark.parametrize("cdr", [b"", b"\0\1", b"\0\1\0\0", b"\0\2\0\0" + bytes(8), b"\1\1\0\0" + bytes(8)])
def test_what_is_no_message_is_refused(cdr: bytes) -> None:
    with pytest.raises(BrokenMessage):
        deserialize(cdr, types.Time)


def test_bytes_after_the_last_field_are_passed_over() -> None:
    """rclpy may append some."""
    message = types.Header(frame_id="map")
    for count in (1, 3, 4, 100):
        assert deserialize(serialize(message) + bytes(count), types.Header) == message


@pytest.mark.parametrize("kind", ["HeightImage", "ComplexImage", "SensorInfo", "NodeAccount", "Provenance"])
def test_counts_that_are_far_too_large_cost_neither_time_nor_memory(kind: str, rng: np.random.Generator) -> None:
    """Every whole number in a message becomes a great one in turn."""
    cdr = serialize(random_message(f"sal_height_msgs/msg/{kind}", rng))
    tracemalloc.start()
    began = time.process_time()
    refused = 0
    for at in range(4, len(cdr) - 3, 4):
        for number in (2**31, 2**32 - 1, 2**24, len(cdr)):
            hostile = cdr[:at] + struct.pack("<I", number) + cdr[at + 4 :]
            try:
                deserialize(hostile, f"sal_height_msgs/msg/{kind}")
            except BrokenMessage:
                refused += 1
    tried = len(range(4, len(cdr) - 3, 4)) * 4
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert refused > 4 * 3
    assert most < 2_000_000
    assert (time.process_time() - began) / tried < 0.005


def test_lists_keep_to_the_limits_of_their_types() -> None:
    four = types.HeightImage(surfaces=[types.Surface()] * 4)
    with pytest.raises(ValueError, match="4 elements; 3 are allowed"):
        serialize(four)
    three = serialize(types.HeightImage(surfaces=[types.Surface()] * 3))
    at = three.rindex(struct.pack("<I", 3) + bytes(32 * 3))  # of the surfaces, each of eight empty lists
    with pytest.raises(BrokenMessage, match="4 elements; 3 are allowed"):
        deserialize(three[:at] + struct.pack("<I", 4) + bytes(32) + three[at + 4 :], types.HeightImage)
    with pytest.raises(ValueError, match="2 elements; 1 are allowed"):
        serialize(types.SensorUncertainty(beam_width=[0.1, 0.2]))


@pytest.mark.parametrize(
    ("message", "error"),
    [
        (types.Imu(orientation_covariance=np.zeros(8)), ValueError),
        (types.Time(sec=2**31), struct.error),
        (types.Header(frame_id=5), AttributeError),
    ],
)
def test_values_that_a_type_does_not_allow_are_not_written(message: Any, error: type[Exception]) -> None:
    with pytest.raises(error):
        serialize(message)
    with pytest.raises(OverflowError):
        types.ChannelFrame(samples=[300])


def test_lists_of_numbers_are_views_of_the_bytes_and_copies_of_eight_bytes_each() -> None:
    frame = types.ChannelFrame(samples=np.arange(16, dtype=np.uint8), pulse_time=np.arange(3.0))
    cdr = serialize(frame)
    read = deserialize(cdr, types.ChannelFrame)
    assert np.shares_memory(read.samples, np.frombuffer(cdr, np.uint8))
    assert read.pulse_time.flags.aligned
    assert not read.samples.flags.writeable


def test_messages_are_equal_if_they_say_the_same() -> None:
    nan = types.Surface(height=[1.0, np.nan])
    assert nan == types.Surface(height=np.array([1.0, np.nan]))
    assert nan != types.Surface(height=[1.0, 2.0])
    assert types.FitTest(size=np.nan) == types.FitTest(size=np.nan) != types.FitTest(size=1.0)
    assert types.Point() != types.Vector3()
    assert types.Count(name="a") != types.Count(name="b")


def test_messages_can_be_copied_and_pickled() -> None:
    message = types.HeightImage(dwell=3, surfaces=[types.Surface(height=[1.0])])
    assert pickle.loads(pickle.dumps(message)) == copy.deepcopy(message) == copy.copy(message) == message  # noqa: S301
    assert copy.deepcopy(message).surfaces[0] is not message.surfaces[0]
    assert "height=array([1.]" in repr(message)
    with pytest.raises(TypeError):
        hash(message)


def test_an_unknown_name_is_no_type() -> None:
    with pytest.raises(ImportError):
        from sal_height.messages.types import Unheard  # noqa: F401
    with pytest.raises(TypeError):
        types.Header(frame="map")
    with pytest.raises(KeyError):
        deserialize(b"", "std_msgs/msg/String")
    assert {"HeightImage", "Odometry", "Header"} <= set(dir(types))


def test_provenances_are_shared_and_few_are_kept() -> None:
    name = types.HeightImage.__msgtype__
    read, fresh = SHIPPED.reader(name, shared=True), SHIPPED.reader(name)
    images = [types.HeightImage(estimator="x" * n, provenance=types.Provenance(code_version="1")) for n in range(8)]
    for image in images:
        cdr = serialize(image)
        assert read(cdr) == image == fresh(cdr)
        assert read(cdr).provenance is read(cdr).provenance
        assert fresh(cdr).provenance is not fresh(cdr).provenance
    for number in range(3 * SHARED[PROVENANCE]):
        read(serialize(types.HeightImage(provenance=types.Provenance(code_version=f"{number}"))))
    cache = kept_by(SHIPPED._programs.reader(PROVENANCE, "<", shared=True))
    assert cache.cache_info().currsize == SHARED[PROVENANCE]


def kept_by(function: Any) -> Any:
    """What a function of the codec keeps."""
    return dict(zip(function.__code__.co_freevars, (one.cell_contents for one in function.__closure__), strict=True))[
        "kept"
    ]


def provenance(number: int, margin: str = "") -> types.Provenance:
    """A provenance of three parameters, of which the second has that number."""
    values = {"a": (1.5, 2.5), "b": number, "c": "text"}
    return types.Provenance(margin, parameters=[shared_parameter(name, value) for name, value in values.items()])


def test_of_provenances_that_differ_in_a_parameter_the_others_are_read_and_written_once() -> None:
    read = SHIPPED.reader(types.HeightImage.__msgtype__, shared=True)
    images = [types.HeightImage(provenance=provenance(number)) for number in (1, 2)]
    written = [SHIPPED.serialize(image, shared=True) for image in images]
    assert written == [serialize(image) for image in images]
    one, other = (read(cdr) for cdr in written)
    assert [one, other] == images
    same = [a is b for a, b in zip(one.provenance.parameters, other.provenance.parameters, strict=True)]
    assert same == [True, False, True]
    kept = kept_by(SHIPPED._programs.writer("rcl_interfaces/msg/Parameter", shared=True))
    first, second = ([id(one) for one in image.provenance.parameters] for image in images)
    assert [a == b for a, b in zip(first, second, strict=True)] == same
    assert {number for number, _ in kept} >= {*first, *second}


def test_parts_that_are_kept_keep_little_else_alive() -> None:
    """Views of the bytes of a message would keep all of it, and large parts are themselves many bytes."""
    read = SHIPPED.reader(types.HeightImage.__msgtype__, shared=True)
    values = {"small": tuple(bytes([one]) for one in range(8)), "large": (b"x",) * 10_000}
    parameters = [parameter_of(name, value) for name, value in values.items()]
    one, other = (
        read(serialize(types.HeightImage(provenance=types.Provenance(version, "", "", parameters, np.zeros(100_000)))))
        for version in "ab"
    )
    assert one.provenance.parameters == other.provenance.parameters == parameters
    small, large = (a is b for a, b in zip(one.provenance.parameters, other.provenance.parameters, strict=True))
    assert small
    assert not large
    assert len(one.provenance.parameters[0].value.byte_array_value.base) < 200


@pytest.mark.parametrize("margin", ["x" * length for length in range(9)])
def test_shared_parts_have_the_same_bytes_at_every_offset(margin: str) -> None:
    for _ in range(2):  # made, and kept
        image = types.HeightImage(provenance=provenance(3, margin))
        assert SHIPPED.serialize(image, shared=True) == serialize(image)


def test_few_parts_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "PARTS", {PARAMETER: 8})
    monkeypatch.setattr(programs, "KEPT", {PROVENANCE: 4, PARAMETER: 8})
    store = TypeStore(shipped_layout)
    read = store.reader(types.HeightImage.__msgtype__, shared=True)
    for number in range(40):
        image = types.HeightImage(provenance=provenance(number, "x" * number))
        assert read(store.serialize(image, shared=True)).provenance.parameters[1].value.integer_value == number
    makers = store._programs
    assert 0 < len(kept_by(makers.reader(PARAMETER, "<", shared=True))) <= 8
    assert 0 < len(kept_by(makers.writer(PARAMETER, shared=True))) <= 8
    assert 0 < len(kept_by(makers.writer(PROVENANCE, shared=True))) <= 4


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("float64", "is no field"),
        ("float64 1x", "is no field"),
        ("float64[a] x", "is no field"),
        ("a/b/c x", "is no message type"),
        ("float64 x\nint8 x", "two fields of one name"),
        ("uint8 X=many", "invalid literal"),
        ("float64 __x", "is no field"),
    ],
)
def test_a_text_that_is_no_definition_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        read_layout("a/msg/B", text)


def definition(*texts: str) -> Definition:
    """The definition of a type a/A that contains b/B, c/C, ..."""
    names = [f"{letter}/{letter.upper()}" for letter in "bcdefghijklmnopqrstuvwxyz"]
    sections = [f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in zip(names, texts[1:], strict=False)]
    return Definition("\n".join([texts[0], *sections]), "")


@pytest.mark.parametrize(
    "texts",
    [
        ("b/B x", "a/A x"),  # it contains itself
        ("b/B[] x", "b/B[] x"),
        ("b/B x",),  # a type that is not there
        ("b/B[3] x", "float64 x"),
        ("string[3] x",),
        ("float64[99999999999999999999] x",),
        *[tuple(f"{chr(98 + n)}/{chr(66 + n)} x\n{chr(98 + n)}/{chr(66 + n)} y" for n in range(25))],  # 2**25 numbers
    ],
)
def test_hostile_definitions_end_neither_the_program_nor_its_patience(texts: tuple[str, ...]) -> None:
    began = time.process_time()
    with pytest.raises(Exception, match=r".") as refused:
        recorded_types("a/msg/A", definition(*texts)).reader("a/msg/A")(b"\0\1\0\0" + bytes(100))
    assert isinstance(refused.value, (ValueError, KeyError, struct.error, OverflowError, BrokenMessage))
    assert time.process_time() - began < 2.0


def test_fields_may_have_the_names_of_words_of_python() -> None:
    store = recorded_types("a/msg/A", definition("float64 from 2.5\nfloat64 inf inf\nint8 None=3\nbool class true"))
    message = store.message_class("a/msg/A")()
    assert (message.from_, message.inf, message.class_, vars(type(message))["None"]) == (2.5, np.inf, True, 3)
    assert store.reader("a/msg/A")(store.serialize(message)) == message


def test_types_that_are_installed_otherwise_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    message_class.cache_clear()
    other = {**message_class("sal_height_msgs/msg/Count").get_fields_and_field_types(), "more": "double"}
    monkeypatch.setattr(message_class("sal_height_msgs/msg/Count"), "get_fields_and_field_types", lambda: other)
    message_class.cache_clear()
    for kind in (types.Count, types.NodeAccount):
        with pytest.raises(UserError, match=r"Count is installed with other fields.*sal_height_msgs"):
            class_of(kind)
    monkeypatch.undo()
    message_types.message_class.cache_clear()
    assert class_of(types.Count)


@pytest.mark.parametrize(
    "name", ["std_msgs/msg/Nothing", "no_such_msgs/msg/Thing", "std_msgs/Header", "Header", "os/msg/path"]
)
def test_a_type_that_is_not_installed_is_named(name: str) -> None:
    with pytest.raises(UserError, match=name):
        message_class(name)
