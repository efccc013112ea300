"""An environment whose numbers differ by the processor alone is one and the same."""

import pytest

from ves_gym.leaderboard.fingerprint import environment, processor_free

FIRST = {  # with OpenBLAS's code for SkylakeX
    "ves/MacroMicro-v0": "a748341f9ae70edb5285a82d860841f530da445568407d53a30448c5b693bc0d",
    "ves/MacroMicroEmulated-v1": (
        "2123b0338253c00603e3fbf7c986b010cd6aabc977c9ba6e47ea16f532ca7a99"
    ),
    "ves/PumaReachGoalEmulated-v1": (
        "19fa675bd64f6bde1a660d8ea46a63faa667335b08cc3264e5b999c755daa745"
    ),
}


@pytest.mark.parametrize("id", FIRST)
def test_an_environment_is_the_same_on_every_processor(id):
    assert processor_free(environment(id)["spec"]) == FIRST[id]


def test_other_hashes_stand_for_themselves():
    other = environment("ves/PumaReach-v1")["spec"]
    assert processor_free(other) == other
    assert len(set(map(processor_free, FIRST.values()))) == len(FIRST)
