"""The queue of jobs: in order, bounded by number and by memory, and dropping what the policy says."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import pytest

from sal_height.nodes.jobs import JobQueue, QueuedJob, QueuePolicy


def job(number: int, size: int = 1) -> QueuedJob:
    return QueuedJob(lambda: 0, number, size)


def numbers(jobs: list[QueuedJob]) -> list[int]:
    return [one.messages for one in jobs]


def waiting(queue: JobQueue) -> list[int]:
    queue.close()
    found = []
    while one := queue.get():
        found.append(one.messages)
    return found


@pytest.mark.parametrize(
    ("policy", "dropped", "kept"), [("newest", [[], [], [3], [4]], [1, 2]), ("oldest", [[], [], [1], [2]], [3, 4])]
)
def test_a_full_queue_drops_what_the_policy_says(
    policy: QueuePolicy, dropped: list[list[int]], kept: list[int]
) -> None:
    queue = JobQueue()
    assert [numbers(queue.put(job(number), 2, math.inf, policy)) for number in range(1, 5)] == dropped
    assert waiting(queue) == kept


def test_work_of_the_nodes_own_is_never_left_out_nor_does_it_push_out_messages() -> None:
    queue = JobQueue()
    put = [(1, []), (0, []), (2, []), (0, []), (3, [1]), (4, [2]), (0, [])]
    for number, dropped in put:
        assert numbers(queue.put(job(number), 2, math.inf, "oldest")) == dropped
    assert numbers(queue.put(job(5), 2, math.inf, "newest")) == [5]
    assert waiting(queue) == [0, 0, 3, 4, 0]


@pytest.mark.parametrize(("policy", "dropped", "kept"), [("newest", [3], [1, 2]), ("oldest", [1, 2], [3])])
def test_jobs_are_bounded_by_memory(policy: QueuePolicy, dropped: list[int], kept: list[int]) -> None:
    queue = JobQueue()
    assert queue.put(job(1, 60), 10, 100, policy) == []
    assert queue.put(job(2, 40), 10, 100, policy) == []
    assert numbers(queue.put(job(3, 70), 10, 100, policy)) == dropped
    assert waiting(queue) == kept


def test_an_empty_queue_takes_a_job_of_any_size() -> None:
    queue = JobQueue()
    assert queue.put(job(1, 10**12), 1, 100, "newest") == []
    assert waiting(queue) == [1]


def test_what_is_at_hand_counts_until_the_next_is_asked_for() -> None:
    queue = JobQueue()
    for number in (1, 2):
        queue.put(job(number), 10, math.inf, "newest")
    assert queue.unfinished == 2
    queue.get()
    assert queue.unfinished == 2
    queue.get()
    assert queue.unfinished == 1
    with ThreadPoolExecutor(1) as pool:
        waiter = pool.submit(queue.get)
        queue.close()
        assert waiter.result(10.0) is None
    assert queue.unfinished == 0


def test_a_closed_queue_hands_out_what_it_holds_and_takes_no_more() -> None:
    queue = JobQueue()
    queue.put(job(1), 10, math.inf, "newest")
    queue.close()
    assert numbers(queue.put(job(2), 10, math.inf, "oldest")) == [2]
    assert waiting(queue) == [1]


def test_jobs_are_taken_that_suit_a_worker_up_to_so_many_and_so_many_bytes() -> None:
    queue = JobQueue()
    for number in range(1, 7):
        queue.put(QueuedJob(lambda: 0, number, 10, number), 100, math.inf, "oldest")
    assert numbers(queue.take(5, math.inf, lambda item: item < 3)) == [1, 2]
    assert numbers(queue.take(5, math.inf, lambda item: item > 3)) == []  # none overtakes the third
    assert numbers(queue.take(1, math.inf, lambda _: True)) == [3]
    assert numbers(queue.take(5, 25, lambda _: True)) == [4, 5]
    assert numbers(queue.take(5, 1, lambda _: True)) == [6]  # one in any case
    assert (queue.waiting, queue.unfinished) == (0, 6)


def test_a_queue_is_done_once_every_job_that_was_taken_is() -> None:
    queue = JobQueue()
    queue.put(QueuedJob(lambda: 0, 1), 1, math.inf, "oldest")
    assert numbers(queue.take(1, math.inf, lambda _: True)) == [1]
    assert not queue.wait_until_done(0.01)
    queue.note_done()
    assert queue.wait_until_done(0.0)
