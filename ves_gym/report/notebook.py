"""Progress in a notebook: a bar that any verb's `progress` takes."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import Any


def progress_bar() -> Callable[..., None]:
    """Show a bar in the notebook's output; without IPython nothing is shown.

    Returns:
        A callback for `progress` of `evaluate`, `train`, `diagnose` and `render`: of what it is
        called with, the last number is the fraction done, and text is written beside the bar.
    """
    try:
        from IPython.display import HTML, display
    except ImportError:
        return lambda *arguments: None
    handle: Any = display(HTML(_bar(0.0, "")), display_id=True)

    def on_progress(*arguments: Any) -> None:
        done = [float(word) for word in arguments if isinstance(word, (int, float))]
        words = " ".join(word for word in arguments if isinstance(word, str))
        if handle is not None:  # None outside a notebook
            handle.update(HTML(_bar(done[-1] if done else 0.0, words)))

    return on_progress


def _bar(done: float, words: str) -> str:
    percent = round(100 * min(max(done, 0.0), 1.0))
    return f'<progress value="{percent}" max="100"></progress> {percent} % {html.escape(words)}'
