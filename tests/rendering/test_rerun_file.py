"""Runs recorded for rerun, read by rerun's own reader."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

import ves_gym as vg
from ves_gym.mechanics.attitude import to_matrix
from ves_gym.mechanics.kinematics import joint_positions, tool_frame
from ves_gym.rendering.rerun_file import TIMELINE, RecordingScene
from ves_gym.system.energy import log_base_energy


@pytest.fixture(scope="module")
def runs():
    ends = {"there": [0.6, -0.3, 0.4], "elsewhere": [-0.5, 0.4, 0.1]}
    motions = {k: vg.Motion.straight([0, 0, 0], q, 0.5) for k, q in ends.items()}
    how = {"settle": 0.25, "record_dt": 0.0125}
    return {k: vg.simulate(motion, **how) for k, motion in motions.items()}


def read(path):
    """(time [s], component) -> values of every entity that moves, and the still ones' names."""
    moving, still = {}, set()
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.is_static:
            still.add(chunk.entity_path)
            continue
        table = {name: batch.column(name).to_pylist() for name in batch.schema.names}
        rows = moving.setdefault(chunk.entity_path, {})
        for name, values in table.items():
            if name == TIMELINE:
                rows[name] = np.asarray(batch.column(name).to_numpy(), "i8") / 1e9
            elif name != "rerun.controls.RowId":
                rows[name] = np.array(values)
    return moving, still


def test_poses_and_columns_are_the_logs(runs, tmp_path):
    """Columns: every float64 exactly. Poses: the log's, rounded once to rerun's float32."""
    moving, still = read(vg.export(runs, tmp_path / "runs.rrd"))
    for name, log in runs.items():
        base = moving[f"/{name}/base"]
        np.testing.assert_array_equal(base[TIMELINE], np.rint(log.t * 1e9) / 1e9)
        places = base["Transform3D:translation"][:, 0]
        np.testing.assert_array_equal(places, log.y[:, :3].astype(np.float32))
        x, y, z, w = base["Transform3D:quaternion"][:, 0].T
        turned = vg.mechanics.spatial.rotation(log.y)
        np.testing.assert_allclose(to_matrix(np.stack([w, x, y, z], -1)), turned, atol=3e-7)
        links = joint_positions(vg.PUMA_560, log.q)[:, 1:]
        for i in range(3):
            place = moving[f"/{name}/base/link_{i + 1}"]["Transform3D:translation"][:, 0]
            np.testing.assert_array_equal(place, links[:, i].astype(np.float32))
        for quantity in ("q", "v", "tau", "y", "yd", "w", "u"):
            values = moving[f"/{name}/{quantity}"]["Scalars:scalars"]
            np.testing.assert_array_equal(values, getattr(log, quantity))
        energy = moving[f"/{name}/energy"]["Scalars:scalars"]
        np.testing.assert_array_equal(energy[:, 0], log_base_energy(log).total)
        assert {f"/{name}/tool", f"/{name}/base/link_3"} <= still


def test_the_beam_ends_at_the_base_and_bends(runs, tmp_path):
    moving, _ = read(vg.export(runs["there"], tmp_path / "run.rrd"))
    line = moving["/run/beam"]["LineStrips3D:strips"][:, 0]
    np.testing.assert_allclose(line[:, -1], runs["there"].y[:, :3], atol=1e-6)
    assert np.ptp(line[:, 3:-1], axis=0).max() > 1e-4 and not np.ptp(line[:, 0], axis=0).any()


def test_the_tool_is_where_the_base_carries_it(runs):
    log = runs["there"]
    place, _ = tool_frame(vg.PUMA_560, log.q)
    turn = vg.mechanics.spatial.rotation(log.y)
    expected = log.y[:, :3] + np.einsum("nij,nj->ni", turn, place)
    np.testing.assert_allclose(RecordingScene(log).tool, expected, atol=1e-12)


def test_a_base_that_is_magnified_leaves_the_columns(runs, tmp_path):
    log = runs["there"]
    moving, _ = read(vg.export(log, tmp_path / "run.rrd", magnify=10))
    places = moving["/run/base"]["Transform3D:translation"][:, 0]
    np.testing.assert_array_equal(places, (10 * log.y[:, :3]).astype(np.float32))
    np.testing.assert_array_equal(moving["/run/y"]["Scalars:scalars"], log.y)


@pytest.mark.parametrize(
    ("system", "entities"),
    [
        ({"vehicle": "servicer-flexible"}, {"/run/base/appendage_1"}),
        ({"vehicle": "free-floating"}, {"/run/base"}),
        ({"vehicle": "bent", "mode": "emulated"}, {"/run/legs"}),
        ({"vehicle": "decoupled"}, {"/run/base"}),
    ],
)
def test_every_kind_of_base_is_recorded(system, entities, tmp_path):
    system = vg.System.from_dict(system)
    start = system.arm.home
    motion = vg.Motion.straight(start, start + 0.05, 0.2)
    log = vg.simulate(motion, system, settle=0.0)
    moving, _ = read(vg.export(log, tmp_path / "run.rrd"))
    assert entities <= moving.keys()


def test_links_that_bend_are_entities():
    system = vg.System.from_dict({"arm": "canadarm2", "vehicle": "decoupled"})
    log = vg.simulate(vg.Motion.straight(system.arm.home, system.arm.home + 0.02, 0.2), system,
                      settle=0.0)  # fmt: skip
    places, turns = RecordingScene(log).links
    assert places.shape[1] == turns.shape[1] == system.arm.n + system.arm.bends


def test_what_cannot_be_recorded_is_refused(runs, tmp_path):
    parts = {k: getattr(runs["there"], k) for k in ("t", "q", "q_cmd", "v_cmd", "y")}
    bare = vg.RunLog(**parts, meta={"format": "ves-run/1"})
    with pytest.raises(vg.ParameterError, match="no 'system'"):
        vg.export(bare, tmp_path / "run.rrd")
    with pytest.raises(vg.ParameterError, match="logs by name"):
        vg.export(runs, tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())
