"""Read a campaign's folder."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field, ValidationError

from craternav_fg.campaign.store import MARKER, SUMMARY, TIMES, TRIAL_NAME, TRIALS
from craternav_fg.campaign.trial import FILTERED_BOUND, METADATA, SCHEMA, SMOOTHED_BOUND
from craternav_fg.config import ResultSection, Section, read_json, read_toml, validate
from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import present_name
from craternav_fg.files import SizeLimit, check_input, entries, exists, read_bytes
from craternav_fg.runs.columns import check_names, with_present_names
from craternav_fg.tables.parquet import read_parquet, read_parquet_metadata, require_finite

_BOUNDS = (FILTERED_BOUND, SMOOTHED_BOUND)
_ERRORS = ("attitude_error_rad", "position_error_m", "velocity_error_m_s")
# Of the rows of a bound the errors are empty, of some estimators the covariances.
_EMPTY = (*_ERRORS, "pose_sigma", "nees")
_ROWS = pa.schema([field.with_nullable(field.name in _EMPTY) for field in SCHEMA])
_REPEAT = "remove it, and the next run repeats the trial"


class _Identity(ResultSection):
    """What is read of campaign.toml."""

    estimators: Annotated[tuple[str, ...], Field(min_length=1)]


class _TrialMetadata(Section):
    """Metadata of a trial's file."""

    trial: int
    error: str | None
    failures: dict[str, str]


class _Times(Section):
    """A line of times.jsonl."""

    session: Annotated[int, Field(ge=0, le=2**31)]
    elapsed_s: Annotated[float, Field(ge=0.0)]
    trial: int | None = None
    times_s: dict[str, float] | None = None


class _Figures(ResultSection):
    """Figures of an estimator in summary.json."""

    trajectories: int
    converged: int
    position_final_mean_m: float | None
    position_final_rms_m: float | None
    attitude_final_mean_deg: float | None
    rms_over_pcrb: float | None
    anees: float | None
    anees_trials: int | None = None
    time_per_trial_s: float | None


class _Summary(ResultSection):
    """What is read of summary.json."""

    trials: Annotated[int, Field(ge=0)]
    failed: Annotated[int, Field(ge=0)]
    wall_s: float
    estimators: dict[str, _Figures]


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
        For every other trial, the estimators that produced no trajectory, and why.
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
        if not exists(path):
            raise InputError(path, "is missing: complete the campaign first")
        found = read_json(path, _Summary)
        check_names(path, found["estimators"])
        return {**found, "estimators": _present(found["estimators"])}


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
    if not exists(path):
        raise InputError(path, "folder is missing")
    if not exists(path / MARKER):
        raise InputError(path, f"expected a campaign's folder, found no {MARKER} in it")
    identity = read_identity(path)
    tables, failed, failures = [], {}, {}
    for trial in each_trial(path):
        if trial.table is None:
            failed[trial.number] = trial.error
            continue
        failures[trial.number] = trial.failures
        tables.append(trial.table)
    times_s, wall_s = read_wall_times(path)
    table = pa.concat_tables(tables) if tables else SCHEMA.empty_table()
    return Campaign(path, identity, table, failed, failures, times_s, wall_s)


@dataclass(frozen=True)
class Trial:
    """A trial read back.

    Attributes
    ----------
    number : int
    table : pyarrow.Table or None
        Its rows, with the columns of `craternav_fg.campaign.trial.SCHEMA`; None when the trial failed.
    error : str
        Why it failed; empty when it did not.
    failures : dict of str to str
        Estimators that produced no trajectory, and why.
    """

    number: int
    table: pa.Table | None
    error: str
    failures: dict[str, str]


def each_trial(folder: Path) -> Iterator[Trial]:
    """Read the trials of a campaign one by one.

    Parameters
    ----------
    folder : Path

    Yields
    ------
    Trial
        By number.

    Raises
    ------
    InputError
        When a file is damaged, or has another number of frames than the first.
    """
    first = None
    for number, file in sorted(trial_files(folder).items()):
        metadata = read_metadata(file)
        if metadata["error"] is not None:
            yield Trial(number, None, metadata["error"], {})
            continue
        table = _table(file, number)
        frames = _frames(table)
        first = frames if first is None else first
        if frames != first:
            problem = f"expected {first} frames as in the first trial, found {frames}"
            raise _damaged(file, problem)
        yield Trial(number, table, "", _present(metadata["failures"]))


