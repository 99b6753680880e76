"""`jointid campaign`: many joints and many runs, on one machine and on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from jointid.apps.cli.console import Flag, Quiet, fresh_folder, listen, ready, show
from jointid.apps.cli.places import Outputs
from jointid.common.errors import MethodError

if TYPE_CHECKING:
    from jointid.campaigns.campaign_file import Campaign
    from jointid.campaigns.engines import Engine
    from jointid.common.messages import Progress


def run(
    campaign: Path,
    /,
    *,
    out: Path,
    workers: int = 0,
    dask: str | None = None,
    again: Flag = False,
    quiet: Quiet = False,
) -> None:
    """Identify all that a campaign file names, on all cores.

    Given again, it goes on where it was ended.

    Every result is kept as it comes, once; Ctrl-C, a kill or a full disk loses none of them.

    Args:
        campaign: the campaign file (TOML).
        out: folder of the results, on a local disk; it is made if it is not there.
        workers: processes, one for each core when 0.
        dask: address of the scheduler of a Dask cluster that carries out the cases, as tcp://10.0.0.1:8786.
        again: also try again what was refused, failed or set aside.
        quiet: say nothing of the progress.
    """
    from jointid.campaigns.run import run_cases
    from jointid.campaigns.store import open_database

    engine = _engine(workers, dask)
    outputs, listener = Outputs(folders={"--out": out}), listen(quiet)
    outputs.spare("CAMPAIGN", campaign)
    asked = _load(campaign, listener)
    with fresh_folder(out, "--out"), open_database(out) as database:
        if again:
            database.forget_failures()
        ready(listener)
        ran = run_cases(asked.cases, engine, database, name=asked.name, progress=listener)
    show(ran)
    show(f"What came of them: jointid campaign report {out}")


def work(campaign: Path, /, *, shard: str, out: Path, workers: int = 1, quiet: Quiet = False) -> None:
    """Carry out a part of a campaign without a client.

    As a task of a SLURM array, or a pod of a Kubernetes job.

    Every shard appends its results to a file of its own; status, report and export read all files of a folder as one.

    Args:
        campaign: the campaign file (TOML).
        shard: number of this part and how many there are, as 1/4 to 4/4.
        out: folder of the results, which all shards share; it is made if it is not there.
        workers: processes of this shard, one for each core when 0.
        quiet: say nothing of the progress.
    """
    from jointid.campaigns.engines import LocalProcesses
    from jointid.campaigns.run import run_cases
    from jointid.campaigns.shards import Shard, open_shard

    part = Shard.of(shard)
    _require_workers(workers)
    outputs, listener = Outputs(folders={"--out": out}), listen(quiet)
    outputs.spare("CAMPAIGN", campaign)
    asked = _load(campaign, listener)
    with fresh_folder(out, "--out"), open_shard(out, part) as results:
        ready(listener)
        engine = LocalProcesses(workers)
        show(run_cases(asked.cases, engine, results, name=asked.name, has=part.has, progress=listener))


def status(results: Path, /, *, details: Flag = False) -> None:
    """Print finished cases, rate and time left.

    Args:
        results: folder of the results.
        details: also every reason for which there is no answer.
    """
    from jointid.campaigns.folder import read_status

    show(read_status(results), details=details)


def report(
    results: Path,
    /,
    *,
    false_alarm: float = 0.01,
    details: Flag = False,
    html: Path | None = None,
    markdown: Path | None = None,
) -> None:
    """Report joints that drifted, outliers and scatter.

    Args:
        results: folder of the results.
        false_alarm: chance that any joint is named where none drifted, for all joints together.
        details: all rows of every table, rather than a screen of them.
        html: also write all of it as one HTML page, with pictures of joints, days and changes.
        markdown: also write all of it as Markdown.
    """
    from jointid.campaigns.report import report_of
    from jointid.common.files import write_whole
    from jointid.output.report.page import page, require_extra

    Outputs({"--html": html, "--markdown": markdown})
    if html is not None:
        require_extra(plots=False)
    found = report_of(results, false_alarm)
    show(found, details=details)
    if html is not None:
        write_whole(html, page(found.to_page()))
    if markdown is not None:
        write_whole(markdown, found.to_document(details=True).markdown())


def export(results: Path, /, *, out: Path) -> None:
    """Write the results as a table, a row for each case.

    With versions, settings and hashes.

    Args:
        results: folder of the results.
        out: the file to write, .csv or .parquet.
    """
    from jointid.campaigns.folder import read_results
    from jointid.campaigns.report import export_rows, require_ending

    Outputs({"--out": out})
    require_ending(out)
    found = read_results(results)
    export_rows(found.rows, out)
    show(f"Written: {out}, {len(found.rows)} of {found.cases} cases")


def _load(path: Path, listener: Progress) -> Campaign:
    from jointid.campaigns.campaign_file import load_campaign

    campaign = load_campaign(path)
    if campaign.left_out:
        listener(campaign.left_out)
    return campaign


def _engine(workers: int, dask: str | None) -> Engine:
    """Return the engine that runs the cases.

    Raises:
        MethodError: what is asked for does not go together.
    """
    from jointid.campaigns.engines import DaskCluster, LocalProcesses

    _require_workers(workers)
    if dask is not None and workers:
        raise MethodError("--dask has its own workers; leave out --workers or --dask.")
    return LocalProcesses(workers) if dask is None else DaskCluster(dask)


def _require_workers(workers: int) -> None:
    if workers < 0:
        raise MethodError(f"--workers is {workers}; expected a whole number, 0 or more: 0 is one for each core.")
