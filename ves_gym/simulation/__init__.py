"""Simulator, playback of motions, the emulation loop, its stability and its calibration."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.simulation.gravity_calibration import calibration_poses as calibration_poses
    from ves_gym.simulation.gravity_calibration import fit as fit_gravity
    from ves_gym.simulation.gravity_learning import learn_gravity as learn_gravity
    from ves_gym.simulation.playback import play_motions as play_motions
    from ves_gym.simulation.playback import weigh_poses as weigh_poses

__all__ = ["calibration_poses", "fit_gravity", "learn_gravity", "play_motions", "weigh_poses"]

_HOMES = {
    "calibration_poses": "gravity_calibration",
    "fit_gravity": "gravity_calibration:fit",
    "learn_gravity": "gravity_learning",
    "play_motions": "playback",
    "weigh_poses": "playback",
}
_lazily(__name__, _HOMES)
