"""Campaigns whose failures are exported."""

import pytest

from tests.exchange.exported import fuzz

CAMPAIGNS = {
    "intersection-straight": ("tests.drivers:cruiser", 4),
    "lane-follow": ("tests.drivers:cruiser", 4),
    "roundabout-v0": ("constant:FASTER", 4),
}


@pytest.fixture(scope="session", params=CAMPAIGNS)
def campaign(request, tmp_path_factory):
    """A run with failures, its environment and its driver."""
    ads, budget = CAMPAIGNS[request.param]
    return fuzz(tmp_path_factory.mktemp("exchange") / "run", request.param, ads, budget), request.param, ads
