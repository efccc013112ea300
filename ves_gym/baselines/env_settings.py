"""Settings of an environment with another arm, and with effects beside those that it has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ves_gym._util.params import to_plain
from ves_gym.baselines.evaluate import spec_of
from ves_gym.envs.build import build_task
from ves_gym.envs.control import for_arm
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.system.effect import Effect


def with_deviations(
    id: str, settings: Mapping[str, Any], effects: Sequence[Effect] = (), arm: str | None = None
) -> dict[str, Any]:
    """Return settings with an arm, whose numbers per joint are its own, and with effects.

    Args:
        id: registered id of the environment.
        settings: that it is made with.
        effects: beside those that it has.
        arm: name or file; None: the environment's.
    """
    id = id if "/" in id else f"ves/{id}"
    out = dict(settings)
    if arm is not None:
        given = get_arm(arm)  # refused here, not in a worker
        if "control" in settings:
            control = build_task(**{**spec_of(id).kwargs, **settings}).control
            out["control"] = to_plain(for_arm(control, given))
        out["arm"] = arm
    if effects:
        task = build_task(**{**spec_of(id).kwargs, **out})
        out["effects"] = [to_plain(e) for e in (*task.system.effects, *effects)]
    return out
