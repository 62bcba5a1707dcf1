"""Work shared by threads: in order, failures and all, also where nobody helps."""

import multiprocessing
import threading
import time

import numpy as np
import pytest

from deepfracture.carve import cut
from deepfracture.geometry import builtin, signed_distance
from deepfracture.learn import embedded_model, load_model
from deepfracture.runtime import parallel as threads
from deepfracture.runtime.parallel import (
    parallel_for,
    parallel_invoke,
    parallel_map,
    parallel_matmul,
    single_threaded_blas,
)
from deepfracture.types import FracturePattern, Grid, Impact


@pytest.fixture(autouse=True)
def three_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "thread_count", lambda: 3)


def span(first: int, last: int) -> list[int]:
    return list(range(first, last))


def flat(parts: list[list[int]]) -> list[int]:
    return [n for part in parts for n in part]


@pytest.mark.parametrize(("count", "least"), [(0, 1), (1, 1), (7, 1), (1000, 10), (10, 100)])
def test_parts_are_consecutive_and_in_order(count: int, least: int) -> None:
    parts = parallel_for(span, count, least=least)
    assert flat(parts) == list(range(count))
    assert count < 2 * least or len(parts) > 1


@pytest.mark.parametrize("sizes", [[], [3.0], [1.0, 100.0, 1.0, 1.0], [float(n % 7) for n in range(40)]])
def test_what_is_apportioned_comes_in_order(sizes: list[float]) -> None:
    assert parallel_map(lambda n: (n, sizes[n]), sizes) == list(enumerate(sizes))


def test_the_largest_does_not_wait_behind_the_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_run", lambda jobs, _: [job() for job in jobs])  # in the order of their turns
    order: list[int] = []
    parallel_map(order.append, [1.0] * 30 + [50.0])
    assert order[0] == 30 and sorted(order) == list(range(31))


def test_a_product_does_not_depend_on_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    rows, matrix = rng.normal(size=(5000, 96)).astype(np.float32), rng.normal(size=(96, 30)).astype(np.float32)
    found = parallel_matmul(rows, matrix)
    assert np.allclose(found, rows @ matrix, atol=1e-3)
    monkeypatch.setattr(threads, "thread_count", lambda: 1)
    assert parallel_matmul(rows, matrix).tobytes() == found.tobytes()


def test_matrices_leave_the_other_threads_alone_only_while_asked() -> None:
    from threadpoolctl import threadpool_info

    def blas() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = blas()
    with single_threaded_blas():
        assert set(blas()) == {1}
    assert blas() == before


def test_a_helper_that_has_gone_to_sleep_comes_again() -> None:
    for wait in (0.0, 0.0005, 0.002, 0.01) * 20:  # it stays awake for about a millisecond
        assert flat(parallel_for(span, 9, least=1)) == list(range(9))
        time.sleep(wait)


def test_several_threads_take_part() -> None:
    meet = threading.Barrier(2, timeout=10)

    def job() -> str:
        meet.wait()  # only two threads at once get past this
        return threading.current_thread().name

    one, other = parallel_invoke(job, job)
    assert one != other


def test_a_failure_in_any_part_comes_out() -> None:
    for bad in range(9):

        def job(first: int, last: int, bad: int = bad) -> None:
            if first == bad:
                raise ArithmeticError(f"part {bad}")

        with pytest.raises(ArithmeticError, match=f"part {bad}"):
            parallel_for(job, 9, least=1)
    assert flat(parallel_for(span, 9, least=1)) == list(range(9))  # and the threads are still there


def test_shared_work_inside_shared_work_does_not_wait_for_itself() -> None:
    parts = parallel_for(lambda first, last: flat(parallel_for(span, last - first, least=1)), 9, least=1)
    assert [len(part) for part in parts] == [1] * 9


def _forked(queue: "multiprocessing.Queue") -> None:
    queue.put(flat(parallel_for(span, 9, least=1)))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
def test_a_forked_process_has_threads_of_its_own() -> None:
    parallel_for(span, 9, least=1)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_forked, args=(queue,))
    child.start()
    assert queue.get(timeout=30) == list(range(9))
    child.join()


def test_a_cut_does_not_depend_on_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    shape, grid = builtin("pot"), Grid(64)
    inside = signed_distance(shape.mesh, grid) > 0
    seeds = np.random.default_rng(0).uniform(-1, 1, (30, 3))
    nearest = ((grid.centres()[..., None, :] - seeds) ** 2).sum(axis=-1).argmin(axis=-1) + 1
    pattern = FracturePattern(grid, np.where(inside, nearest, 0), np.zeros(grid.shape))
    shared = cut(shape, pattern, density=1000.0)
    monkeypatch.setattr(threads, "thread_count", lambda: 1)
    alone = cut(shape, pattern, density=1000.0)
    assert len(shared) == len(alone) > 20
    for one, other in zip(shared, alone, strict=True):
        np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)
        np.testing.assert_array_equal(one.mesh.faces, other.mesh.faces)
        np.testing.assert_array_equal(one.source, other.source)
        assert one.mass == other.mass


def test_a_prediction_does_not_depend_on_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_model(embedded_model("pot"))
    impact = Impact([[1, 0, 0.3]], [[-1, 0, 0]], [3000.0], [[1, 0, 0]], 10.0, 0.2)
    shared = model.predict(impact, np.random.default_rng(0))
    monkeypatch.setattr(threads, "thread_count", lambda: 1)
    alone = model.predict(impact, np.random.default_rng(0))
    assert shared.cuts.any()
    assert shared.values.tobytes() == alone.values.tobytes() and shared.cuts.tobytes() == alone.cuts.tobytes()


def test_uneven_work_comes_in_more_parts() -> None:
    even, uneven = parallel_for(span, 5000, least=1), parallel_for(span, 5000, least=1, uneven=True)
    assert flat(even) == flat(uneven) == list(range(5000))
    assert len(uneven) > 2 * len(even)
