from behavexplor.ads.interface import ADS, DecisionLog
from behavexplor.ads.rule import RulePlanner
from behavexplor.envs.functional import IntersectionStraightEnv

LOGICAL = IntersectionStraightEnv.logical


class Blind:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return observation, state


def test_the_rule_planner_is_an_ads_with_a_decision_log():
    planner = RulePlanner(LOGICAL.roadmap)
    assert isinstance(planner, ADS)
    assert isinstance(planner, DecisionLog)


def test_predict_alone_does_not_declare_what_is_observed():
    assert not isinstance(Blind(), ADS)
    assert not isinstance(Blind(), DecisionLog)
