"""BLAS in one thread while it is asked for, and in as many as before afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from threading import Barrier

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from sal_height.numeric import one_blas_thread, threads


def numbers_of_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def _two() -> Iterator[None]:
    """Two threads of BLAS, whatever the environment says."""
    with threadpool_limits(2, user_api="blas"):
        assert numbers_of_threads() == {2}
        yield


def test_one_thread_within_and_as_many_as_before_afterwards() -> None:
    with one_blas_thread():
        assert numbers_of_threads() == {1}
        with one_blas_thread():
            assert numbers_of_threads() == {1}
        assert numbers_of_threads() == {1}
    assert numbers_of_threads() == {2}


def test_an_exception_restores_the_number() -> None:
    def fail() -> None:
        with one_blas_thread():
            raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011 (our own)
        fail()
    assert numbers_of_threads() == {2}


def test_the_last_of_several_threads_restores_the_number() -> None:
    """The first to begin ends first."""
    first_is_in, second_is_in, first_is_out = Barrier(2, timeout=60), Barrier(2, timeout=60), Barrier(2, timeout=60)

    def first() -> None:
        with one_blas_thread():
            first_is_in.wait()
            second_is_in.wait()
        first_is_out.wait()

    def second() -> set[int]:
        first_is_in.wait()
        with one_blas_thread():
            second_is_in.wait()
            first_is_out.wait()
            return numbers_of_threads()

    with ThreadPoolExecutor(2) as pool:
        seen = [pool.submit(first), pool.submit(second)][1].result(timeout=60)
    assert seen == {1}
    assert numbers_of_threads() == {2}


def users_in_a_child() -> int:
    return threads._limit.users


def test_a_forked_process_starts_without_the_users_of_its_parent() -> None:
    with one_blas_thread(), get_context("fork").Pool(1) as pool:
        assert pool.apply(users_in_a_child) == 0
        assert threads._limit.users == 1


def test_a_product_has_the_same_bits_with_any_number_of_threads() -> None:
    rng = np.random.default_rng(1)
    one, other = (rng.standard_normal((n, 2 * m)).view(np.complex128) for n, m in ((3001, 16), (16, 16)))
    with threadpool_limits(1, user_api="blas"):
        expected = one @ other
    with one_blas_thread():
        np.testing.assert_array_equal(one @ other, expected)
