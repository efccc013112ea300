"""The same result files from every executor, and what each does when a job is lost."""

import importlib.util
import json
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from benchmarks.sweep import storm
from tests.experiments.sweeps import Killer, files, many, spec
from ves_gym._util.params import ParameterError
from ves_gym._util.process_pool import JobTimeout, WorkerDied
from ves_gym.experiments.executors import open_executor
from ves_gym.experiments.sweep import merge, sweep

CLUSTERS = [
    pytest.param("submitit-local", marks=pytest.mark.slow),
    pytest.param("dask", marks=pytest.mark.slow),
    pytest.param("ray", marks=pytest.mark.slow),
]


@pytest.fixture(autouse=True)
def installed(request):
    packages = {"submitit-local": "submitit", "dask": "distributed", "ray": "ray"}
    for name, package in packages.items():
        if f"[{name}]" in request.node.name:
            pytest.importorskip(package)


def trace(folder, name):
    with open(Path(folder) / name, "a") as file:
        file.write(f"{os.getpid()}\n")
    return len((Path(folder) / name).read_text().splitlines())


def die_first(folder, name, times):
    if trace(folder, name) <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return name


def hang():
    threading.Event().wait(600)


def refuse():
    raise ParameterError("no good")


# --------------------------------------------------------------------------- same files


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # of Dask's own sockets
def test_the_same_files_from_every_executor(tmp_path):
    """Local pool of two, submitit's processes, a Dask cluster of three: the same bytes."""
    pytest.importorskip("submitit")
    pytest.importorskip("distributed")
    for name, workers in (("local", 2), ("submitit-local", 2), ("dask", 3)):
        report = sweep(spec(), tmp_path / name, executor=name, workers=workers)
        assert len(report.done) == 4 and not report.failed, report.failed
    one = files(tmp_path / "local")
    assert len(one) == 4
    assert files(tmp_path / "submitit-local") == one
    assert files(tmp_path / "dask") == one
    processes = {
        name: {json.loads(text)["process"] for text in files(tmp_path / name, "about").values()}
        for name in ("local", "submitit-local", "dask")
    }
    assert len(processes["submitit-local"]) == 4  # one each
    assert all(os.getpid() not in some for some in processes.values())
    assert not processes["local"] & processes["dask"]


# -------------------------------------------------------------------------------- deaths


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("name", CLUSTERS)
def test_a_lost_job_is_tried_again_and_then_given_up(name, tmp_path):
    with open_executor(name, workers=2, folder=tmp_path, deaths=2) as pool:
        lost = pool.submit(die_first, str(tmp_path), "lost", 1)
        bad = pool.submit(die_first, str(tmp_path), "bad", 99)
        wrong = pool.submit(refuse)
        assert lost.result(timeout=120) == "lost"
        with pytest.raises(WorkerDied, match="died"):
            bad.result(timeout=120)
        with pytest.raises(ParameterError, match="no good") as caught:
            wrong.result(timeout=120)
        assert "refuse" in caught.value.__notes__[0]
    assert len((tmp_path / "lost").read_text().splitlines()) == 2
    assert len((tmp_path / "bad").read_text().splitlines()) == 2


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("name", CLUSTERS)
def test_a_job_that_takes_too_long_is_ended(name, tmp_path):
    begin = time.monotonic()
    with open_executor(name, workers=1, folder=tmp_path, deaths=1, seconds=1.0) as pool:
        slow, quick = pool.submit(hang), pool.submit(trace, str(tmp_path), "quick")
        with pytest.raises((JobTimeout, WorkerDied), match="longer than 1 s"):
            slow.result(timeout=120)
        assert quick.result(timeout=120) == 1
    assert time.monotonic() - begin < 120


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="finds workers in /proc")
def test_killed_workers_of_a_cluster_cost_nothing(tmp_path):
    pytest.importorskip("distributed")
    wanted = many(60)
    with Killer(tmp_path / "killed", pause=2.0, times=3) as killer:
        report = sweep(wanted, tmp_path / "killed", executor="dask", workers=2)
    assert killer.killed and len(report.done) == 60 and not report.failed
    sweep(wanted, tmp_path / "quiet", workers=1)
    assert files(tmp_path / "killed") == files(tmp_path / "quiet")
    assert len(merge([tmp_path / "killed"])) == 60


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_running_cluster_is_used_by_its_address(tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        options = {"executor": "dask", "address": cluster.scheduler_address}
        assert len(sweep(many(2), tmp_path, **options).done) == 2


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_two_thousand_units_on_a_cluster_whose_workers_die_and_come():
    """None lost, none doubled; at least 0.9 of the time of the workers that were there."""
    pytest.importorskip("distributed")
    found = storm()
    print(found, f"{found.efficiency:.3f} of ideal")
    assert (found.answers, found.stored, found.repeated) == (2000, 2000, 0)
    assert found.killed >= 3 and found.added == 2
    assert found.efficiency >= 0.9


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("magic", {}, "executor must be one of local, slurm, submitit-local, dask, ray"),
        ("local", {"workers": 0}, "workers must be >= 1"),
        ("local", {"address": "tcp://here:1"}, "an address belongs to dask and ray"),
        ("dask", {"slurm": {"slurm_partition": "a"}}, "belong to slurm"),
    ],
)
def test_bad_input_is_refused(name, options, message, tmp_path):
    with (
        pytest.raises(ParameterError, match=message),
        open_executor(name, **{"workers": 1, "folder": tmp_path, **options}),
    ):
        pass


@pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="ray is installed")
def test_ray_says_how_to_install_it(tmp_path):
    with (
        pytest.raises(ParameterError, match="needs the package ray: pip install ray"),
        open_executor("ray", workers=1, folder=tmp_path),
    ):
        pass


def test_slurm_needs_a_cluster(tmp_path):
    submitit = pytest.importorskip("submitit")
    if submitit.SlurmExecutor.affinity() >= 0:
        pytest.skip("there is one")
    with (
        pytest.raises(ParameterError, match="needs srun"),
        open_executor("slurm", workers=1, folder=tmp_path),
    ):
        pass
