"""A limit on the time that verifying a bundle takes: beyond it the bundle is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ves_gym._util.process_pool import Workers
from ves_gym.leaderboard.errors import BundleError, Code


def within(seconds: float | None, function: Callable[..., Any], *args: Any, **more: Any) -> Any:
    """Call a function, in a process that is ended when the time is over, its workers with it.

    Args:
        seconds: that it may take, starting the process included; None for any time, and then
            it runs here.
        function: of a module.
        args, more: of the function.

    Raises:
        BundleError: TOO_LONG; or what the function raises.
    """
    if seconds is None:
        return function(*args, **more)
    try:
        with Workers(1, seconds=seconds) as pool:
            return pool.submit(function, *args, **more).result()
    except TimeoutError:
        raise BundleError(Code.TOO_LONG, f"not done after {seconds:g} s") from None
