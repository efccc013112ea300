"""A benchmark's result, small and real: a query of each duration, four planners."""

import copy
import html.parser

import pytest

from ves_gym.effects import GravityScale
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.suites import get_suite, part_of
from ves_gym.system.system import System

PLANNERS = ["straight", "hotspot-q", "refined", "direct"]


class Elements(html.parser.HTMLParser):
    """Start tags with attributes, the text of each script element, and all other text."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.scripts, self.text, self.inside = [], [], "", False
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.inside = tag == "script"
        if self.inside:
            self.scripts.append("")

    def handle_endtag(self, tag):
        self.inside = False

    def handle_data(self, data):
        if self.inside:
            self.scripts[-1] += data
        else:
            self.text += data


@pytest.fixture(scope="session")
def benchmarks():
    """In space, and in a laboratory whose scale is so wrong that it stops every run."""
    suite = part_of(get_suite("reach100", system=System()), [1.0, 2.0], first=1)
    heavy = System(mode="emulated", effects=(GravityScale(error=0.1),))
    lab = get_suite("thesis", system=heavy, vehicle="straight-horizontal-thesis")
    return (
        run_benchmark(suite, planners=PLANNERS, workers=1, command="ves-gym benchmark"),
        run_benchmark(lab, planners=["straight", "direct"], workers=1),
    )


@pytest.fixture
def result(benchmarks):
    return copy.deepcopy(benchmarks[0])


@pytest.fixture
def emulated(benchmarks):
    return copy.deepcopy(benchmarks[1])
