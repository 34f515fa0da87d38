"""Subclasses of highway-env's environments, as users make them."""

from highway_env.envs import HighwayEnvFast, IntersectionEnv, RoundaboutEnv
from highway_env.road.road import Road, RoadNetwork


class CrowdedEnv(HighwayEnvFast):
    """Makes other vehicles than its parent, whose number is drawn, and has a key of its own."""

    @classmethod
    def default_config(cls):
        return super().default_config() | {"most_others": 6}

    def _create_vehicles(self):
        super()._create_vehicles()
        del self.road.vehicles[2 + int(self.np_random.integers(self.config["most_others"])) :]


class QuietIntersectionEnv(IntersectionEnv):
    """Begins with fewer vehicles than its parent; others appear in the same way."""

    def _make_vehicles(self, n_vehicles=10):
        super()._make_vehicles(min(n_vehicles, 2 + int(self.np_random.integers(3))))


class DriftingRoadEnv(HighwayEnvFast):
    """Draws the length of its road at each reset."""

    def _create_road(self):
        network = RoadNetwork.straight_road_network(3, length=1000.0 + self.np_random.uniform(0, 100))
        self.road = Road(network=network, np_random=self.np_random)


class DoublyRewardedEnv(RoundaboutEnv):
    """Has another reward than its parent."""

    def _reward(self, action):
        return 2 * super()._reward(action)
