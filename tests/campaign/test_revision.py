"""Campaigns of an earlier revision of the program are read, and never continued as something else."""

from contextlib import closing
from dataclasses import replace

import pytest
import yaml

from behavexplor.bench.experiment import PlannedRun
from behavexplor.bench.runs import run_state
from behavexplor.campaign.campaign import search_method
from behavexplor.campaign.config import REVISION, CampaignConfig, campaign_config, read_config, stored_config
from behavexplor.campaign.opening import opened
from behavexplor.campaign.store import Store
from behavexplor.commands.records import records
from behavexplor.commands.report import report
from behavexplor.errors import InputError
from tests.campaign.test_campaign import LOGICAL, run

SEEDED = read_config("samota-seeded")["options"]
REFUSED = f"is a campaign of revision 1, and this version of behavexplor runs revision {REVISION}"


@pytest.fixture
def old(tmp_path):
    """A run as the first revision wrote it: what is now samota-seeded was called samota, without a revision."""
    run(tmp_path / "old", method="samota", options=SEEDED, budget="20", batch=4)
    path = tmp_path / "old" / "config.yaml"
    values = yaml.safe_load(path.read_text())
    del values["revision"]
    path.write_text(yaml.safe_dump(values | {"options": {}}))
    return tmp_path / "old"


def test_a_campaign_says_its_revision(tmp_path):
    run(tmp_path / "new", budget="3")
    assert stored_config(tmp_path / "new").unverified.revision == REVISION == CampaignConfig().revision
    assert campaign_config({}).revision == REVISION  # a file of flags says none, and means this version


def test_an_old_run_is_read(old, capsys):
    assert stored_config(old).unverified.revision == 1
    assert records(old) == 0
    assert len(capsys.readouterr().out.splitlines()) == 20
    assert report([old]) == 0


def test_an_old_run_is_not_resumed(old):
    before = (old / "campaign.db").read_bytes(), (old / "config.yaml").read_bytes()
    config = replace(stored_config(old).unverified, budget="30")
    with pytest.raises(InputError, match=REFUSED), opened(config, old, 0, resume=True):
        pass
    assert ((old / "campaign.db").read_bytes(), (old / "config.yaml").read_bytes()) == before


def test_an_old_run_is_not_resumed_by_a_configuration_of_this_revision(old):
    with pytest.raises(InputError, match=REFUSED), opened(CampaignConfig(method="samota"), old, 0, resume=True):
        pass


def test_an_old_run_does_not_count_for_an_experiment(old, tmp_path):
    planned = PlannedRun("intersection-straight", "rule", "SAMOTA", 3, CampaignConfig(method="samota", seed=3, batch=4))
    (tmp_path / planned.folder).parent.mkdir(parents=True)
    old.rename(tmp_path / planned.folder)
    with pytest.raises(InputError, match=REFUSED):
        run_state(planned, tmp_path)


def test_even_without_revisions_two_methods_are_not_mixed(old):
    """The stored scenarios are those of another search."""
    with pytest.raises(InputError, match="would now be a different scenario"):
        run(old, method="samota", budget="30", batch=4)
    with closing(Store.read(old)) as store:
        assert len(store) == 20


def test_a_new_campaign_of_another_revision_is_refused(tmp_path):
    config = CampaignConfig(revision=REVISION + 1)
    assert search_method(config, LOGICAL)
    with pytest.raises(InputError, match=f"revision {REVISION + 1}"), opened(config, tmp_path / "a", 0, resume=False):
        pass
    assert not (tmp_path / "a").exists()
