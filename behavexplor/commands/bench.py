"""`behavexplor bench`: run an experiment and write its tables."""

import signal
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.bench.comparisons import curves, curves_csv, headline
from behavexplor.bench.experiment import EXPERIMENT, Experiment, PlannedRun, read_experiment
from behavexplor.bench.experiment_archive import ARCHIVE, Archive, read_archive, write_archive
from behavexplor.bench.runs import ExperimentProgress, ExperimentRunner, run_state
from behavexplor.bench.summaries import Summary, summaries_csv, summarize
from behavexplor.bench.table import Table, table_csv, table_markdown
from behavexplor.bench.tables import tables
from behavexplor.campaign.campaign import method_options, search_method
from behavexplor.campaign.config import RUNS, check_said_twice
from behavexplor.campaign.opening import stopped_by_signals
from behavexplor.commands import EXECUTION_FAILED, INTERRUPTED, OK, program
from behavexplor.commands.display import Meter
from behavexplor.commands.plain_tables import text
from behavexplor.commands.shared_flags import Switch, Trust
from behavexplor.commands.wording import clock, counted, say, wrapped
from behavexplor.data.durable import make_folder, write_durably, writing
from behavexplor.errors import InputError, sentence
from behavexplor.execution.executor import available_cores
from behavexplor.execution.ray_cluster import parse_cluster
from behavexplor.execution.start import fewest_workers, logical_of_target, start_executor
from behavexplor.judge.robustness import load_specs
from behavexplor.report.experiment_page import experiment_page
from behavexplor.report.run_page import PAGE

_MAX_JOBS = 1024


def bench(  # noqa: PLR0913 - one argument for each flag
    experiment: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="EXPERIMENT")],
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: runs/NAME)")] = None,
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the available cores)")] = None,
    cluster: Annotated[str, tyro.conf.arg(metavar="ray[:ADDRESS]", help_behavior_hint="")] = "",
    trust: Trust = (),
    dry_run: Switch = False,
    tables_only: Switch = False,
    unconfined: Switch = False,
    quiet: Switch = False,
) -> int:
    """Compare search methods: run each with several seeds in every environment and with every driving system.

    Finished campaigns are not repeated. After an interruption, the same command continues the experiment.

    Args:
        experiment: YAML file of the experiment, or name of a shipped one: "quick", "paper", "windows",
            "default-planner" or "policies".
        out: Folder of the experiment.
        jobs: Number of campaigns at a time, each on one core; with --cluster, the number of nodes.
        cluster: Run the campaigns on a Ray cluster (docs/scale.md); without ADDRESS, on this machine.
        trust: Allow the policy file with this digest ("sha256:...") to execute code on load. May be repeated.
        dry_run: Only show the number of campaigns and of executions.
        tables_only: Only write the tables of the finished campaigns.
        unconfined: Allow drivers that are not shipped with behavexplor to write files and use the network.
        quiet: Show no progress.
    """
    chosen = read_experiment(experiment)
    if not tables_only:
        given = {"trust": trust, "unconfined": unconfined}
        check_said_twice({"trust": chosen.trust, "unconfined": chosen.unconfined}, given, experiment)
    trusted = tuple(dict.fromkeys((*chosen.trust, *trust)))  # each digest once
    chosen = replace(chosen, trust=trusted, unconfined=unconfined or chosen.unconfined)
    jobs = _checked_jobs(jobs, cluster)
    root = out or RUNS / chosen.name
    archived = read_archive(chosen.runs(), root)
    runs = [run for run in chosen.runs() if run not in archived]
    if dry_run:
        for run in runs:
            method_options(run.config)  # raises if they are invalid
        say(_plan(chosen, runs, root))
        return OK
    code = OK
    if not tables_only:
        _prepare(chosen, root)
        code = _run(chosen, runs, root, jobs, cluster, quiet=quiet)
    finished = [run for run in runs if run_state(run, root).finished]
    summaries = {**archived, **_summaries(finished, root, quiet=quiet)}
    if summaries:
        _report(chosen, root, {run: summaries[run] for run in chosen.runs() if run in summaries})
    say(f"{len(summaries)} of {counted(len(chosen.runs()), 'campaign')} finished\nAll results are in {root}")
    if summaries:
        say(f"Report: {root / PAGE}")
    return code


def _checked_jobs(jobs: int | None, cluster: str) -> int:
    """Return the number of jobs; 0 for as many nodes as a cluster has cores."""
    if cluster:
        parse_cluster(cluster)
    if jobs is None:
        return 0 if cluster else available_cores()
    if not 1 <= jobs <= _MAX_JOBS:
        raise InputError(f"--jobs {jobs} must lie between 1 and {_MAX_JOBS}")
    return jobs


def _plan(experiment: Experiment, runs: Sequence[PlannedRun], root: Path) -> str:
    """Describe the campaigns that would be run; `runs` are those that are not archived."""
    states = [run_state(run, root) for run in runs]
    planned = len(experiment.runs())
    finished = planned - len(runs) + sum(state.finished for state in states)
    left = sum(experiment.budget - state.executions for state in states if not state.finished)
    parts = ", ".join(
        [
            counted(len(experiment.envs), "environment"),
            counted(len(experiment.systems), "driving system"),
            counted(len(experiment.methods), "method"),
            counted(experiment.seeds, "seed"),
        ]
    )
    lines = [
        f"{counted(planned, 'campaign')} of {counted(experiment.budget, 'execution')}: {parts}",
        f"{finished} finished; {counted(left, 'execution')} left",
    ]
    return "\n".join(map(wrapped, lines))


