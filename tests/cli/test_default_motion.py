"""A motion for an arm that has been told no goal; names of vehicles in titles."""

import argparse
import json

import numpy as np
import pytest

from ves_gym.cli import simulate
from ves_gym.cli.main import main
from ves_gym.cli.motions import motion_from
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.limits import default_goal, limit_ratios
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import get_vehicle, vehicle_name


@pytest.mark.parametrize("name", arm_names())
@pytest.mark.parametrize("duration", [0.5, 4.0])
def test_every_joint_moves_within_half_of_its_limits(name, duration):
    arm = get_arm(name)
    goal = default_goal(arm, np.zeros(arm.n), duration)
    assert (np.abs(goal) > 1e-4).all()
    assert np.abs(goal).max() <= np.deg2rad(60.0) + 1e-12
    ratios = limit_ratios(arm, Motion.straight(np.zeros(arm.n), goal, duration))
    assert ratios["position"].max() <= 1
    assert max(ratios[k].max() for k in ("velocity", "acceleration", "torque")) <= 0.5


def test_an_arm_of_seven_joints_is_moved_where_no_goal_is_given():
    arm, parser = get_arm("iiwa14"), argparse.ArgumentParser()
    simulate.add_arguments(parser)
    motion = motion_from(parser.parse_args([]), arm)
    assert motion.duration == 2.0
    assert np.abs(motion.goal - default_goal(arm, np.zeros(7), 2.0)).max() == 0.0
    thesis = motion_from(parser.parse_args([]), get_arm("puma560"))
    assert np.abs(np.rad2deg(thesis.goal) - [60, 40, -30]).max() <= 1e-12


def test_a_title_names_the_vehicle_and_the_table_the_propellant(tmp_path, capsys):
    words = ["simulate", "--vehicle", "servicer", "--settle", "0.2", "--duration", "0.5"]
    assert main([*words, "--out", str(tmp_path), "--json", str(tmp_path / "out.json")]) == 0
    out = capsys.readouterr().out
    assert "puma560 on servicer, 0.5 s" in out
    assert "nominal" not in out
    assert "propellant" in out
    assert json.loads((tmp_path / "out.json").read_text("utf-8"))["propellant"] >= 0


def test_a_vehicle_of_ones_own_has_its_kind_for_a_name():
    assert vehicle_name(get_vehicle("bent")) == "bent"
    assert vehicle_name(get_vehicle("servicer-flexible")) == "servicer-flexible"