def failed_trials(folder: Path) -> dict[int, str]:
    """Find the trials without a result, by number, and why.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict of int to str

    Raises
    ------
    InputError
        When a file is damaged.
    """
    errors = {number: read_metadata(file)["error"] for number, file in trial_files(folder).items()}
    return {number: error for number, error in errors.items() if error is not None}


def read_wall_times(folder: Path) -> tuple[dict[int, dict[str, float]], float]:
    """Read the wall times of a campaign.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    times_s : dict of int to dict
        Of the steps of each trial, where they are known.
    wall_s : float
        Of all runs of the campaign.
    """
    lines = read_times(folder / TIMES)
    wall_s: dict[int, float] = {}
    for line in lines:
        wall_s[line["session"]] = max(line["elapsed_s"], wall_s.get(line["session"], 0.0))
    times_s = {
        line["trial"]: _present(line["times_s"]) for line in lines if "trial" in line and "times_s" in line
    }
    return times_s, sum(wall_s.values())


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
    text, found = read_toml(path)
    validate(path, found, _Identity, text=text)
    check_names(path, found["estimators"])
    found["estimators"] = [present_name(name) for name in found["estimators"]]
    return found


def trial_files(folder: Path) -> dict[int, Path]:
    """Find the files of the trials in a campaign's folder, by number."""
    if not exists(folder / TRIALS):
        return {}
    found = ((TRIAL_NAME.fullmatch(file.name), file) for file in entries(folder / TRIALS))
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
    check_input(path, SizeLimit.TABLE)
    try:
        text = read_parquet_metadata(path, METADATA)
        return _TrialMetadata.model_validate_json(text or b"").model_dump()
    except InputError as error:
        raise _of_trial(path, error) from None
    except ValidationError:
        raise _damaged(path, "expected metadata written by craternav, found others") from None


def _table(path: Path, number: int) -> pa.Table:
    """Read the table of a trial, with a row for each of its estimators and frames."""
    try:
        table = read_parquet(path, _ROWS)
        check_names(path, pc.unique(table["estimator"]).to_pylist())
        of_estimators = table.filter(pc.invert(pc.is_in(table["estimator"], pa.array(_BOUNDS))))
        require_finite(path, table, "altitude_m", "pose_sigma")
        require_finite(path, of_estimators, *_ERRORS)
        if any(of_estimators[name].null_count for name in _ERRORS):
            raise InputError(path, "expected errors of every estimator, found none")
    except InputError as error:
        raise _of_trial(path, error) from None
    if pc.any(pc.not_equal(table["trial"], number)).as_py():
        raise _damaged(path, f"expected the rows of trial {number}, found others")
    counts = {one["values"]: one["counts"] for one in pc.value_counts(table["estimator"]).to_pylist()}
    if not set(_BOUNDS) <= set(counts) or len(set(counts.values())) != 1:
        raise _damaged(path, "expected as many frames of every estimator and bound, found others")
    return with_present_names(table.replace_schema_metadata(None))


def _frames(table: pa.Table) -> int:
    """Count the frames of a trial."""
    return int(pc.sum(pc.equal(table["estimator"], FILTERED_BOUND)).as_py())


def _present(by_estimator: dict[str, Any]) -> dict[str, Any]:
    """Replace former names of estimators, which an earlier version wrote."""
    return {present_name(name): value for name, value in by_estimator.items()}


def _of_trial(path: Path, error: InputError) -> InputError:
    """Say that a trial's file is damaged, as an error of reading it says."""
    problem = error.problem.removeprefix("is damaged: ")
    return InputError(path, f"is damaged: {problem}; {_REPEAT}", column=error.column)


def _damaged(path: Path, problem: str) -> InputError:
    return InputError(path, f"is damaged: {problem}; {_REPEAT}")


def read_times(path: Path) -> list[dict[str, Any]]:
    """Read the lines of times.jsonl; those that cannot be read are left out, as times change no result.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of dict
    """
    try:
        text = read_bytes(path, SizeLimit.JSON).decode("utf-8", errors="replace")
    except InputError:
        return []
    lines = []
    for line in text.splitlines():
        try:
            lines.append(_Times.model_validate_json(line).model_dump(exclude_none=True))
        except ValidationError:
            continue
    return lines
