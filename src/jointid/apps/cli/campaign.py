"""The command `jointid campaign`: many joints, on one machine or a cluster."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from jointid.apps.cli.console import Flag, Quiet, listen, ready, show, show_result, spare
from jointid.common.errors import MethodError


def campaign(
    file: Path,
    /,
    *,
    out: Path | None = None,
    workers: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    dask: str | None = None,
    again: Flag = False,
    false_alarm: Annotated[float, Parameter(validator=Number(gt=0, lt=1))] = 0.01,
    details: Flag = False,
    html: Path | None = None,
    quiet: Quiet = False,
) -> None:
    """Identify the records of a campaign file; report drift, outliers and scatter.

    A repeated command continues where it was stopped. Ctrl-C, a kill or a full disk loses no result.

    Args:
        file: the campaign file (TOML).
        out: file of the results, one line each; without it the campaign file's name with .jsonl.
        workers: number of processes; by default one for each core.
        dask: address of the scheduler of a Dask cluster that runs the cases, as tcp://10.0.0.1:8786.
        again: also retry cases that were refused, failed or set aside.
        false_alarm: probability that any joint of a fleet without drift is reported.
        details: print all rows of every table.
        html: also write the report as one HTML page, with a plot of changes over the days.
        quiet: print no progress.
    """
    from jointid.campaigns.campaign import load_campaign
    from jointid.campaigns.report import CampaignReport
    from jointid.campaigns.run import dask_cluster, local_processes, open_store, run_cases
    from jointid.common.files import write_whole
    from jointid.config import loads
    from jointid.output.report.sections import page

    if dask is not None and workers:
        raise MethodError("--dask has its own workers; leave out --workers or --dask.")
    engine = partial(local_processes, count=workers) if dask is None else partial(dask_cluster, address=dask)
    kept = out or file.with_suffix(".jsonl")
    listener = listen(quiet)
    spare((kept, html), file)
    asked = load_campaign(file)
    if asked.left_out:
        listener(asked.left_out)
    with open_store(kept, again=again) as store:
        ready(listener, loads((first := asked.cases[0]).joint_file, changes=(*first.settings, *first.changes)))
        made = run_cases(asked.cases, engine, store, progress=listener)
        rows = store.rows_of(case.content_hash for case in asked.cases)
    found = CampaignReport(asked.name, rows, false_alarm)
    show(f"Run now: {sum(made.values())} of {len(rows)}.")
    show_result(found, details=details)
    if html is not None:
        write_whole(html, page(found.to_document(details=True, pictures=True)))
