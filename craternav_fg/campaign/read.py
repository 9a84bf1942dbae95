"""Read a campaign's folder."""

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from craternav_fg.campaign.store import MARKER, SUMMARY, TIMES, TRIAL_NAME, TRIALS
from craternav_fg.campaign.trial import METADATA, SCHEMA
from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import present_name
from craternav_fg.runs.columns import with_present_names


@dataclass(frozen=True)
class Campaign:
    """A campaign read back.

    Attributes
    ----------
    path : Path
        Its folder.
    identity : dict
        Contents of campaign.toml.
    table : pyarrow.Table
        All trials by number, with the columns of `craternav_fg.campaign.trial.SCHEMA`.
    failed : dict of int to str
        Trials without a result, and why.
    failures : dict of int to dict
        Of every other trial, the estimators that gave no trajectory, and why.
    times_s : dict of int to dict
        Wall times of the steps of each trial, where they are known.
    wall_s : float
        Wall time of all runs of the campaign.
    """

    path: Path
    identity: dict[str, Any]
    table: pa.Table
    failed: dict[int, str]
    failures: dict[int, dict[str, str]]
    times_s: dict[int, dict[str, float]]
    wall_s: float

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of summary.json.

        Raises
        ------
        InputError
            When it is missing, as the campaign was never completed, or damaged.
        """
        path = self.path / SUMMARY
        try:
            found = dict(json.loads(path.read_text(encoding="utf-8")))
            return {**found, "estimators": _present(found["estimators"])}
        except FileNotFoundError:
            raise InputError(path, "is missing: complete the campaign first") from None
        except (ValueError, KeyError) as error:
            raise InputError(path, f"is damaged: {error}") from None


def read_campaign(folder: Path | str) -> Campaign:
    """Read a campaign, complete or not.

    Parameters
    ----------
    folder : Path or str

    Returns
    -------
    Campaign

    Raises
    ------
    InputError
        When the folder is no campaign's, or a file of it is damaged.
    """
    path = Path(folder)
    if not (path / MARKER).is_file():
        raise InputError(path, f"expected a campaign's folder, found no {MARKER} in it")
    identity = read_identity(path)
    tables, failed, failures = [], {}, {}
    for number, file in sorted(trial_files(path).items()):
        metadata = read_metadata(file)
        if metadata["error"] is not None:
            failed[number] = metadata["error"]
            continue
        failures[number] = _present(metadata["failures"])
        tables.append(_table(file))
    lines = read_times(path / TIMES)
    wall_s: dict[int, float] = {}
    for line in lines:
        wall_s[line["session"]] = max(line["elapsed_s"], wall_s.get(line["session"], 0.0))
    times_s = {line["trial"]: _present(line["times_s"]) for line in lines if "trial" in line}
    table = pa.concat_tables(tables) if tables else SCHEMA.empty_table()
    return Campaign(path, identity, table, failed, failures, times_s, sum(wall_s.values()))


def read_identity(folder: Path) -> dict[str, Any]:
    """Read campaign.toml.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict

    Raises
    ------
    InputError
        When the file is damaged.
    """
    path = folder / MARKER
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(path, f"is damaged: {error}") from None
    if isinstance(found.get("estimators"), list):
        found["estimators"] = [present_name(name) for name in found["estimators"]]
    return found


def trial_files(folder: Path) -> dict[int, Path]:
    """Find the files of the trials in a campaign's folder, by number."""
    found = ((TRIAL_NAME.fullmatch(file.name), file) for file in (folder / TRIALS).glob("*.parquet"))
    return {int(match[1]): file for match, file in found if match is not None}


def read_metadata(path: Path) -> dict[str, Any]:
    """Read why a trial has failed (`error`), or which of its estimators (`failures`).

    Parameters
    ----------
    path : Path
        File of the trial.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        When the file is damaged.
    """
    try:
        return dict(json.loads(pq.read_schema(path).metadata[METADATA]))
    except (pa.ArrowInvalid, OSError, KeyError, TypeError, ValueError) as error:
        raise _damaged(path, error) from None


def _table(path: Path) -> pa.Table:
    try:
        table = pq.read_table(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise _damaged(path, error) from None
    return with_present_names(table.replace_schema_metadata(None))


def _present(by_estimator: dict[str, Any]) -> dict[str, Any]:
    """Replace former names of estimators, which an earlier version wrote."""
    return {present_name(name): value for name, value in by_estimator.items()}


def _damaged(path: Path, error: Exception) -> InputError:
    problem = " ".join(str(error).split())
    return InputError(path, f"is damaged: {problem}; remove it, and the next run repeats the trial")


def read_times(path: Path) -> list[dict[str, Any]]:
    """Read the lines of times.jsonl; a line that was cut short is left out."""
    lines = []
    for text in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []:
        try:
            lines.append(json.loads(text))
        except ValueError:
            continue
    return lines
