"""Two sweeps in one folder share its units: none is done twice, none is lost."""

import json
import multiprocessing
import os
import signal
import threading
import time

import pytest

from tests.experiments.sweeps import many
from ves_gym.experiments.claims import claimed, is_claimed
from ves_gym.experiments.spec import units_of
from ves_gym.experiments.sweep import merge, sweep
from ves_gym.experiments.units import Elsewhere, run_unit


def hold(folder, id, pipe):
    with claimed(folder, id) as mine:
        pipe.send(mine)
        pipe.recv()


def test_a_claim_keeps_others_off_until_it_ends(tmp_path):
    with claimed(tmp_path, "a") as mine:
        assert mine and is_claimed(tmp_path, "a") and not is_claimed(tmp_path, "b")
        with claimed(tmp_path, "a") as again, claimed(tmp_path, "b") as other:
            assert not again and other
        assert is_claimed(tmp_path, "a")
    assert not is_claimed(tmp_path, "a") and not list((tmp_path / "work").iterdir())


def test_a_claim_ends_with_its_holder(tmp_path):
    here, there = multiprocessing.Pipe()
    holder = multiprocessing.get_context("spawn").Process(
        target=hold, args=(tmp_path, "a", there)
    )
    holder.start()
    assert here.recv() is True and is_claimed(tmp_path, "a")
    os.kill(holder.pid, signal.SIGKILL)
    holder.join()
    assert not is_claimed(tmp_path, "a")
    with claimed(tmp_path, "a") as mine:
        assert mine


def test_a_unit_is_done_once(tmp_path):
    (unit,) = units_of(many(1), tmp_path)
    with claimed(tmp_path, unit.id), pytest.raises(Elsewhere, match="another process"):
        run_unit(unit, str(tmp_path))
    assert run_unit(unit, str(tmp_path)) is True
    about = tmp_path / "about" / f"{unit.id}.json"
    first = about.read_bytes()
    assert run_unit(unit, str(tmp_path)) is False and about.read_bytes() == first
    assert run_unit(unit, str(tmp_path), again=True) is True
    assert about.read_bytes() != first


def test_a_sweep_waits_for_a_unit_of_another_and_takes_over_if_that_dies(tmp_path):
    units = units_of(many(2), tmp_path)
    entered, leave = threading.Event(), threading.Event()

    def other():
        with claimed(tmp_path, units[0].id):
            entered.set()
            leave.wait(60)

    thread = threading.Thread(target=other)
    thread.start()
    entered.wait(60)
    threading.Timer(2.0, leave.set).start()
    begin = time.monotonic()
    report = sweep(many(2), tmp_path, workers=1)
    thread.join()
    assert time.monotonic() - begin >= 2.0
    assert sorted(report.done) == sorted(u.id for u in units) and report.complete


def share(folder, count, queue):
    queue.put(sweep(many(count), folder, workers=1).done)


@pytest.mark.slow
def test_two_sweeps_in_one_folder_do_every_unit_once(tmp_path):
    count, context = 60, multiprocessing.get_context("spawn")
    queue = context.Queue()
    both = [context.Process(target=share, args=(tmp_path, count, queue)) for _ in range(2)]
    for process in both:
        process.start()
    done = [queue.get(timeout=300) for _ in both]
    for process in both:
        process.join()
    assert sorted(done[0] + done[1]) == sorted(u.id for u in units_of(many(count), tmp_path))
    assert min(map(len, done)) > 0
    processes = {json.loads(p.read_text())["process"] for p in (tmp_path / "about").iterdir()}
    assert len(processes) == 2 and len(merge([tmp_path])) == count
