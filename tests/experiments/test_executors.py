"""Sweeps on executors of others: the same files, and what is lost is told."""

from concurrent.futures import Executor, Future

import pytest
from pebble import ProcessExpired

from tests.experiments.sweeps import files, many, spec
from ves_gym._util.params import ParameterError
from ves_gym.experiments.sweep import sweep


class Lossy(Executor):
    """Loses the first job, as a cluster does, or one's own machine."""

    def __init__(self, error):
        self.error = error

    def submit(self, function, /, *args):
        future, error = Future(), self.error
        if error is None:
            future.set_result(function(*args))
        else:
            self.error = None
            future.set_exception(error)
        return future


def test_an_executor_of_the_standard_library_gives_the_same_files(swept, here, tmp_path):
    report = sweep(spec(), tmp_path, workers=here)
    assert len(report.done) == 4
    assert files(tmp_path) == files(swept[0])


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (RuntimeError("the cluster lost it"), "RuntimeError: the cluster lost it"),
        (ProcessExpired("killed", code=-9), "its process died (exit code -9)"),
        (TimeoutError(), "took too long and was killed"),
    ],
)
def test_a_lost_job_costs_its_unit_and_is_done_next_time(error, why, tmp_path):
    pool = Lossy(error)
    report = sweep(many(3), tmp_path, workers=pool)
    assert len(report.done) == 2
    assert list(report.failed.values()) == [f"evaluate ves/BeamLQR-v0 random 0: {why}"]
    again = sweep(many(3), tmp_path, workers=pool)
    assert len(again.done) == 1 and again.complete


def test_a_limit_is_not_kept_by_another_executor(tmp_path):
    with pytest.raises(ParameterError, match="seconds = 5 is kept by processes of this mach"):
        sweep(spec(seconds=5.0), tmp_path, workers=Lossy(None))


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
