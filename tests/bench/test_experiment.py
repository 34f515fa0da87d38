"""Experiments in files: what their runs are, and one sentence for whatever is wrong."""

from pathlib import Path

import pytest
import yaml

from behavexplor.bench.experiment import experiment_config, read_experiment
from behavexplor.campaign.campaign import search_method
from behavexplor.commands import main
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation

SHIPPED = sorted((Path(__file__).parents[2] / "configs" / "experiments").glob("*.yaml"))
SMALL = {"name": "small", "methods": {"A": {"method": "uniform"}, "B": {"method": "random"}}}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_shipped_experiments_can_be_run(path):
    experiment = read_experiment(path.stem)
    assert experiment.name == path.stem
    logical = Simulation(experiment.envs[0], "constant").logical
    for run in experiment.runs():
        if run.seed == experiment.first_seed and run.env == experiment.envs[0]:
            search_method(run.config, logical)


def test_what_the_shipped_experiments_are():
    assert {path.stem for path in SHIPPED} == {"default-planner", "paper", "policies", "quick", "windows"}
    paper = read_experiment("paper")
    assert (paper.seeds, paper.budget, len(paper.places), paper.systems) == (10, 750, 4, ("rule:apollo-like",))
    assert read_experiment("policies").places == [(env, f"learned:{env}") for env in paper.envs]
    assert [run.config.options["miner"]["window"] for run in read_experiment("windows").runs()[:4]] == [10, 1, 5, 15]


def test_cells_come_seed_by_seed_and_say_all_of_their_campaign():
    experiment = experiment_config({**SMALL, "seeds": 2, "first_seed": 7, "envs": ["lane-change", "lane-follow"]})
    runs = experiment.runs()
    assert [(run.seed, run.env, run.method) for run in runs[:3]] == [
        (7, "lane-change", "A"),
        (7, "lane-change", "B"),
        (7, "lane-follow", "A"),
    ]
    assert [run.seed for run in runs] == [7] * 4 + [8] * 4
    last = runs[-1].config
    assert (last.env, last.method, last.seed, last.budget) == ("lane-follow", "random", 8, "750")
    assert len({run.folder for run in runs}) == 8


def test_a_method_from_a_preset_has_its_options():
    experiment = experiment_config({"name": "x", "methods": {"w/o BG": {"config": "without-behavior-guidance"}}})
    (run, *_) = experiment.runs()
    assert run.config.method == "behavexplor"
    assert run.config.options == {"novelty": "none"}
    assert run.folder == Path("runs/intersection-straight/rule/w-o-BG/1")


def test_a_written_experiment_is_the_same_experiment():
    experiment = read_experiment("paper")
    assert experiment_config(yaml.safe_load(experiment.to_yaml())) == experiment


def test_each_environment_may_have_driving_systems_of_its_own():
    ads = {"lane-follow": ["learned:lane-follow", "rule"], "lane-change": ["rule"]}
    experiment = experiment_config({**SMALL, "ads": ads, "seeds": 1})
    assert experiment.places == [
        ("lane-follow", "learned:lane-follow"),
        ("lane-follow", "rule"),
        ("lane-change", "rule"),
    ]
    assert experiment.systems == ("learned:lane-follow", "rule")
    assert [(run.env, run.ads) for run in experiment.runs() if run.method == "A"] == experiment.places
    assert experiment_config(yaml.safe_load(experiment.to_yaml())) == experiment


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seads": 3}, "Unknown key of the experiment 'seads': did you mean 'seeds'?"),
        ({"methods": {}}, "methods of the experiment must name the methods"),
        ({"methods": ["uniform"]}, "methods of the experiment must name the methods"),
        ({"methods": {"A": None}}, "method 'A' of the experiment must have the key `method: NAME`"),
        ({"methods": {"A": {"metod": "x"}}}, "Unknown key of the method 'A' of the experiment 'metod': did you mean"),
        ({"methods": {"A": {"config": "papr"}}}, "did you mean 'paper'?"),
        ({"methods": {"A": {"config": "paper", "options": {}}}}, "has a config: give either the config alone"),
        ({"methods": {"A": {"method": 3}}}, "method of the method 'A' of the experiment"),
        ({"methods": {"A b": {"method": "uniform"}, "A/b": {"method": "random"}}}, "share a folder"),
        ({"seeds": 0}, "seeds: must be a number from 1 to 1000, got 0"),
        ({"seeds": "many"}, "seeds of the experiment"),
        ({"budget": "30m"}, "budget of the experiment"),
        ({"batch": 0}, "The batch 0"),
        ({"first_seed": -1}, "The seed -1"),
        ({"envs": []}, "envs of the experiment must not be empty"),
        ({"ads": ["rule", "rule"]}, "'rule' and another entry share a folder"),
        ({"ads": {"lane-follow": ["rule", "rule"]}}, "'rule' and another entry share a folder"),
        ({"ads": {"lane-follow": []}}, "ads of the experiment must not be empty"),
        ({"ads": "rule"}, "ads of the experiment must be a list of names, not 'rule'"),
        ({"ads": {"lane-follow": "rule"}}, "ads of the experiment must be a list of names, not 'rule'"),
        ({"ads": {}}, "envs of the experiment must not be empty"),
        ({"ads": {"lane-follow": ["rule"]}, "envs": ["lane-change"]}, "envs of the experiment must be left out"),
        ({"baseline": "C"}, "Unknown method of the experiment 'C'"),
        ({"groups": {"some": ["A", "D"]}}, "Unknown method of the experiment 'D'"),
        ({"groups": {"a/b": ["A"]}}, "name of a group, 'a/b'"),
        ({"name": "../x"}, "name of the experiment, '../x'"),
        ({"seeds": 1000, "envs": [f"e{i}" for i in range(60)]}, "120000 campaigns"),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_wrong_experiments_are_one_sentence(change, message):
    with pytest.raises(InputError) as error:
        experiment_config({**SMALL, **change})
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_config_that_says_more_than_the_method_is_refused(tmp_path):
    (tmp_path / "c.yaml").write_text("method: uniform\nenv: lane-follow\n")
    with pytest.raises(InputError, match="sets 'env'"):
        experiment_config({"name": "x", "methods": {"A": {"config": str(tmp_path / "c.yaml")}}})


def test_a_missing_experiment_names_those_that_are_shipped():
    with pytest.raises(InputError, match="did you mean 'quick'"):
        read_experiment("quik")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("methods: {A: {method: unifrom}}", "did you mean 'uniform'?"),
        ("methods: {A: {method: uniform, options: {x: 1}}}", "'x': there are none"),
        ("methods: {A: {method: uniform}}\nads: [rules]", "did you mean 'rule'?"),
        ("methods: {A: {method: uniform}}\nenvs: [lane-chnge]", "did you mean 'lane-change'?"),
        ("{{", "is not a YAML file"),
        ("", "methods of the experiment"),
    ],
)
def test_what_no_campaign_could_do_is_refused_before_any_begins(text, message, tmp_path, capsys):
    (tmp_path / "e.yaml").write_text(text)
    assert main(["bench", str(tmp_path / "e.yaml"), "--out", str(tmp_path / "out")]) == 2
    output = capsys.readouterr()
    assert message in output.err
    assert len(output.err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "mine").write_text("precious")
    assert main(["bench", "quick", "--out", str(tmp_path)]) == 2
    assert "neither empty nor an experiment folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_jobs_out_of_range_are_refused(capsys):
    assert main(["bench", "quick", "--jobs", "0"]) == 2
    assert "--jobs 0 must lie between 1 and" in capsys.readouterr().err
