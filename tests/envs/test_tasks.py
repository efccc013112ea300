"""What tasks say alike: settings and options that are refused, energies in the reward."""

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.runs import controlled
from ves_gym._util.params import ParameterError
from ves_gym.baselines.resolved import Resolved
from ves_gym.effects import PayloadMass
from ves_gym.envs.build import build_task
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

REFERENCES = "control must be acceleration or joint_velocity or tool_velocity or"
BARE = System(vehicle=BENT_THESIS)
MASS = PayloadMass(mass=2.0)
SETTINGS = [
    ("reach", {"tolerance": 0.0}, "tolerance must be > 0"),
    ("reach", {"thrift": -1.0}, "thrift must be >= 0"),
    ("reach", {"control": "pd_gains"}, REFERENCES),
    ("reach", {"span": [4.0]}, "must start within the joint limits"),
    ("reach_goal", {"control": "torque"}, "reach_goal: control must be .* or pd"),
    ("track", {"rounds": 0}, "rounds"),
    ("track", {"preview": [0.1, 0.13]}, "whole control periods of 0.0125 s"),
    ("track", {"preview": [0.0]}, "whole control periods"),
    ("track", {"control": "guided"}, "control must be acceleration"),
    ("seam", {"vehicle": "free-floating"}, "seam needs a base that holds its place"),
    ("seam", {"length": (0.5, 0.1)}, r"seam\.length must be 0 < low <= high"),
    ("damp", {"control": "guided"}, "control must be torque or pd_gains or acceleration"),
    ("damp", {"vehicle": "free-floating"}, "positive definite stiffness, got Satellite"),
    ("damp", {"home": [3.0, 0, 0]}, "must start within the joint limits"),
    ("damp", {"energy": 0.0}, "energy"),
    ("lqr", {"control": "pd_gains"}, "control must be torque"),
    ("damp", {"effects": ["payload/mass"]}, "must be an effect, .* got 'payload/mass'"),
    ("damp", {"effects": MASS}, r"must be a list, such as .*, got PayloadMass\(mass=2"),
    ("damp", {"effects": {"kind": "payload/mass"}}, "must be a list, .*, got {'kind'"),
    ("damp", {"effects": [{"kind": "payload/mas"}]}, 'did you mean "payload/mass"'),
    ("lqr", {"effort": 0.0}, "effort"),
    ("free_flyer", {"control": "pd_gains"}, REFERENCES),
    ("pose_reach", {"arm": "puma560"}, r"6 joints or more .* got puma560 with 3"),
    ("payload_transfer", {"mass": (0.0, 3.0)}, "mass must be 0 < from <= to"),
    ("payload_transfer", {"mass": (3.0,)}, r"shape \(2,\)"),
    ("payload_transfer", {"rest": 0.0}, "rest must be > 0"),
    ("payload_transfer", {"system": BARE}, "needs a system with a payload"),
    ("servicer_capture", {"mass": (0.0, 3.0)}, "mass must be 0 < from <= to"),
    ("servicer_capture", {"spin": (3.0,)}, r"shape \(2,\)"),
    ("servicer_capture", {"meet": (9.0, 8.0)}, "meet must be 0 < from"),
    ("servicer_capture", {"arm": "puma560"}, "6 joints or more"),
    ("servicer_capture", {"vehicle": "bent"}, "needs a satellite"),
    ("servicer_capture", {"control": "guided"}, "control must be acceleration"),
    ("servicer_capture", {"mode": "emulated"}, "knows a satellite's body, not its wheels"),
]  # fmt: skip
PUMA = [3.0, 0.0, 0.0]  # rad, beyond the first joint's limit
OPTIONS = [
    ("PumaReach", {"target": [3.0, 0.0, 0.9]}, r"a point in space that .* misses by 2\."),
    ("PumaReach", {"target": [0.5, 0.3]}, "target"),
    ("PumaReach", {"goal": PUMA}, "unknown option 'goal'; known: index, q, target"),
    ("FreeFlyerReach", {"target": [2.0, 0, 0]}, "that the tool reaches"),
    ("FreeFlyerReach", {"q": PUMA}, "joint 1 must be within"),
    ("PumaTrack", {"q": PUMA}, "joint 1 must be within"),
    ("PumaDamp", {"y": np.zeros(6)}, "must strain the base"),
    ("BeamLQR", {"q": PUMA}, "joint 1 must be within"),
    ("PoseReach", {"pose": [3.0, 0, 0, 0, 0, 0]}, "pose in space .* tool of puma560-wrist"),
    ("PoseReach", {"pose": [0.5, 0, 0]}, r"options\['pose'\] must have shape \(6,\)"),
]


@pytest.mark.parametrize(("task", "settings", "message"), SETTINGS)
def test_settings_that_do_not_fit_are_refused(task, settings, message):
    with pytest.raises(ParameterError, match=message):
        build_task(task, **settings)


@pytest.mark.parametrize(("name", "options", "message"), OPTIONS)
def test_options_that_do_not_fit_are_refused_and_change_nothing(name, options, message):
    env = gym.make(f"ves/{name}-v0").unwrapped
    env.reset(seed=0)
    first, ids = env.batch.scene.goal.copy(), env.episode_id.tolist()
    with pytest.raises(ParameterError, match=message):
        env.reset(seed=1, options=options)
    np.testing.assert_array_equal(env.batch.scene.goal, first)
    assert env.episode_id.tolist() == ids


@pytest.mark.parametrize(("task", "column"), [("reach", 3), ("track", 0)])
def test_energy_counts_by_its_mean_in_the_scale_of_the_start(task, column):
    env, _, costs, info = controlled(Resolved(), 8, task)
    scale = env.batch.scene.goal[:, column]
    expected = env.task.thrift * info["energy/E_mean"] / scale
    np.testing.assert_allclose(costs["energy"] + costs["tail"], expected, rtol=1e-2)
