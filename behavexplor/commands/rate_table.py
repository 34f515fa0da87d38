"""The table of a driver's rates."""

from collections.abc import Mapping

from behavexplor.commands.plain_tables import grid, plain_text
from behavexplor.commands.wording import wrapped
from behavexplor.data.trace import ARRIVED
from behavexplor.evaluation import Evaluation
from behavexplor.judge.specs import SPECS


def rates_table(env: str, evaluations: Mapping[str, Evaluation]) -> str:
    """Return the rates of a driver in percent with their 95 % intervals, and those of what it is compared with.

    Args:
        env: the environment.
        evaluations: the evaluations by name, that of the driver first.
    """
    (name, first), *others = evaluations.items()
    rates = grid("", name, numbers=[name])
    for outcome in shown_outcomes({name: first}):
        low, high = first.interval(outcome)
        interval = "" if first.decision else f" ({low:.1%} to {high:.1%})"
        kind, _, fault = outcome.partition(": ")
        rates.add_row(f"  {fault.replace('_', ' ')}" if fault else kind, f"{first.rate(outcome):.1%}{interval}")
    intervals = "the one interval that holds is below" if first.decision else "with 95 % intervals"
    lines = [wrapped(f"{first.n} scenarios of {env}, {intervals}:"), plain_text(rates)]
    if others:
        shown = [outcome for outcome in shown_outcomes(dict(others)) if ": " not in outcome]
        beside = grid("", *shown, numbers=shown)
        for heading, found in others:
            beside.add_row(heading, *(f"{found.rate(outcome):.1%}" for outcome in shown))
        lines += [f"Beside it, in {others[0][1].n} scenarios:", plain_text(beside)]
    return "\n".join(lines)


def shown_outcomes(evaluations: Mapping[str, Evaluation]) -> list[str]:
    """Return the outcomes that are shown of some evaluations, each kind of outcome together."""
    outcomes = dict.fromkeys(
        outcome for found in evaluations.values() for outcome in found.counts if not _is_redundant(outcome, evaluations)
    )
    kinds = list(dict.fromkeys(outcome.partition(": ")[0] for outcome in outcomes))
    return sorted(outcomes, key=lambda outcome: (kinds.index(outcome.partition(": ")[0]), outcome))


def _is_redundant(outcome: str, evaluations: Mapping[str, Evaluation]) -> bool:
    """Return whether another row says the same of all drivers: missed destinations, or collisions of unknown fault."""
    collision, _, destination = (spec.name for spec in SPECS)
    rows = [(found.n, found.counts.get(outcome, 0), found.counts) for found in evaluations.values()]
    if outcome == destination:
        return all(count + counts.get(ARRIVED, 0) == n for n, count, counts in rows)
    return outcome == f"{collision}: other" and all(count == counts.get(collision, 0) for _, count, counts in rows)