def _prepare(experiment: Experiment, root: Path) -> None:
    """Check the whole experiment before its first campaign, and create its folder.

    Raises:
        InputError: if an environment, a driving system, a method, a spec or the folder cannot be used.
    """
    known = any((root / name).is_file() for name in (EXPERIMENT, ARCHIVE))
    if root.is_dir() and any(root.iterdir()) and not known:
        raise InputError(f"{root} is neither empty nor an experiment folder: choose another --out")
    load_specs(experiment.specs)
    by_driver: dict[tuple[str, str], list[PlannedRun]] = {}  # the first run of each method, by environment and ADS
    for run in experiment.runs():
        if run.seed == experiment.first_seed:
            by_driver.setdefault((run.env, run.ads), []).append(run)
    for (env, _), runs in by_driver.items():
        target = runs[0].config.target
        with start_executor(target, fewest_workers(target)) as executor:
            logical = logical_of_target(executor, env)
        for run in runs:
            search_method(run.config, logical)  # raises if the method or its options are invalid
    with writing(f"The experiment folder {root}"):
        write_durably(make_folder(root) / EXPERIMENT, experiment.to_yaml())


def _run(
    experiment: Experiment, runs: Sequence[PlannedRun], root: Path, jobs: int, cluster: str, *, quiet: bool
) -> int:
    """Run the unfinished campaigns, and return the exit code."""
    runner = ExperimentRunner(runs, root, jobs, experiment.workers, cluster)
    total = len(runs) * experiment.budget
    with _stoppable(runner), Meter(sys.stderr, total, "executions", quiet=quiet) as meter:
        ended = runner.run(lambda progress: meter.show(progress.executions, _progress_text(progress)))
    for warning in ended.warnings:
        say(f"Warning: {sentence(warning)}", file=sys.stderr)
    for run, failure in ended.failed.items():
        say(f"{program()}: {sentence(f'{run}: {failure}')}", file=sys.stderr)
    if runner.stopping:
        say("Interrupted; the same command continues the experiment", file=sys.stderr)
        return INTERRUPTED
    return EXECUTION_FAILED if ended.failed else OK


def _progress_text(progress: ExperimentProgress) -> str:
    failed = f", {len(progress.failed)} failed" if progress.failed else ""
    left = f", about {clock(progress.left)} left" if progress.left is not None else ""
    return f"{progress.finished} of {counted(progress.runs, 'campaign')}{failed}{left}"


def _summaries(runs: Sequence[PlannedRun], root: Path, *, quiet: bool) -> dict[PlannedRun, Summary]:
    """Summarize each campaign, which takes a minute or two for a large experiment with many failures."""
    with Meter(sys.stderr, len(runs), "campaigns read", quiet=quiet) as meter:
        found = {}
        for run in runs:
            found[run] = summarize(run, root)
            meter.show(len(found))
    return found


def _report(experiment: Experiment, root: Path, campaigns: Archive) -> None:
    """Print the verdicts, and write the tables, curves, summaries, archive and page to the experiment folder."""
    summaries = list(campaigns.values())
    all_tables = tables(experiment, summaries)
    listed = "\n\n".join(map(text, all_tables)) + "\n"
    drawn = curves(experiment, summaries)
    files = {"summaries.csv": summaries_csv(summaries), "tables.txt": listed, "curves.csv": curves_csv(drawn)}
    files |= {f"tables/{table.name}.csv": table_csv(table) for table in all_tables}
    files |= {f"tables/{table.name}.md": table_markdown(table) for table in all_tables}
    verdicts = headline(experiment, summaries)
    files[PAGE] = experiment_page(experiment, summaries, [*verdicts, *all_tables], drawn)
    with writing(f"The tables in {root}"):
        make_folder(root, "tables")
        for name, content in files.items():
            write_durably(root / name, content)
        write_archive(campaigns, root)
    for table in verdicts:
        parts = [wrapped(table.title), *map(text, _by_scenario(table)), *map(wrapped, table.notes)]
        say("\n\n".join(parts) + "\n")
    say(f"All tables: {root / 'tables.txt'}")


def _by_scenario(table: Table) -> list[Table]:
    """Split a table by its first column, the scenario, into narrower tables with the scenario above them."""
    columns = table.columns[1:]
    names = dict.fromkeys(str(row[0]) for row in table.rows)
    rows = {name: tuple(row[1:] for row in table.rows if row[0] == name) for name in names}
    return [Table(table.name, name, columns, own, blocks=(len(own),)) for name, own in rows.items()]


def _stoppable(runner: ExperimentRunner) -> AbstractContextManager[None]:
    def stop() -> None:
        runner.stop()
        say("Stopping after the current executions; press Ctrl-C again to stop at once.", file=sys.stderr)

    return stopped_by_signals(stop, signal.default_int_handler)
