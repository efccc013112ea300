"""Sweeps on executors of others: the same files, and what is lost is told."""

import os
import signal
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import pytest

from tests.experiments.sweeps import files, many, spec
from ves_gym._util.params import ParameterError
from ves_gym.experiments import sweep as module
from ves_gym.experiments.sweep import sweep
from ves_gym.experiments.units import run_unit


class Lossy(Executor):
    """Loses the first job, as a cluster does."""

    lost = False

    def submit(self, function, /, *args):
        future = Future()
        if self.lost:
            future.set_result(function(*args))
        else:
            self.lost = True
            future.set_exception(RuntimeError("the cluster lost it"))
        return future


def test_an_executor_of_the_standard_library_gives_the_same_files(swept, tmp_path):
    with ThreadPoolExecutor(1) as pool:
        report = sweep(spec(), tmp_path, workers=pool)
    assert len(report.done) == 4
    assert files(tmp_path) == files(swept[0])


def test_a_lost_job_costs_its_unit_and_is_done_next_time(tmp_path):
    pool = Lossy()
    report = sweep(many(3), tmp_path, workers=pool)
    assert len(report.done) == 2
    assert list(report.failed.values()) == [
        "evaluate ves/BeamLQR-v0 random 0: RuntimeError: the cluster lost it"
    ]
    again = sweep(many(3), tmp_path, workers=pool)
    assert len(again.done) == 1 and again.complete


def dying(unit, folder):
    if unit.identity["seed"] == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return run_unit(unit, folder)


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_unit_that_kills_its_process_costs_itself(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "run_unit", dying)
    report = sweep(many(3), tmp_path, workers=1)
    assert len(report.done) == 2
    (why,) = report.failed.values()
    assert why.endswith("random 1: its process died (exit code -9)")


def test_a_limit_is_not_kept_by_another_executor(tmp_path):
    with pytest.raises(ParameterError, match="seconds = 5 is kept by processes of this mach"):
        sweep(spec(seconds=5.0), tmp_path, workers=Lossy())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # of Dask's own sockets
def test_dask(swept, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        sweep(spec(), tmp_path, workers=client.get_executor(pure=False))
    assert files(tmp_path) == files(swept[0])


@pytest.mark.slow
def test_submitit(swept, tmp_path):
    submitit = pytest.importorskip("submitit")
    pool = submitit.LocalExecutor(folder=tmp_path / "jobs")
    pool.update_parameters(timeout_min=10)
    sweep(spec(), tmp_path / "out", workers=pool)
    assert files(tmp_path / "out") == files(swept[0])
